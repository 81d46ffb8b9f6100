"""drsplat render: pictures of a scene from the places of its photos, and films along a path."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.progress import Stopwatch
from ...base.terminal import counted
from ...errors import InputError
from ...query.schema import Place, fields
from .declaring import Facts, argument, declaration, finite, flag, length, option, part, whole, words
from .edit_options import as_edited, kept_edits, note_own_scene
from .options import Encoders, Photos, Verb, near, new_output, overwrite
from .query_options import asked, open_with, values_of

if TYPE_CHECKING:
    from ...authoring.editing.edits import KeptEdits
    from ...authoring.filming.frames import Highlight
    from ...drawing.labels import Mark
    from ...query import Match
    from ...query import Scene as OpenedScene
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.views import View
    from .query_options import Asked

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


EXAMPLES = """\
  drsplat render drsplat-demo --path orbit --query "red vase" --boxes --output vase.webp
  drsplat render scene.ply --views capture --view photo_003 --output-dir renders
  drsplat render scene.ply --views capture --all --max-side 800 --depth
  drsplat render scene.ply --views capture --all --field room.field --query "red mug"
  drsplat render scene.ply --views capture --path orbit --field room.field --query "red mug" --boxes --output mug.mp4
  drsplat render scene.ply --path camera_path.json --fps 24 --size 1920x1080 --output flight.webm
  drsplat render scene.ply --views capture --field room.field --query vase --attributes red blue wooden -o vase.png"""
TEXT_CUT = fields(Place.COMMAND_LINE, Place.WORDS)
DAILY = "views view all path output_dir field query overwrite size seconds"
DEFAULT_FOLDER = "renders"


@declaration
class Options(Verb):
    """Options of this verb."""

    scene: str = argument(
        "Gaussians: .ply, .spz, .sog, .splat, .ksplat or a trained model's folder; or a folder with a field, its scene "
        "and photos"
    )
    views: str | None = option("poses to render from; not needed for a film along FILE or an orbit", "CAPTURE")
    view: str | None = option("name of one photo, with or without suffix", "NAME", words, rivals="which")
    all: bool = flag("render from all photos", rivals="which")
    path: str | None = option(
        "film along a path: an orbit as far as there are photos, a swing of 60 degrees to and fro, through the photos, "
        "or through key frames (saved by the viewer, or nerfstudio's camera_path.json)", "orbit|swing|photos|FILE",
        rivals="which",
    )  # fmt: skip
    output_dir: str | None = option(
        "folder for the PNGs (default: renders); with --path, the film, .mp4, .webm, .webp or .gif; with --attributes, "
        "the picture", "DIR|FILE", flags="--output-dir --output -o",
    )  # fmt: skip
    overwrite: bool = overwrite()
    background: str = background()
    depth: bool = flag(
        "write NAME.depth.npy, too: expected camera z in scene units, float32 (H, W), 0 where the scene is empty"
    )
    alpha: bool = flag("write NAME.alpha.png, too: opacity, 255 where opaque")
    near: float | None = near()
    edits: KeptEdits | None = kept_edits("kept")
    field: str | None = option("field of the scene, for --query")
    query: str | None = option("query whose matches stay in colour while the rest is grey", "WORDS", words)
    cut: Asked = asked(TEXT_CUT)
    boxes: bool = flag("draw the matches of --query with boxes and names")
    heat_map: bool = flag(
        "colour everything by how well it fits --query, yellow-green at the threshold, instead of the matches"
    )
    annotations: bool = flag("draw the annotations that `drsplat edit` keeps beside the scene")
    attributes: list[str] | None = option(
        "draw a row of pictures of the best match of --query: plain, and a heat map for each of these words", "WORDS",
        words, nargs="+",
    )  # fmt: skip
    film: Filming = part(Filming)
    encoders: Encoders = part(Encoders)
    photos: Photos = part(Photos)


def device(options: Options) -> str:
    """Return the device to draw on."""
    return options.encoders.for_kernels


def run(options: Options) -> Facts:
    from ...authoring.filming.frames import Highlight
    from ...drawing.labels import notes_of
    from ...formats.annotations import AnnotationFile
    from ...formats.moving_scenes import read_scene
    from ...query import Query
    from ...scene.moving import canonical_of

    watch, opened, answer = Stopwatch(), None, None
    options, found = _opened_folder(options)
    _check(options)
    own = found or read_scene(options.scene)
    views = [] if options.views is None else options.photos.views(options.views)
    if options.query is not None and options.field is not None:
        opened = open_with(options, options.field, options.scene)
        query = Query(options.query, **values_of(options.cut, TEXT_CUT))
        answer = Highlight.of(opened, query, heat=options.heat_map, boxes=options.boxes)
    notes = notes_of(AnnotationFile.beside(options.scene).read()) if options.annotations else []
    if options.attributes is None:
        scene = as_edited(options.scene, own, options.edits)
    else:  # which are asked of the scene that was registered
        scene = own
        note_own_scene(options.scene, canonical_of(own))
    if answer is not None and scene is not own:
        answer = answer.after_edits(canonical_of(scene))
    watch.lap("read")
    if options.path is not None:
        answered = _film(options, scene, views, answer, opened, notes)
    elif opened is not None and options.attributes is not None:
        answered = _attributes(options, opened, answer)
    else:
        answered = _stills(options, scene, views, answer, notes)
    watch.lap("render")
    return {
        **answered,
        "num_selected": None if answer is None or answer.is_heat else answer.num_selected,
        "num_matches": None if answer is None else len(answer.matches),
        **watch.measures(),
    }


def _opened_folder(options: Options) -> tuple[Options, Gaussians | Moving | None]:
    """Return the options with scene, field and photos of a folder that has them, and the scene; others as they are."""
    from ...query.opening import find_scene, registered_scene

    folder = Path(options.scene)
    if not folder.is_dir() or not any(folder.glob("*.field")):
        return options, None
    files = find_scene(folder)
    path, scene = registered_scene(files)
    field = options.field or (None if options.query is None else str(folder))
    views = options.views or (None if files.capture is None else str(files.capture))
    return replace(options, scene=str(path), field=field, views=views), scene


def show(answer: Facts) -> None:
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


def _check(options: Options) -> None:
    """Check the options. Raises: InputError: some do not go together."""
    films, row = options.path is not None, options.attributes is not None
    if not (films or row or options.view or options.all):
        raise InputError("expected a point of view: --path orbit, or --views CAPTURE with --view NAME or --all")
    if (films or row) and options.output_dir is None:
        raise InputError("expected --output FILE: " + ("film.mp4, say" if films else "row.png, say"))
    if row and (films or options.all):
        raise InputError("attributes: one row of pictures from one view: drop --path and --all")
    of_films = [name for name, value in vars(options.film).items() if value != getattr(Filming(), name)]
    if of_films and not films:
        raise InputError(f"--{of_films[0].replace('_', '-')} is of a film: give --path orbit, swing, photos or FILE")
    if films and (options.depth or options.alpha):
        raise InputError("depth and alpha are of pictures, not of films: drop --depth and --alpha")
    if options.views is None and not (films and options.path != "photos"):
        raise InputError("expected --views CAPTURE: the poses to render from")
    if (options.query is None) != (options.field is None):
        raise InputError("--field FIELD and --query WORDS: pass both, or none")
    if options.query is None and (row or options.boxes or options.heat_map):
        raise InputError("attributes, boxes and heat maps are of an answer: give --query WORDS")


def _film(
    options: Options, scene: Gaussians | Moving, views: list[View], answer: Highlight | None,
    opened: OpenedScene | None, notes: list[Mark],
) -> Facts:  # fmt: skip
    """Write --output; returns what is in it. answer: of --query, and the scene that gave it. notes: drawn over it."""
    from ...authoring.filming.frames import Film
    from ...authoring.filming.looking import named_up
    from ...authoring.filming.planning import path_named, planned
    from ...authoring.filming.writing import check_film, write_film
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    watch, film, beside = Stopwatch(), options.film, None
    up, other = None if film.up is None else named_up(film.up), film.side_by_side
    target = _target(options, answer, opened)
    path = path_named(options.path or "", canonical_of(scene), views, target, up, film.seconds)
    plan = planned(
        path, views=views, fps=film.fps, seconds=film.seconds, size=film.size, sides=1 if other is None else 2
    )  # fmt: skip
    output = new_output(options.output_dir or "", options.overwrite)
    check_film(output, plan.size, plan.fps)
    if other is not None:
        beside = scene if other == SAME_SCENE else as_edited(other, read_scene(other), options.edits)
    filmed = Film(
        scene, plan.views, plan.fps, answer, beside, BACKGROUNDS[options.background], options.near, options.threads,
        notes,
    )  # fmt: skip
    write_film(output, filmed.pictures(options.track(plan.views, "filming")), plan.fps, options.overwrite)
    watch.lap("film")
    return {
        "file": output,
        "num_frames": len(plan.views),
        "fps": plan.fps,
        "film_seconds": plan.seconds,
        "size": plan.size,
        "bytes": output.stat().st_size,
        "frames_per_second": len(plan.views) / watch.seconds["film"],
    }


def _target(options: Options, answer: Highlight | None, opened: OpenedScene | None) -> Match | None:
    """Return the match that --around names; None for the scene. Raises: InputError: it is not there."""
    from ...query.objects import match_of, objects_of

    around = options.film.around
    if around == SCENE:
        return None
    if opened is None or answer is None:
        raise InputError("around: a match or an object is of a field: give --field FIELD and --query WORDS")
    if isinstance(around, int):
        return match_of(opened.field, objects_of(opened.field).thing(around))
    if not answer.matches:
        raise InputError(f"around: '{options.query}' has no match in this scene: ask for something else")
    return answer.matches[0]


def _attributes(options: Options, opened: OpenedScene, answer: Highlight | None) -> Facts:
    from ...drawing.pictures import write_picture
    from ...query import Query
    from ...query.sheets import attribute_row

    output = new_output(options.output_dir or "", options.overwrite)
    if answer is None or not answer.matches:
        raise InputError(f"'{options.query}' has no match in this scene: there is nothing to show attributes of")
    view = None if options.view is None else opened.view(options.view)
    attributes = [Query(words, objects=options.cut["objects"]) for words in options.attributes or ()]
    write_picture(output, attribute_row(opened, answer.matches[0], attributes, view), options.overwrite)
    return {"files": [output], "num_views": 1}


def _stills(
    options: Options, scene: Gaussians | Moving, views: list[View], answer: Highlight | None, notes: list[Mark]
) -> Facts:  # fmt: skip
    import numpy as np

    from ... import render
    from ...drawing.labels import marked
    from ...drawing.pictures import as_pixels, write_picture
    from ...field.evidence.columns import time_of
    from ...formats.npy import write_npy
    from ...kernels import splat_arrays
    from ...query import view_named
    from ...scene.moving import Moving

    views = views if options.view is None else [view_named(views, options.view)]
    splats = None if isinstance(scene, Moving) else splat_arrays(scene, options.near)
    endings = ["png"] + ["alpha.png"] * options.alpha + ["depth.npy"] * options.depth
    values, replaces = None if answer is None else answer.values, options.overwrite
    written: list[Path] = []
    for view in options.track(views, "rendering"):
        here = scene.at(time_of(view)) if isinstance(scene, Moving) else scene
        stem = Path(options.output_dir or DEFAULT_FOLDER) / Path(view.name).with_suffix("")
        paths = {ending: new_output(f"{stem}.{ending}", replaces) for ending in endings}
        drawn = render(
            here, view, values=values, background=BACKGROUNDS[options.background], threads=options.threads,
            splats=splats or splat_arrays(here, options.near),
        )  # fmt: skip
        pixels = as_pixels(drawn.rgb)
        stem.parent.mkdir(parents=True, exist_ok=True)
        picture = pixels if answer is None else answer.over(drawn, pixels, view, 1.0)
        write_picture(paths["png"], marked(picture, view, notes), replaces)
        if options.alpha:
            write_picture(paths["alpha.png"], (np.clip(drawn.alpha, 0, 1) * 255 + 0.5).astype(np.uint8), replaces)
        if options.depth:
            write_npy(paths["depth.npy"], drawn.depth, replaces)
        written += paths.values()
    return {"files": written, "num_views": len(views)}
