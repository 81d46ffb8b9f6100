"""drsplat inspect: a file or folder -> what it holds."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .code_facts import code_facts, codebook_facts
from .options import add_capture_options, views_of

if TYPE_CHECKING:
    import numpy as np

SUMMARY = "describe a scene, still or moving, a capture, a feature folder, a field, a codebook or a vocabulary"
EXAMPLES = """\
  drsplat inspect scene.ply
  drsplat inspect capture
  drsplat inspect capture/language_features
  drsplat inspect room.field --json
  drsplat inspect room.field --verify"""
PERCENTILES = (1, 50, 99)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", help="file or folder of any of these")
    parser.add_argument(
        "--verify", action="store_true",
        help="check everything in a field against its checksums; other verbs check what they use, and the other kinds "
        "are read whole anyway",
    )  # fmt: skip
    add_capture_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    kind = kind_of(Path(arguments.path))
    return {"path": arguments.path, "kind": kind, **_INSPECTORS[kind](arguments)}


def show(answer: dict[str, Any]) -> None:
    from .tables import show_facts

    facts = {name: value for name, value in answer.items() if name not in ("path", "kind", "views", "photos")}
    show_facts(f"{answer['kind']}: {answer['path']}", facts)


def kind_of(path: Path) -> str:
    """scene, capture, features, field, codebook or vocabulary, by name and contents.

    Raises: InputError: there is nothing at `path`.
    """
    from ..errors import InputError
    from ..formats.langsplat import has_features
    from ..formats.moving_scenes import is_moving

    if path.is_file():
        return _file_kind(path)
    if not path.is_dir():
        raise InputError(f"{path}: there is no such file or folder")
    if (path / "field.json").is_file():
        return "field"
    if (path / "point_cloud").is_dir():
        return "scene"
    if (path / "meta.json").is_file() and _json_kind(path / "meta.json") == "scene":
        return "scene"
    has_models = any((path / name).exists() for name in ("sparse", "colmap", "transforms.json", "cameras.json"))
    if not has_models and is_moving(path):
        return "scene"
    return "features" if not has_models and has_features(path) else "capture"


def _file_kind(path: Path) -> str:
    if path.name == "motion.safetensors":
        return "scene"
    if path.suffix == ".safetensors":
        from ..formats.tensors import map_tensors

        return "codebook" if "centroids" in map_tensors(path)[0] else "vocabulary"
    if path.suffix == ".json":
        return _json_kind(path)
    return {".faiss": "codebook", ".bin": "capture", ".txt": "capture"}.get(path.suffix, "scene")


def _json_kind(path: Path) -> str:
    """cameras.json is a list, transforms.json has frames; a vocabulary may have vectors of that name."""
    from ..formats.json_files import read_json
    from ..formats.sog import is_sog_meta

    document = read_json(path)
    if is_sog_meta(document):
        return "scene"
    frames = document.get("frames") if isinstance(document, dict) else document
    posed = isinstance(frames, list) and not any(isinstance(frame, int | float) for frame in frames)
    return "capture" if posed or path.name == "transforms.json" else "vocabulary"


def _scene(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..formats.moving_scenes import read_scene
    from ..scene.moving import Moving, canonical_of

    given = read_scene(arguments.path)
    scene = canonical_of(given)
    of_time = {"num_times": len(given.times), "times": list(given.span)} if isinstance(given, Moving) else {}
    return {
        **of_time,
        "num_gaussians": len(scene),
        "sh_degree": scene.sh_degree,
        "lowest": scene.positions.min(0) if len(scene) else None,
        "highest": scene.positions.max(0) if len(scene) else None,
        "near": scene.near,
        "opacity": _percentiles(scene.opacities),
        "scale": _percentiles(scene.scales.max(1)),
        "extra_columns": sorted(scene.extra),
        "fingerprint": scene.fingerprint,
    }


def _capture(arguments: argparse.Namespace) -> dict[str, Any]:
    views = views_of(arguments, arguments.path)
    lenses = sorted({"pinhole" if view.distortion is None else "distorted" for view in views})
    return {
        "num_views": len(views),
        "num_photos": sum(view.image_path is not None for view in views),
        "sizes": sorted({f"{view.width}x{view.height}" for view in views}),
        "lenses": lenses,
        "focal_px": sorted({round(float(view.K[0, 0]), 2) for view in views}),
        "first": views[0].name,
        "last": views[-1].name,
        "without_photo": [view.name for view in views if view.image_path is None],
        "views": [
            {
                "name": view.name, "size": [view.width, view.height], "K": view.K,
                "cam_from_world": view.cam_from_world, "distortion": view.distortion, "photo": view.image_path,
            }
            for view in views
        ],
    }  # fmt: skip


def _features(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..formats.langsplat import read_features
    from ..masks.masks import LEVELS

    folder = read_features(arguments.path)
    by_level = {level: read_features(arguments.path, level=level) for level in LEVELS}
    photos = [{"name": key, **{level: len(f[key].embeddings) for level, f in by_level.items()}} for key in folder]
    return {
        "num_photos": len(folder),
        "dim": folder.dim,
        "masks_per_level": {level: sum(photo[level] for photo in photos) for level in LEVELS},
        "map_sizes": sorted({"{1}x{0}".format(*folder[key].mask_ids.shape) for key in folder}),
        "first": photos[0]["name"],
        "last": photos[-1]["name"],
        "photos": photos,
    }


def _field(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import load_field

    field = load_field(arguments.path)
    if arguments.verify:
        field.verify()
    files = sorted(file for file in Path(arguments.path).iterdir() if file.is_file())
    evidence = field.evidence
    return {
        "num_registered": len(field),
        "num_gaussians": field.num_gaussians,
        "encoder": field.encoder.name,
        "encoder_weights": field.encoder.weights,
        "dim": field.encoder.dim,
        **code_facts(field.code),
        "scene": field.scene,
        "aggregator": field.aggregator.name,
        "left_out": list(field.left_out),
        "num_views": None if evidence is None else len(evidence.masks.view_names),
        "times": None if field.times is None else [field.times.min(), field.times.max()],
        "num_masks": None if evidence is None else len(evidence.masks),
        "num_weights": None if evidence is None else int(evidence.weights.nnz),
        "num_objects": None if field.objects is None else len(field.objects),
        "negatives": list(field.negatives.texts) if field.negatives else [],
        "file_bytes": {file.name: file.stat().st_size for file in files},
        "fingerprint": field.fingerprint,
        **({"verified": _verified(Path(arguments.path))} if arguments.verify else {}),
    }


def _verified(field: Path) -> list[str]:
    """The files of a field that have checksums: none of older ones, and nothing that lies beside them."""
    from ..field.loading import SUMMED
    from ..formats.field_folder import MANIFEST, read_manifest

    manifest: dict[str, Any] = read_manifest(field)
    return sorted([*manifest["files"], MANIFEST]) if manifest["version"] >= SUMMED else []


def _codebook(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..codes.official import read_codebook

    codebook = read_codebook(arguments.path)
    return {"encoder": codebook.encoder.name, "dim": codebook.dim, **codebook_facts(codebook)}


def _vocabulary(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import read_vocabulary

    vocabulary = read_vocabulary(arguments.path)
    return {
        "encoder": vocabulary.identity.name, "dim": vocabulary.identity.dim, "num_texts": len(vocabulary.texts),
        "texts": list(vocabulary.texts),
    }  # fmt: skip


def _percentiles(values: np.ndarray) -> dict[str, float]:
    import numpy as np

    if not len(values):
        return {}
    return {f"p{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


_INSPECTORS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    "scene": _scene, "capture": _capture, "features": _features, "field": _field, "codebook": _codebook,
    "vocabulary": _vocabulary,
}  # fmt: skip
