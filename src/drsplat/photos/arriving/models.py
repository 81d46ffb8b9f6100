"""The segmenter and encoder of photos that arrive: those that the scene's other photos were embedded with."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError, MismatchError
from ...field import LanguageField
from ...formats.embedding_record import read_record
from ...formats.json_files import as_kind
from ...formats.langsplat import has_features
from ...scene.encoders import Encoder, ImageEncoder
from ...scene.masks.masks import Segmenter
from ..embedding.embed import MAX_HEIGHT_PIXELS, settings_of
from ..models.graph import GraphSegmenter
from ..models.mini import MiniEncoder
from ..models.point_masks import PointMaskSettings
from ..models.sam import load_segmenter

FEATURES = "language_features"
CURE = "send the masks and embeddings with each photo"


@dataclass(frozen=True)
class ModelNames:
    """Names of models that whoever runs a service allows, beside the built-in ones; None for none.

    No model is loaded only because a folder names it.
    """

    segmenter: str | None = None
    encoder: str | None = None
    device: str = "auto"
    threads: int = 0


@dataclass(frozen=True)
class PhotoModels:
    """Models that mask and embed photos. max_height: pixels that taller photos are scaled to, or None."""

    segmenter: Segmenter
    encoder: ImageEncoder
    max_height: int | None


def check_names(field: LanguageField, folder: Path, names: ModelNames) -> None:
    """Check that photos without features can be masked and embedded; nothing is loaded.

    Raises: InputError: nobody knows with which models, or they are neither built in nor allowed.
    """
    _encoder_name(field, names)
    _segmenter_name(_recorded(folder), names)


class ModelShelf:
    """The models that were needed last, which stay loaded. load: makes an encoder of a name and a device."""

    def __init__(self, names: ModelNames, load: Callable[[str, str], Encoder]) -> None:
        self._names, self._load = names, load
        self._last: tuple[object, PhotoModels] | None = None

    def models(self, field: LanguageField, folder: Path) -> PhotoModels:
        """Return the models of a scene. folder: its features, with their record.

        Raises: InputError: as `check_names`. MismatchError: they are not those that made the scene's features.
        """
        recorded = _recorded(folder)
        key = field.encoder, json.dumps(recorded, sort_keys=True)
        if self._last is None or self._last[0] != key:
            self._last = None  # before others take its room
            self._last = key, self._loaded(field, recorded)
        return self._last[1]

    def _loaded(self, field: LanguageField, recorded: Mapping[str, Any] | None) -> PhotoModels:
        names = self._names
        encoder = self._load(_encoder_name(field, names), names.device)
        if not isinstance(encoder, ImageEncoder):
            raise InputError(f"the encoder {encoder.identity.name} embeds words and no photos: {CURE}")
        field.check_encoder(encoder.identity)
        of_points = ((recorded or {}).get("segmenter") or {}).get("settings")  # those of SAM
        settings = None if of_points is None else as_kind(of_points, PointMaskSettings, "the segmenter's settings")
        segmenter = load_segmenter(_segmenter_name(recorded, names), names.device, settings, threads=names.threads)
        height: Any = MAX_HEIGHT_PIXELS if recorded is None else recorded.get("max_height")
        used = json.loads(json.dumps(settings_of(segmenter, encoder, height)))
        if recorded is not None and used != recorded:
            others = ", ".join(name for name in {**used, **recorded} if used.get(name) != recorded.get(name))
            raise MismatchError(
                f"the photos of this scene were masked and embedded otherwise ({others}): name the same models, or "
                f"{CURE}"
            )
        return PhotoModels(segmenter, encoder, height)


def _recorded(folder: Path) -> Mapping[str, Any] | None:
    """Return what made the features of a folder; None where it has none.

    Raises: InputError: they were made by another program.
    """
    record = read_record(folder)
    if record is None and folder.is_dir() and has_features(folder):
        raise InputError(f"nothing says which models made the features of this scene: {CURE}")
    return None if record is None else record.settings


def _encoder_name(field: LanguageField, names: ModelNames) -> str:
    if field.encoder.name == MiniEncoder.name:
        return MiniEncoder.name
    if names.encoder is None:
        raise InputError(f"photos are not embedded by '{field.encoder.name}' here: {CURE}")
    return names.encoder


def _segmenter_name(recorded: Mapping[str, Any] | None, names: ModelNames) -> str:
    if names.segmenter is not None:
        return names.segmenter
    segmenter = {} if recorded is None else recorded.get("segmenter") or {}
    if segmenter.get("name") != GraphSegmenter.name:
        raise InputError(f"no segmenter for the photos of this scene was named here: {CURE}")
    return GraphSegmenter.name
