"""Checks of scenes that no file could give back, the same for every format."""

from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians
from .activation import checked


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
