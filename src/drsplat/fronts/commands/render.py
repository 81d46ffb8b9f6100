"""drsplat render: pictures of a scene from the places of its photos, and films along a path."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...query.schema import Place, fields
from .edit_options import add_kept_edits, as_edited, note_own_scene
from .film import SCENE, add_film_options, film
from .options import (
    add_capture_options,
    add_near,
    add_overwrite,
    add_query_encoders,
    device_for_kernels,
    new_output,
    tracker,
    views_of,
    words,
)
from .query_options import add_fields, open_scene, values_of

if TYPE_CHECKING:
    from ...authoring.filming.highlights import Highlight
    from ...drawing.labels import Mark
    from ...kernels import SplatArrays
    from ...query import Scene as OpenedScene
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.views import View

EXAMPLES = """\
  drsplat render scene.ply --views capture --view photo_003 --output-dir renders
  drsplat render scene.ply --views capture --all --max-side 800 --depth
  drsplat render scene.ply --views capture --all --field room.field --query "red mug"
  drsplat render scene.ply --views capture --path orbit --field room.field --query "red mug" --boxes --output mug.mp4
  drsplat render scene.ply --path camera_path.json --fps 24 --size 1920x1080 --output flight.webm
  drsplat render scene.ply --views capture --field room.field --query vase --attributes red blue wooden -o vase.png"""
TEXT_CUT = fields(Place.COMMAND_LINE, Place.WORDS)
DAILY = ("views", "view", "all", "path", "output_dir", "field", "query", "overwrite", "size", "seconds")
BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0), "grey": (0.5, 0.5, 0.5)}
DEFAULT_FOLDER = "renders"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", help="Gaussians: .ply, .spz, .sog, .splat, .ksplat or a trained model's folder")
    parser.add_argument(
        "--views", metavar="CAPTURE", help="poses to render from; not needed for a film along FILE or an orbit"
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--view", type=words, metavar="NAME", help="name of one photo, with or without suffix")
    which.add_argument("--all", action="store_true", help="render from all photos")
    which.add_argument(
        "--path", metavar="orbit|swing|photos|FILE",
        help="film along a path: an orbit as far as there are photos, a swing of 60 degrees to and fro, through the "
        "photos, or through key frames (saved by the viewer, or nerfstudio's camera_path.json)",
    )  # fmt: skip
    parser.add_argument(
        "--output-dir", "--output", "-o", metavar="DIR|FILE",
        help="folder for the PNGs (default: renders); with --path, the film, .mp4, .webm, .webp or .gif; with "
        "--attributes, the picture",
    )  # fmt: skip
    add_overwrite(parser)
    _add_picture_options(parser)
    _add_answer_options(parser)
    add_film_options(parser)
    add_query_encoders(parser)
    add_capture_options(parser)


def _add_picture_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--background", choices=sorted(BACKGROUNDS), default="black",
        help="colour behind the Gaussians (default: black)",
    )  # fmt: skip
    parser.add_argument(
        "--depth", action="store_true",
        help="write NAME.depth.npy, too: expected camera z in scene units, float32 (H, W), 0 where the scene is empty",
    )  # fmt: skip
    parser.add_argument("--alpha", action="store_true", help="write NAME.alpha.png, too: opacity, 255 where opaque")
    add_near(parser)
    add_kept_edits(parser, "kept")


def _add_answer_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--field", help="field of the scene, for --query")
    parser.add_argument(
        "--query", type=words, metavar="WORDS", help="query whose matches stay in colour while the rest is grey"
    )
    add_fields(parser, TEXT_CUT)
    parser.add_argument("--boxes", action="store_true", help="draw the matches of --query with boxes and names")
    parser.add_argument(
        "--heat-map", action="store_true",
        help="colour everything by how well it fits --query, yellow-green at the threshold, instead of the matches",
    )  # fmt: skip
    parser.add_argument(
        "--annotations", action="store_true", help="draw the annotations that `drsplat edit` keeps beside the scene"
    )
    parser.add_argument(
        "--attributes", type=words, nargs="+", metavar="WORDS",
        help="draw a row of pictures of the best match of --query: plain, and a heat map for each of these words",
    )  # fmt: skip


def device(arguments: argparse.Namespace) -> str:
    """Return the device to draw on."""
    return device_for_kernels(arguments)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...base.progress import Stopwatch
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    watch = Stopwatch()
    _check(arguments)
    own = read_scene(arguments.scene)
    views = [] if arguments.views is None else views_of(arguments, arguments.views)
    opened, answer = _answer(arguments)
    notes = _notes(arguments)
    scene = _edited(arguments, own)
    if answer is not None and scene is not own:
        answer = answer.after_edits(canonical_of(scene))
    watch.lap("read")
    if arguments.path is not None:
        answered = film(arguments, scene, views, answer, opened, notes)
    elif arguments.attributes is not None:
        assert opened is not None
        answered = _attributes(arguments, opened, answer)
    else:
        answered = _stills(arguments, scene, views, answer, notes)
    watch.lap("render")
    return answered | {
        "num_selected": None if answer is None or answer.is_heat else answer.num_selected,
        "num_matches": None if answer is None else len(answer.matches),
        "seconds": sum(watch.seconds.values()),
        "stage_seconds": watch.seconds,
    }


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted

    if "num_frames" in answer:
        width, height = answer["size"]
        print(
            f"{answer['file']}: {counted(answer['num_frames'], 'picture')} of {width}x{height}, "
            f"{answer['film_seconds']:.1f} s at {answer['fps']:g} a second, {answer['bytes'] / 1e6:.1f} MB; "
            f"{answer['frames_per_second']:.1f} pictures a second were made"
        )
    else:
        files = answer["files"]
        print(
            f"{counted(len(files), 'file')} in {answer['seconds']:.1f} s: {files[0]}"
            + (f" ... {files[-1]}" if len(files) > 1 else "")
        )
    if answer["num_matches"] == 0:
        print("No match to highlight.")


def _check(arguments: argparse.Namespace) -> None:
    """Check the options. Raises: InputError: some do not go together."""
    from ...errors import InputError

    films, row = arguments.path is not None, arguments.attributes is not None
    if not (films or row or arguments.view or arguments.all):
        raise InputError("expected a point of view: --path orbit, or --views CAPTURE with --view NAME or --all")
    if (films or row) and arguments.output_dir is None:
        raise InputError("expected --output FILE: " + ("film.mp4, say" if films else "row.png, say"))
    if row and (films or arguments.all):
        raise InputError("attributes: one row of pictures from one view: drop --path and --all")
    of_films = [
        name for name in ("up", "fps", "seconds", "size", "side_by_side") if getattr(arguments, name) is not None
    ]
    of_films += ["around"] if arguments.around != SCENE else []
    if of_films and not films:
        raise InputError(f"--{of_films[0].replace('_', '-')} is of a film: give --path orbit, swing, photos or FILE")
    if films and (arguments.depth or arguments.alpha):
        raise InputError("depth and alpha are of pictures, not of films: drop --depth and --alpha")
    if arguments.views is None and not (films and arguments.path != "photos"):
        raise InputError("expected --views CAPTURE: the poses to render from")
    if (arguments.query is None) != (arguments.field is None):
        raise InputError("--field FIELD and --query WORDS: pass both, or none")
    if arguments.query is None and (row or arguments.boxes or arguments.heat_map):
        raise InputError("attributes, boxes and heat maps are of an answer: give --query WORDS")


def _edited(arguments: argparse.Namespace, scene: Gaussians | Moving) -> Gaussians | Moving:
    """Return the scene with the edits kept beside it; attributes are asked of the scene that was registered."""
    from ...scene.moving import canonical_of

    if arguments.attributes is not None:
        note_own_scene(arguments.scene, canonical_of(scene))
        return scene
    return as_edited(arguments.scene, scene, arguments.edits)


def _answer(arguments: argparse.Namespace) -> tuple[OpenedScene | None, Highlight | None]:
    """Return the scene of --field, and what --query finds in it."""
    from ...authoring.filming.highlights import Highlight
    from ...query import Query

    if arguments.query is None:
        return None, None
    opened = open_scene(arguments)
    query = Query(arguments.query, **values_of(arguments, TEXT_CUT))
    return opened, Highlight.of(opened, query, heat=arguments.heat_map, boxes=arguments.boxes)


def _notes(arguments: argparse.Namespace) -> list[Mark]:
    """Return the annotations that are kept beside the scene, none without --annotations."""
    from ...drawing.labels import notes_of
    from ...formats.annotations import AnnotationFile

    return notes_of(AnnotationFile.beside(arguments.scene).read()) if arguments.annotations else []


def _attributes(arguments: argparse.Namespace, opened: OpenedScene, answer: Highlight | None) -> dict[str, Any]:
    from ...drawing.pictures import write_picture
    from ...errors import InputError
    from ...query import Query
    from ...query.sheets import attribute_row

    output = new_output(arguments.output_dir, arguments.overwrite)
    if answer is None or not answer.matches:
        raise InputError(f"'{arguments.query}' has no match in this scene: there is nothing to show attributes of")
    view = None if arguments.view is None else opened.view(arguments.view)
    attributes = [Query(words, objects=arguments.objects) for words in arguments.attributes]
    write_picture(output, attribute_row(opened, answer.matches[0], attributes, view), arguments.overwrite)
    return {"files": [str(output)], "num_views": 1}


def _stills(
    arguments: argparse.Namespace, scene: Gaussians | Moving, views: list[View], answer: Highlight | None,
    notes: list[Mark],
) -> dict[str, Any]:  # fmt: skip
    from ...field.evidence.columns import time_of
    from ...kernels import splat_arrays
    from ...query import view_named
    from ...scene.moving import Moving

    arguments.output_dir = arguments.output_dir or DEFAULT_FOLDER
    views = views if arguments.all else [view_named(views, arguments.view)]
    splats = None if isinstance(scene, Moving) else splat_arrays(scene, arguments.near)
    written = []
    for view in tracker(arguments)(views, "rendering"):
        here = scene.at(time_of(view)) if isinstance(scene, Moving) else scene
        written += _render(arguments, here, view, splats or splat_arrays(here, arguments.near), answer, notes)
    return {"files": [str(path) for path in written], "num_views": len(views)}


def _render(
    arguments: argparse.Namespace, scene: Gaussians, view: View, splats: SplatArrays, answer: Highlight | None,
    notes: list[Mark],
) -> list[Path]:  # fmt: skip
    import numpy as np

    from ... import render
    from ...drawing.labels import marked
    from ...drawing.pictures import as_pixels, write_picture
    from ...formats.npy import write_npy

    stem = Path(arguments.output_dir) / Path(view.name).with_suffix("")
    paths = {"rgb": stem.with_name(f"{stem.name}.png")}
    paths |= {"alpha": stem.with_name(f"{stem.name}.alpha.png")} if arguments.alpha else {}
    paths |= {"depth": stem.with_name(f"{stem.name}.depth.npy")} if arguments.depth else {}
    for path in paths.values():
        new_output(str(path), arguments.overwrite)
    background, values = BACKGROUNDS[arguments.background], None if answer is None else answer.values
    drawn = render(scene, view, values=values, background=background, threads=arguments.threads, splats=splats)
    pixels = as_pixels(drawn.rgb)
    stem.parent.mkdir(parents=True, exist_ok=True)
    picture = pixels if answer is None else answer.over(drawn, pixels, view, 1.0)
    picture = marked(picture, view, notes)
    write_picture(paths["rgb"], picture, arguments.overwrite)
    if arguments.alpha:
        write_picture(paths["alpha"], (np.clip(drawn.alpha, 0, 1) * 255 + 0.5).astype(np.uint8), arguments.overwrite)
    if arguments.depth:
        write_npy(paths["depth"], drawn.depth, arguments.overwrite)
    return list(paths.values())
