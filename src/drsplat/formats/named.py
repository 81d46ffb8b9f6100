"""Named objects that a scene's file holds beside its Gaussians, whatever its format."""

from pathlib import Path

from ..errors import FormatError
from .glb import labels_in_glb
from .labels import NAMES_SUFFIX, Labels, parse_labels
from .sog import read_sog_labels
from .sog_files import META
from .spz import read_spz_labels
from .streamed_sog import LOD_META, read_streamed_labels
from .usd import SUFFIXES as USD_SUFFIXES
from .usd import read_usd

MAX_OBJECT_NUMBER = (1 << 31) - 1  # Gaussians store it as int32
_BY_NAME = {LOD_META: read_streamed_labels, META: read_sog_labels}
_BY_SUFFIX = {".sog": read_sog_labels, ".spz": read_spz_labels, ".glb": labels_in_glb, ".gltf": labels_in_glb}


def read_labels(path: Path) -> Labels:
    """Return the names and boxes of the objects and groups in a file of drsplat, or beside a PLY; none in other files.

    path: a scene, or the folder of a streamed SOG.

    Raises: FormatError: damaged, or labels that are none. MissingExtraError: as `read_usd`.
    """
    path = path / LOD_META if (path / LOD_META).is_file() else path
    if path.suffix.lower() in USD_SUFFIXES:
        scene = read_usd(path)
        return _checked(Labels(scene.things, scene.groups, scene.query), path)
    beside = path.with_suffix(NAMES_SUFFIX)
    if path.suffix.lower() == ".ply" and beside.is_file():
        return _checked(parse_labels(beside.read_bytes(), str(beside)), beside)
    reader = _BY_NAME.get(path.name) or _BY_SUFFIX.get(path.suffix.lower())
    return Labels() if reader is None else _checked(reader(path), path)


def _checked(labels: Labels, path: Path) -> Labels:
    """Return labels. Raises: FormatError: a group that is not there, or a number that no Gaussian can have."""
    for thing in (*labels.things, *labels.groups):
        if not (-1 <= thing.parent < len(labels.groups) and -1 <= thing.number <= MAX_OBJECT_NUMBER):
            raise FormatError(
                f"{path}: '{thing.name:.40}': expected a group from -1 to {len(labels.groups) - 1} and a number from "
                f"-1 to {MAX_OBJECT_NUMBER}, got {thing.parent} and {thing.number}: damaged"
            )
    return labels
