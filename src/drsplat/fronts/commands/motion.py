"""drsplat motion: a scene that moves, of any format -> what is in it, or the same in another format."""

from __future__ import annotations

import argparse
from typing import Any

from .options import add_overwrite, finite, new_output

EXAMPLES = """\
  drsplat motion gaussian_pertimestamp --times 0 1 --output film.motion
  drsplat motion spacetime.ply --output film.motion
  drsplat motion film.motion --output frames

SCENE may be a folder of numbered PLY files with the same rows, a PLY file of SpacetimeGaussians, or NAME.motion. An
OUT that ends in .motion is written as such; any other becomes a folder of frame0000.ply and so on, one per time."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="folder of numbered PLY files, PLY of SpacetimeGaussians, or NAME.motion")
    parser.add_argument(
        "--times", type=finite, nargs=2, metavar=("FIRST", "LAST"),
        help="times of the first and last numbered PLY file, the others evenly spaced (default: their numbers)",
    )  # fmt: skip
    parser.add_argument("--output", "-o", metavar="OUT", help="NAME.motion, or a folder for numbered PLY files")
    add_overwrite(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.moving_scenes import read_moving, write_moving

    if arguments.output is not None:
        new_output(arguments.output, arguments.overwrite)
    moving = read_moving(arguments.scene, arguments.times and tuple(arguments.times))
    if arguments.output is not None:
        write_moving(arguments.output, moving, arguments.overwrite)
    return {
        "scene": arguments.scene,
        "num_gaussians": len(moving),
        "num_times": len(moving.times),
        "times": list(moving.span),
        "fingerprint": moving.canonical.fingerprint,
        "output": arguments.output,
    }


def show(answer: dict[str, Any]) -> None:
    from .tables import show_facts, text_of

    start, end = answer["times"]
    show_facts(
        f"moving scene: {answer['scene']}",
        {
            "Gaussians": text_of(answer["num_gaussians"]),
            "times": f"{text_of(answer['num_times'])}, from {start:g} to {end:g}",
            "written to": answer["output"] or "nothing: pass --output",
        },
    )
