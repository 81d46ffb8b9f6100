"""The page that a browser is given first, and its script."""

from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec

CLIENT = "drsplat.viewing.client"
STAND_IN = '<!doctype html><html lang="en"><title>drsplat</title><p>The viewer\'s page has not been built: see web/.'
"""What is shown where the client is not part of this build."""


def html() -> str:
    """Return the client's page."""
    if find_spec(CLIENT) is None:
        return STAND_IN
    page: str = import_module(CLIENT).live_html()
    return page


def script() -> bytes:
    """Return the client's script; empty where it was not built."""
    path = files("drsplat.viewing") / "client.js"
    return path.read_bytes() if path.is_file() else b""
