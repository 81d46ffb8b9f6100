"""Films of camera paths, for `drsplat render --path`."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from .edit_options import as_edited
from .options import finite, length, new_output, tracker, whole

if TYPE_CHECKING:
    from ...authoring.filming.highlights import Highlight
    from ...drawing.labels import Mark
    from ...query import Match
    from ...query import Scene as OpenedScene
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.views import View

SCENE, MATCH = "scene", "match"
SAME_SCENE = "-"  # --side-by-side without a value


def size(text: str) -> tuple[int, int]:
    """Return width and height of an option such as 1280x720."""
    found = re.fullmatch(r"(\d{1,9})[xX](\d{1,9})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"expected a width and height such as 1280x720, got {text!a}")
    return int(found[1]), int(found[2])


def around(text: str) -> str | int:
    """Return what an option names: the scene, the best match, or the number of an object."""
    return text if text in (SCENE, MATCH) else whole(text)


def add_film_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("film")
    group.add_argument(
        "--around", type=around, default=SCENE, metavar="scene|match|NUMBER",
        help="centre of an orbit or swing: the point that the photos look at (scene), the best match of --query, or an "
        "object of the field (default: scene)",
    )  # fmt: skip
    group.add_argument(
        "--up", metavar="AXIS", help="up for orbits: +x, -x ... -z (default: from the orientation of the photos)"
    )
    group.add_argument("--fps", type=finite, metavar="N", help="frames per second (default: that of FILE, else 30)")
    group.add_argument(
        "--seconds", type=length, metavar="S",
        help="length (default: that of FILE, else 10 for an orbit, 5 for a swing, half a second per photo up to 30, "
        "two seconds between key frames)",
    )  # fmt: skip
    group.add_argument(
        "--size", type=size, metavar="WxH",
        help="width and height in pixels, even for .mp4 and .webm (default: those of FILE, else the photos' up to "
        "1280, else 1280x720)",
    )  # fmt: skip
    group.add_argument(
        "--side-by-side", nargs="?", const=SAME_SCENE, metavar="SCENE",
        help="show the scene without the answer, or another scene, in the left half: before and after an edit",
    )  # fmt: skip


def film(
    arguments: argparse.Namespace, scene: Gaussians | Moving, views: list[View], answer: Highlight | None,
    opened: OpenedScene | None, notes: list[Mark],
) -> dict[str, Any]:  # fmt: skip
    """Write --output; returns what is in it. answer: of --query, and the scene that gave it. notes: drawn over it."""
    from ...authoring.filming.frames import Film
    from ...authoring.filming.looking import named_up
    from ...authoring.filming.planning import path_named, planned
    from ...authoring.filming.writing import check_film, write_film
    from ...base.progress import Stopwatch
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of
    from .render import BACKGROUNDS

    watch = Stopwatch()
    up = None if arguments.up is None else named_up(arguments.up)
    rows = canonical_of(scene)
    path = path_named(arguments.path, rows, views, _target(arguments, answer, opened), up, arguments.seconds)
    sides = 1 if arguments.side_by_side is None else 2
    plan = planned(
        path, views=views, fps=arguments.fps, seconds=arguments.seconds, size=arguments.size, sides=sides
    )  # fmt: skip
    output = new_output(arguments.output_dir, arguments.overwrite)
    check_film(output, plan.size, plan.fps)
    other = arguments.side_by_side
    beside = (
        scene
        if other == SAME_SCENE
        else None
        if other is None
        else as_edited(other, read_scene(other), arguments.edits)
    )
    filmed = Film(
        scene, plan.views, plan.fps, answer, beside, BACKGROUNDS[arguments.background], arguments.near,
        arguments.threads, notes,
    )  # fmt: skip
    pictures = filmed.pictures(tracker(arguments)(plan.views, "filming"))
    write_film(output, pictures, plan.fps, arguments.overwrite)
    watch.lap("film")
    return {
        "file": str(output),
        "num_frames": len(plan.views),
        "fps": plan.fps,
        "film_seconds": plan.seconds,
        "size": list(plan.size),
        "bytes": output.stat().st_size,
        "frames_per_second": len(plan.views) / watch.seconds["film"],
    }


def _target(arguments: argparse.Namespace, answer: Highlight | None, opened: OpenedScene | None) -> Match | None:
    """Return the match that --around names; None for the scene. Raises: InputError: it is not there."""
    from ...errors import InputError
    from ...query.objects import match_of, objects_of

    if arguments.around == SCENE:
        return None
    if opened is None or answer is None:
        raise InputError("around: a match or an object is of a field: give --field FIELD and --query WORDS")
    if arguments.around != MATCH:
        return match_of(opened.field, objects_of(opened.field).thing(arguments.around))
    if not answer.matches:
        raise InputError(f"around: '{arguments.query}' has no match in this scene: ask for something else")
    return answer.matches[0]
