"""A view that was sent is checked and kept until it is added."""

import hashlib
import io
import json
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from ...errors import DrSplatError, FormatError, InputError
from ...field import LanguageField
from ...field.growing.changing import check_growth
from ...formats.compact_features import read_compact
from ...formats.embedding_record import COMPACT
from ...formats.langsplat import FeatureFolder, level_index
from ...formats.live_views import FullError, LiveView, LiveViews, TakenNameError, live_name, posed, stem_of
from ...formats.replacing import claimed_output, saying_what_is_full
from ...scene.photos import check_cost
from ...scene.views import View, same_aspect
from .models import FEATURES, ModelNames, check_names

PATIENCE_S = 10.0  # for another process that takes a view of the same scene
MAX_WAITING = 64  # views of a scene
MAX_PIXELS = 16_000_000
SENT_FORMATS = ("JPEG", "PNG")
_RENAME = "give this one another name"


@dataclass(frozen=True)
class SentView:
    """A view as it was sent; pose, lens and time as in `LiveView`. features: a compact file of features, or None."""

    name: str
    photo: bytes
    pose: Mapping[str, object]
    lens: Mapping[str, object]
    time: float | None = None
    features: bytes | None = None

    @property
    def content(self) -> str:
        """Hash of all that was sent."""
        digest = hashlib.blake2b(digest_size=16)
        about = [self.pose, self.lens, self.time, self.features is not None, len(self.photo)]
        for part in (json.dumps(about, sort_keys=True).encode(), self.photo, self.features or b""):
            digest.update(part)
        return digest.hexdigest()


@dataclass(frozen=True)
class Target:
    """A scene that takes views. photos: names of those of its capture. moves: whether photos need a time."""

    capture: Path
    field: LanguageField
    photos: tuple[str, ...]
    moves: bool = False


def take_view(
    target: Target, sent: SentView, names: ModelNames, *, most_pixels: int = MAX_PIXELS, most_waiting: int = MAX_WAITING
) -> tuple[LiveView, bool]:
    """Keep a view until it is added; return it, and whether it is new: one that was sent before is as it is now.

    Raises: InputError: a name, pose, lens, photo or features that are none, or photos cannot be embedded here.
    TakenNameError: another view has the name. FullError: as many views wait as may. NoRoom: the disk is full.
    """
    try:
        name = live_name(sent.name)
    except FormatError as error:
        raise InputError(str(error)) from None
    live = LiveViews(target.capture)
    with claimed_output(live.folder, PATIENCE_S):
        earlier = live.find(name)
        if earlier is not None and earlier.state != "refused":
            if (earlier.name, earlier.content) != (name, sent.content):
                raise TakenNameError(f"'{earlier.name}' was sent before with another photo, pose or lens: {_RENAME}")
            return earlier, False
        evidence = target.field.evidence
        photos = {*target.photos, *(evidence.masks.view_names if evidence else ())}
        taken = next((other for other in sorted(photos) if stem_of(other) == stem_of(name)), None)
        if taken is not None:
            raise TakenNameError(f"'{taken}' is a photo of this scene already: {_RENAME}")
        view = LiveView(
            name, dict(sent.pose), dict(sent.lens), sent.time, sent.features is not None, sent.content, time.time()
        )
        check_growth(target.field)
        _check(target, view, sent, most_pixels)
        if sent.features is None:
            check_names(target.field, target.capture / FEATURES, names)
        waiting = live.count_waiting()
        if waiting >= most_waiting:
            raise FullError(f"{waiting} views of this scene wait to be added: send this one again later")
        live.keep(view, sent.photo, sent.features)
        return view, True


def _check(target: Target, view: LiveView, sent: SentView, most_pixels: int) -> None:
    """Check what can be checked without decoding the photo. Raises: InputError: the first fault, without a path."""
    if target.moves and sent.time is None:
        raise InputError("time: this scene moves: expected when the photo was taken, in the unit of the scene's times")
    file = io.BytesIO(sent.photo)
    try:
        with Image.open(file, formats=SENT_FORMATS) as photo:
            check_cost(photo, file, most_pixels)
            size = photo.size
    except InputError as error:
        raise InputError(f"picture: {error}") from None
    except Exception as error:  # decoders of damaged files raise anything
        raise InputError(f"picture: expected a JPEG or PNG: {type(error).__name__}") from None
    try:
        at = posed(view, size)
    except DrSplatError as error:
        raise InputError(str(error)) from None
    if sent.features is not None:
        with saying_what_is_full(target.capture), tempfile.TemporaryDirectory(prefix="drsplat-") as folder:
            _check_features(target.field, at, sent.features, Path(folder), most_pixels)


def _check_features(field: LanguageField, view: View, content: bytes, folder: Path, most_pixels: int) -> None:
    """Check features that were sent. folder: an empty one. Raises: InputError: they are not of this photo or field."""
    path = folder / f"features{COMPACT}"
    path.write_bytes(content)
    try:
        height, width = read_compact(path).size
        if height * width > most_pixels or not same_aspect((width, height), view.size):
            raise InputError(f"features: masks of {width}x{height} for a photo of {view.width}x{view.height}")
        features = FeatureFolder(folder, level_index(field_level(field)), field.encoder)["features"]
    except DrSplatError as error:
        raise InputError(str(error).replace(f"{folder}/", "")) from None
    if not len(features.embeddings):
        raise InputError("features: there is no mask in them")


def field_level(field: LanguageField) -> str:
    """Return the level of masks that a field was registered with."""
    level = field.growth.provenance.level if field.growth else None
    return level or "large"
