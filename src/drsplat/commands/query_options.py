"""Options of all verbs that search a field, and what they stand for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..defaults import AUTO, RELEVANCY
from .answers import Ask
from .options import (
    add_capture_options,
    add_overwrite,
    add_query_encoders,
    finite,
    new_output,
    views_of,
    words,
)
from .query_inputs import Click, split_click

if TYPE_CHECKING:
    import numpy as np

    from ..asking import Asked
    from ..gaussians import Gaussians
    from ..views import View


def threshold(text: str) -> float | str:
    return AUTO if text == AUTO else finite(text)


def share(text: str) -> float:
    number = finite(text)
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"expected a share above 0, up to 1; got '{text}'")
    return number


FIELD_HELP = "what `drsplat register` wrote, or a folder with a field, its scene and photos"


def add_query_options(parser: argparse.ArgumentParser) -> None:
    """What is looked for, who embeds it, and where its scores are cut."""
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument(
        "text", nargs="?", type=words,
        help="what to look for, in words; 'mug, not red' leaves out what 'red mug' fits as well",
    )  # fmt: skip
    parser.add_argument(
        "--not", dest="unwanted", type=words, action="append", default=[], metavar="WORDS",
        help="as ', not WORDS' in the text; may be given more than once",
    )  # fmt: skip
    parser.add_argument(
        "--vector", metavar="FILE.npy", help="look for this embedding instead of words: (D,) floats"
    )
    parser.add_argument(
        "--image", metavar="PICTURE",
        help="look for what this picture shows instead of words, embedded by --encoder; best cut out, on black or "
        "transparent, as masks are",
    )  # fmt: skip
    parser.add_argument(
        "--click", type=words, metavar="VIEW:X,Y",
        help="look for what is at this pixel of a photo of --views, e.g. photo_003:210,140; needs --scene, and no encoder",
    )  # fmt: skip
    add_query_encoders(parser)
    add_measure_options(parser)


def add_measure_options(parser: argparse.ArgumentParser) -> None:
    """What is measured and where it is cut."""
    cut = parser.add_mutually_exclusive_group()
    cut.add_argument(
        "--threshold", type=threshold, metavar="T|auto",
        help="select Gaussians above this; auto, the default, follows the scene: words of CLIP-like encoders have to "
        "fit better than a list of words; those of a built-in encoder have its own threshold; vectors, pictures and "
        "clicks: 0.6 of the way from the median cosine to the highest ones",
    )  # fmt: skip
    cut.add_argument(
        "--top-share", type=share, metavar="S",
        help="select this share of the Gaussians that have a feature, e.g. 0.02, whatever their scores",
    )  # fmt: skip
    parser.add_argument(
        "--relevancy", action="store_true",
        help="measure LERF's relevancy: how much better the query fits than any negative; 0.5 is as well",
    )  # fmt: skip
    parser.add_argument(
        "--negatives", type=words, metavar="WORDS|FILE.npy",
        help="compare with these, and measure relevancy (default: those stored in the field, else "
        "object,things,stuff,texture)",
    )  # fmt: skip


def add_output_options(parser: argparse.ArgumentParser, saved: str) -> None:
    """--scene, --save, --picture and the poses for it."""
    parser.add_argument(
        "--scene", help="the scene that was registered; needed for places, --save and --picture"
    )
    output = parser.add_argument_group("output")
    output.add_argument("--save", metavar="OUT.ply", help=saved)
    output.add_argument(
        "--picture",
        metavar="OUT.png",
        help="write a photo with what was found in colour, the rest grey",
    )
    output.add_argument("--views", metavar="CAPTURE", help="the poses, for --picture and --click")
    output.add_argument(
        "--view",
        type=words,
        metavar="NAME",
        help="photo for --picture (default: the one that shows most of it)",
    )
    add_overwrite(output)
    add_capture_options(parser)


def take_folder(arguments: argparse.Namespace) -> None:
    """Where a scene's folder was named: its field, and its scene and photos unless others are given.

    Raises: InputError: a folder without a field or a scene. MismatchError: the field is of another scene.
    """
    from ..asking.opening import FIELD_SUFFIX, find_scene, registered_scene
    from ..formats.field_folder import MANIFEST

    folder = Path(arguments.field)
    if not folder.is_dir() or (folder / MANIFEST).exists() or folder.suffix == FIELD_SUFFIX:
        return
    files = find_scene(folder)
    arguments.field = str(files.field)
    arguments.scene = arguments.scene or str(registered_scene(files)[0])
    arguments.views = arguments.views or (files.capture and str(files.capture))


def check_outputs(arguments: argparse.Namespace, suffixes: tuple[str, ...] = (".ply",)) -> None:
    """All that can be known to be wrong before any work is done.

    suffixes: those of --save; a .npy needs no scene.
    """
    from ..errors import InputError

    for option, output in (("--save", arguments.save), ("--picture", arguments.picture)):
        if output is None:
            continue
        folder = new_output(output, arguments.overwrite).parent
        if option == "--save" and not output.lower().endswith(suffixes):
            raise InputError(f"{output}: expected a name that ends in {' or '.join(suffixes)}")
        if not folder.is_dir():
            raise InputError(f"{option}: there is no folder {folder}: make it first")
        if arguments.scene is None and not output.lower().endswith(".npy"):
            raise InputError(f"{option} needs --scene SCENE")
    if arguments.picture is not None and arguments.views is None:
        raise InputError("--picture needs --views CAPTURE, for a place to look from")
    if getattr(arguments, "click", None) is not None and not (arguments.views and arguments.scene):
        raise InputError("--click needs --scene SCENE and --views CAPTURE, the poses of the photos")


def ask_of(arguments: argparse.Namespace, scene: Gaussians | None) -> Ask:
    """What the options of `add_query_options` say."""
    from ..asking import view_named

    click = None
    if arguments.click is not None and scene is not None:
        name, xy = split_click(arguments.click)
        view = view_named(views_of(arguments, arguments.views), name)
        click = Click(scene, view, xy)
    same = ("text", "vector", "image", "vocabulary", "encoder", "device", "relevancy")
    cut = ("negatives", "threshold", "top_share")
    given: dict[str, Any] = {name: getattr(arguments, name) for name in (*same, *cut)}
    return Ask(**given, click=click, unwanted=tuple(arguments.unwanted))


def query_said(arguments: argparse.Namespace) -> str:
    """The query in the words of the command line."""
    nots = "".join(f", not {words}" for words in arguments.unwanted)
    text = f"{arguments.text}{nots}" if arguments.text else None
    return str(text or arguments.image or arguments.vector or arguments.click)


def numbers_of(answer: Asked, num_selected: int) -> dict[str, Any]:
    """What every answer says of its scores; their range without what was left out by a "not"."""
    import numpy as np

    lowest = 0.0 if answer.measure == RELEVANCY else -1.0
    values = answer.values[answer.values > lowest]
    values = values if len(values) else np.full(1, lowest, np.float32)
    return {
        "measure": answer.measure,
        "threshold": answer.threshold,
        "threshold_rule": answer.rule,
        "score_range": [float(values.min()), float(values.max())],
        "score_p99": float(np.percentile(values, 99)),
        "num_registered": len(answer.field),
        "num_selected": num_selected,
    }


RULES = {
    "given": "as given",
    "top share": "for the share asked for",
    "auto": "chosen for this query",
    "list": "as well as the best of a list of words",
    "encoder": "that of the encoder",
    "default": "the default",
}


def measured_said(answer: dict[str, Any]) -> str:
    """The scores and the threshold in a line."""
    low, high = answer["score_range"]
    return (
        f"{answer['measure']} from {low:.3f} to {high:.3f}, 99 of 100 below {answer['score_p99']:.3f}; "
        f"threshold {answer['threshold']:.4g}, {RULES[answer['threshold_rule']]}"
    )


def draw(arguments: argparse.Namespace, scene: Gaussians, ids: np.ndarray, note: str) -> str:
    """Write --picture: the photo, in colour where the Gaussians at `ids` are; returns its name."""
    from ..pictures import highlighted, photo_or_rendering, titled, visible_share, write_picture

    view, threads = chosen_view(arguments, scene, ids), arguments.threads
    share = visible_share(scene, view, ids, threads=threads)
    picture = highlighted(photo_or_rendering(scene, view, threads=threads), share)
    title = query_said(arguments)
    title = f"“{title}”" if arguments.text else title
    write_picture(arguments.picture, titled(picture, title, note), arguments.overwrite)
    return view.name


def chosen_view(arguments: argparse.Namespace, scene: Gaussians, ids: np.ndarray) -> View:
    """The view named, else the one that shows most of the Gaussians at `ids`."""
    from ..asking import view_named
    from ..pictures import best_views

    views = views_of(arguments, arguments.views)
    if arguments.view:
        return view_named(views, arguments.view)
    return best_views(scene, views, [ids], threads=arguments.threads)[0]
