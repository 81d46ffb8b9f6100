"""Checks of scenes that no file could give back, the same for every format."""

from os import PathLike
from pathlib import Path

from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians
from .activation import checked

PACKED_SUFFIX = ".compressed.ply"


def refuse_packed_name(path: str | PathLike[str]) -> None:
    """Refuse a name that promises SuperSplat's packed form. Raises: InputError."""
    name = Path(path).name
    if name.lower().endswith(PACKED_SUFFIX):
        stem = name[: -len(PACKED_SUFFIX)]
        raise InputError(
            f"{name}: a name of SuperSplat's compressed PLY, which is read and not written: name it {stem}.ply; "
            "`drsplat export` writes .sog and .spz, which are as small"
        )


def refuse_unwritable(gaussians: Gaussians) -> None:
    """Refuse a scene that no program can draw. Raises: InputError: no Gaussians, or as `refuse_unreadable`."""
    if not len(gaussians):
        raise InputError("there are no Gaussians to write: choose something that is there")
    refuse_unreadable(gaussians)


def refuse_unreadable(g: Gaussians) -> None:
    """Refuse rows that no reader would take, such as NaN. Raises: InputError: which ones, and how many."""
    try:
        checked(g.means, g.quats.copy(), g.scales, g.opacities, g.sh)
    except FormatError as error:
        raise InputError(f"these Gaussians could not be read back: {error}") from None
