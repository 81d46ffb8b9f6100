"""Options of films along camera paths, and of other rendered pictures."""

from __future__ import annotations

import argparse
import re
from typing import Any

from .declaring import declaration, option
from .kinds import finite, length, whole

SCENE, MATCH = "scene", "match"
SAME_SCENE = "-"  # --side-by-side without a value
BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0), "grey": (0.5, 0.5, 0.5)}


def size(text: str) -> tuple[int, int]:
    """Return width and height of an option such as 1280x720."""
    found = re.fullmatch(r"(\d{1,9})[xX](\d{1,9})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"expected a width and height such as 1280x720, got {text!a}")
    return int(found[1]), int(found[2])


def around(text: str) -> str | int:
    """Return what an option names: the scene, the best match, or the number of an object."""
    return text if text in (SCENE, MATCH) else whole(text)


def background() -> Any:
    return option(
        "colour behind the Gaussians (default: black)", default="black", choices=sorted(BACKGROUNDS)
    )  # fmt: skip


@declaration
class Filming:
    """How a film along a path is made."""

    TITLE = "film"
    around: str | int = option(
        "centre of an orbit or swing: the point that the photos look at (scene), the best match of --query, or an "
        "object of the field (default: scene)", "scene|match|NUMBER", around, SCENE,
    )  # fmt: skip
    up: str | None = option("up for orbits: +x, -x ... -z (default: from the orientation of the photos)", "AXIS")
    fps: float | None = option("frames per second (default: that of FILE, else 30)", "N", finite)
    seconds: float | None = option(
        "length (default: that of FILE, else 10 for an orbit, 5 for a swing, half a second per photo up to 30, two "
        "seconds between key frames)", "S", length,
    )  # fmt: skip
    size: tuple[int, int] | None = option(
        "width and height in pixels, even for .mp4 and .webm (default: those of FILE, else the photos' up to 1280, "
        "else 1280x720)", "WxH", size,
    )  # fmt: skip
    side_by_side: str | None = option(
        "show the scene without the answer, or another scene, in the left half: before and after an edit", "SCENE",
        nargs="?", const=SAME_SCENE,
    )  # fmt: skip
