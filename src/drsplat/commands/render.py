"""drsplat render: pictures of a scene from the places of its photos."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .options import (
    add_capture_options,
    add_near,
    add_overwrite,
    add_query_encoders,
    finite,
    new_output,
    tracker,
    views_of,
    words,
)
from .query_options import open_scene

if TYPE_CHECKING:
    import numpy as np

    from ..kernels import SplatArrays
    from ..scene.gaussians import Gaussians
    from ..scene.views import View

SUMMARY = "render a scene from the places of its photos, optionally with the matches of a query highlighted"
EXAMPLES = """\
  drsplat render scene.ply --views capture --view photo_003 --output-dir renders
  drsplat render scene.ply --views capture --all --max-side 800 --depth
  drsplat render scene.ply --views capture --all --query room.field "red mug\""""
BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0), "grey": (0.5, 0.5, 0.5)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="Gaussians: .ply, .spz, .sog, .splat, .ksplat or a trained model's folder")
    parser.add_argument("--views", required=True, metavar="CAPTURE", help="poses to render from")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--view", type=words, metavar="NAME", help="name of one photo, with or without suffix")
    which.add_argument("--all", action="store_true", help="render from all photos")
    parser.add_argument(
        "--output-dir", "--output", "-o", default="renders", metavar="DIR",
        help="folder for the PNGs (default: renders)",
    )  # fmt: skip
    add_overwrite(parser)
    parser.add_argument(
        "--background", choices=sorted(BACKGROUNDS), default="black",
        help="colour behind the Gaussians (default: black)",
    )  # fmt: skip
    parser.add_argument(
        "--depth", action="store_true",
        help="write NAME.depth.npy as well: expected camera z in scene units, float32 (H, W), 0 where nothing is",
    )  # fmt: skip
    parser.add_argument(
        "--alpha", action="store_true", help="write NAME.alpha.png as well: opacity, 255 where nothing shines through"
    )
    add_near(parser)
    parser.add_argument(
        "--query", type=words, nargs=2, metavar=("FIELD", "TEXT"),
        help="query whose matches stay in colour, the rest grey",
    )  # fmt: skip
    parser.add_argument(
        "--threshold", type=finite, metavar="T", help="threshold of --query (default: as of `drsplat locate`)"
    )
    add_query_encoders(parser)
    add_capture_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import read_gaussians
    from ..kernels import splat_arrays
    from ..progress import Stopwatch
    from ..query import view_named

    watch = Stopwatch()
    scene, views = read_gaussians(arguments.scene), views_of(arguments, arguments.views)
    views = views if arguments.all else [view_named(views, arguments.view)]
    selected = _selected(arguments, scene)
    watch.lap("read")
    splats = splat_arrays(scene, arguments.near)
    written = [
        path
        for view in tracker(arguments)(views, "rendering")
        for path in _render(arguments, scene, view, splats, selected)
    ]
    watch.lap("render")
    return {
        "files": [str(path) for path in written],
        "num_views": len(views),
        "num_selected": None if selected is None else int(selected.sum()),
        "seconds": sum(watch.seconds.values()),
        "stage_seconds": watch.seconds,
    }


def show(answer: dict[str, Any]) -> None:
    from ..terminal import counted

    files = answer["files"]
    print(
        f"{counted(len(files), 'file')} in {answer['seconds']:.1f} s: {files[0]}"
        + (f" ... {files[-1]}" if len(files) > 1 else "")
    )
    if answer["num_selected"] == 0:
        print("No match to highlight.")


def _selected(arguments: argparse.Namespace, scene: Gaussians) -> np.ndarray | None:
    """(N, 1): 1 for the Gaussians that --query finds; None without it."""
    import numpy as np

    from ..query import Query

    if arguments.query is None:
        return None
    path, text = arguments.query
    chosen = np.zeros((len(scene), 1), np.float32)
    for match in open_scene(arguments, path).locate(Query(text, threshold=arguments.threshold)):
        chosen[match.gaussian_ids] = 1
    return chosen


def _render(
    arguments: argparse.Namespace, scene: Gaussians, view: View, splats: SplatArrays, selected: np.ndarray | None
) -> list[Path]:
    import numpy as np

    from .. import render
    from ..drawing.pictures import as_pixels, highlighted, write_picture
    from ..formats.npy import write_npy

    stem = Path(arguments.output_dir) / Path(view.name).with_suffix("")
    paths = {"rgb": stem.with_name(f"{stem.name}.png")}
    paths |= {"alpha": stem.with_name(f"{stem.name}.alpha.png")} if arguments.alpha else {}
    paths |= {"depth": stem.with_name(f"{stem.name}.depth.npy")} if arguments.depth else {}
    for path in paths.values():
        new_output(str(path), arguments.overwrite)
    background = BACKGROUNDS[arguments.background]
    drawn = render(scene, view, values=selected, background=background, threads=arguments.threads, splats=splats)
    pixels = as_pixels(drawn.rgb)
    stem.parent.mkdir(parents=True, exist_ok=True)
    picture = pixels if selected is None else highlighted(pixels, drawn.channels[..., 0])
    write_picture(paths["rgb"], picture, arguments.overwrite)
    if arguments.alpha:
        write_picture(paths["alpha"], (np.clip(drawn.alpha, 0, 1) * 255 + 0.5).astype(np.uint8), arguments.overwrite)
    if arguments.depth:
        write_npy(paths["depth"], drawn.depth, arguments.overwrite)
    return list(paths.values())
