"""drsplat: search a 3D Gaussian Splatting scene in words.

Every name below is loaded when it is first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from .drawing.rendering import render
    from .errors import DrSplatError, DrSplatWarning
    from .evaluation.running import evaluate
    from .field import LanguageField, load_field
    from .field.codes import PQ, Codebook, Mixture, load_codebook, train_codebook
    from .field.evidence.aggregation import Sampling
    from .field.registration import Registration, register
    from .formats.captures import read_sparse_points, read_views
    from .formats.gaussian_ply import write_gaussians
    from .formats.langsplat import read_features
    from .formats.scenes import read_gaussians
    from .formats.vocabulary import read_vocabulary
    from .fronts.viewing.exporting import export_page
    from .photos.embedding.embed import embed
    from .photos.models.loading import load_encoder
    from .photos.models.mini import MiniEncoder
    from .photos.models.sam import load_segmenter
    from .photos.models.words import WordEncoder
    from .query import Answer, Cut, Match, Query, Scene, open_scene
    from .scene.encoders import Encoder, EncoderIdentity
    from .scene.gaussians import Gaussians
    from .scene.masks.features import ViewFeatures
    from .scene.photos import load_image
    from .scene.views import View
    from .training import TrainingSettings, train

_HOMES = {
    "photos.models.loading": ("load_encoder",), "photos.models.sam": ("load_segmenter",),
    "photos.embedding.embed": ("embed",), "field.evidence.aggregation": ("Sampling",),
    "field.codes": ("PQ", "Codebook", "Mixture", "load_codebook", "train_codebook"),
    "scene.encoders": ("Encoder", "EncoderIdentity"), "evaluation.running": ("evaluate",),
    "errors": ("DrSplatError", "DrSplatWarning"), "scene.masks.features": ("ViewFeatures",),
    "field": ("LanguageField", "load_field"), "formats.captures": ("read_sparse_points", "read_views"),
    "formats.langsplat": ("read_features",), "formats.scenes": ("read_gaussians",),
    "formats.gaussian_ply": ("write_gaussians",),
    "formats.vocabulary": ("read_vocabulary",), "scene.gaussians": ("Gaussians",),
    "photos.models.mini": ("MiniEncoder",), "scene.photos": ("load_image",),
    "query": ("Answer", "Cut", "Match", "Query", "Scene", "open_scene"),
    "field.registration": ("Registration", "register"), "drawing.rendering": ("render",),
    "fronts.viewing.exporting": ("export_page",), "training": ("TrainingSettings", "train"), "scene.views": ("View",),
    "photos.models.words": ("WordEncoder",),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "PQ", "Answer", "Codebook", "Cut", "DrSplatError", "DrSplatWarning", "Encoder", "EncoderIdentity", "Gaussians",
    "LanguageField", "Match", "MiniEncoder", "Mixture", "Query", "Registration", "Sampling", "Scene",
    "TrainingSettings", "View", "ViewFeatures", "WordEncoder", "__version__", "embed", "evaluate", "export_page",
    "load_codebook", "load_encoder", "load_field", "load_image", "load_segmenter", "open_scene", "read_features",
    "read_gaussians", "read_sparse_points", "read_views", "read_vocabulary", "register", "render", "train",
    "train_codebook", "write_gaussians",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return globals().setdefault(name, version("drsplat"))
    if name not in _HOME_OF:
        raise AttributeError(f"module 'drsplat' has no attribute '{name}'")
    from .base.kinds import checked

    thing = getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
    return globals().setdefault(name, checked(thing))


def __dir__() -> list[str]:
    return sorted(__all__)
