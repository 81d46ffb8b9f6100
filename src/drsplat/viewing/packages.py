"""The packages of the extra drsplat[viewer], or what to install."""

from importlib import import_module
from typing import Any

from ..errors import MissingExtraError

INSTALL = 'pip install "drsplat[viewer]"'
BESIDE_VISER = ("msgspec", "websockets")


def viser_module() -> Any:
    """Asked before modules of this room that import them at their top are imported.

    Raises: MissingExtraError: one of them is not installed.
    """
    try:
        for name in BESIDE_VISER:
            import_module(name)
        return import_module("viser")
    except ImportError as error:
        raise MissingExtraError(
            f"the viewer in a browser needs viser ({error}): {INSTALL}; `drsplat view --export` needs nothing"
        ) from error
