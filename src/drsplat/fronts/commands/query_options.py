"""Options of all verbs that search a field, and what they stand for."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.terminal import quoted
from ...query.defaults import AUTO, NEVER
from .edit_options import note_own_scene
from .options import (
    CAPTURE_OPTIONS,
    add_capture_options,
    add_overwrite,
    add_query_encoders,
    add_search_device,
    finite,
    new_output,
    words,
)
from .query_inputs import negatives, pixel, point, read_picture, read_vector

if TYPE_CHECKING:
    import numpy as np

    from ...query import Answer, Cut, Query, Scene
    from ...scene.views import View


def threshold(text: str) -> float | str:
    """Return an option's threshold."""
    if text == AUTO:
        return text
    return _fraction(text, f"a number such as 0.5, or {AUTO}")


def share(text: str) -> float:
    """Return an option's share."""
    number = _fraction(text, "a share above 0, up to 1")
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"expected a share above 0, up to 1; got '{text}'")
    return number


def _fraction(text: str, expected: str) -> float:
    """Return an option's number. Raises: argparse.ArgumentTypeError: no number; of "50%" it says what to write."""
    try:
        return finite(text)
    except argparse.ArgumentTypeError:
        cure = ": write 0.5 for 50%" if text.endswith("%") else ""
        raise argparse.ArgumentTypeError(f"expected {expected}, got {quoted(text)}{cure}") from None


WITHOUT_SCENE = (".npy", ".json", ".csv")  # outputs that hold no Gaussians
FIELD_HELP = "field that `drsplat register` wrote, or a folder with a field, its scene and photos"


def add_query_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is looked for, who embeds it, and where its scores are cut."""
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument(
        "text", nargs="?", type=words, metavar="WORDS",
        help="query in words; 'mug, not red' excludes what 'red mug' fits as well",
    )  # fmt: skip
    add_query_kinds(parser)
    add_query_encoders(parser)
    add_search_device(parser)
    add_measure_options(parser)


def add_query_kinds(parser: argparse._ActionsContainer) -> None:
    """Add the options of queries that are no text."""
    parser.add_argument(
        "--exclude", type=words, action="append", default=[], metavar="WORDS",
        help="words to exclude, as ', not WORDS' in the text does; may be repeated",
    )  # fmt: skip
    parser.add_argument("--vector", metavar="FILE.npy", help="embedding to search for instead of words: (D,) floats")
    parser.add_argument(
        "--image", metavar="PICTURE",
        help="picture to search for instead of words, embedded by --encoder; best cut out, on black or "
        "transparent, as masks are",
    )  # fmt: skip
    parser.add_argument(
        "--click", type=words, metavar="VIEW:X,Y",
        help="pixel of a photo of --views to search for more of, e.g. photo_003:210,140; needs --scene, no encoder",
    )  # fmt: skip
    parser.add_argument(
        "--point", type=words, metavar="X,Y,Z",
        help="point of the world to search for more of, in scene units; needs --scene, no encoder",
    )  # fmt: skip


def add_measure_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is measured and where it is cut."""
    cut = parser.add_mutually_exclusive_group()
    cut.add_argument(
        "--threshold", type=threshold, metavar="T|auto",
        help="select Gaussians that score above this (default: auto, which follows the scene: words of CLIP-like "
        "encoders have to fit better than a list of words, those of a built-in encoder exceed its own threshold; for "
        "vectors, pictures and clicks it lies 0.6 of the way from the median cosine to the highest ones)",
    )  # fmt: skip
    cut.add_argument(
        "--top-share", type=share, metavar="S",
        help="select this share of the Gaussians that have a feature, e.g. 0.02, whatever their scores",
    )  # fmt: skip
    parser.add_argument(
        "--relevancy", action="store_true",
        help="measure LERF's relevancy instead of cosine: how much better the query fits than any negative; 0.5 is a "
        "tie",
    )  # fmt: skip
    parser.add_argument(
        "--negatives", type=words, metavar="WORDS|FILE.npy",
        help="texts or vectors to measure relevancy against, which implies --relevancy (default: those stored in the "
        "field, else object,things,stuff,texture)",
    )  # fmt: skip
    _add_during(parser)
    add_objects(parser)


def _add_during(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--during", type=finite, nargs=2, metavar=("START", "END"),
        help="span of time of a scene that moves: only what photos of it have shown is asked (default: all times)",
    )  # fmt: skip


def add_objects(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--objects", choices=(AUTO, NEVER), default=AUTO,
        help="auto: objects answer as wholes, where the field has them; never: every Gaussian answers for itself "
        "(default: auto)",
    )  # fmt: skip


def add_output_options(parser: argparse.ArgumentParser, saved: str) -> None:
    """--scene, --save, --picture and the poses for it."""
    parser.add_argument("--scene", help="scene that was registered; needed for places, --save and --picture")
    output = parser.add_argument_group("output")
    output.add_argument("--save", metavar="OUT.ply", help=saved)
    output.add_argument(
        "--picture", metavar="OUT.png", help="write a photo with the answer in colour and the rest grey"
    )
    output.add_argument("--views", metavar="CAPTURE", help="poses and photos, for --picture and --click")
    output.add_argument(
        "--view", type=words, metavar="NAME",
        help="photo for --picture (default: the one that shows most of the answer)",
    )  # fmt: skip
    add_overwrite(output)
    add_capture_options(parser)


def check_outputs(arguments: argparse.Namespace, suffixes: tuple[str, ...] = (".ply",)) -> None:
    """All that can be known to be wrong before any work is done.

    suffixes: those of --save; a .npy needs no scene.
    """
    from ...errors import InputError

    for option, output in (("--save", arguments.save), ("--picture", arguments.picture)):
        if output is None:
            continue
        folder = new_output(output, arguments.overwrite).parent
        if option == "--save" and not output.lower().endswith(suffixes):
            raise InputError(f"{output}: expected a name that ends in {' or '.join(suffixes)}")
        if not folder.is_dir():
            raise InputError(f"{option}: there is no folder {folder}: make it first")


def ask(arguments: argparse.Namespace, suffixes: tuple[str, ...] = (".ply",)) -> tuple[Scene, Answer]:
    """Open the scene that the options name and ask it; wrong outputs are refused before any work.

    Raises: as `check_outputs` and `open_scene`.
    """
    check_outputs(arguments, suffixes)
    scene = open_scene_for_output(arguments)
    return scene, scene.ask(query_of(arguments))


SCENE_OPTIONS = ("scene", "views", "encoder", "vocabulary", "device", "search_device", "threads")


def open_scene(arguments: argparse.Namespace, field: str | None = None) -> Scene:
    """Open the scene of the options: --scene, --views, those of encoders and captures, and a field.

    field: None for the verb's own.

    Raises: as `drsplat.open_scene`.
    """
    from ... import open_scene as opened

    _refuse_swapped(arguments)
    given = {name: value for name, value in vars(arguments).items() if name in SCENE_OPTIONS + CAPTURE_OPTIONS}
    return opened(field or arguments.field, **given)


def _refuse_swapped(arguments: argparse.Namespace) -> None:
    """Refuse words in the place of the field where the field stands in theirs."""
    from ...errors import InputError

    field, text = getattr(arguments, "field", None), getattr(arguments, "text", None)
    if isinstance(field, str) and text and not Path(field).exists() and Path(text).exists():
        raise InputError(f"the field comes first, then the words: {text} {shlex.quote(field)}")


def open_scene_for_output(arguments: argparse.Namespace) -> Scene:
    """Open the scene, if --save and --picture can be made of it. Raises: InputError: they cannot; as `open_scene`."""
    scene = open_scene(arguments)
    drawn = arguments.picture is not None
    if drawn or (arguments.save is not None and not arguments.save.lower().endswith(WITHOUT_SCENE)):
        _ = scene.gaussians  # or the error that says what is missing, before any work
    if drawn:
        scene.best_view()
    if drawn or arguments.save is not None:
        note_own_scene(scene.path, scene.gaussians if scene.has_gaussians else None)
    return scene


def query_of(arguments: argparse.Namespace) -> Query:
    """Return the query that the options of `add_query_options` describe."""
    from ...query import Query

    given: dict[str, Any] = {
        "vector": arguments.vector and read_vector(arguments.vector),
        "image": arguments.image and read_picture(arguments.image),
        "point": arguments.point and point(arguments.point),
        "click": arguments.click and pixel(arguments.click),
    }
    return Query(arguments.text, **given, exclude=tuple(arguments.exclude), **vars(cut_of(arguments)))


def cut_of(arguments: argparse.Namespace) -> Cut:
    """Return the values of the options of `add_measure_options`."""
    from ...query import Cut

    return Cut(
        threshold=arguments.threshold,
        top_share=arguments.top_share,
        relevancy=arguments.relevancy,
        negatives=arguments.negatives and negatives(arguments.negatives),
        during=arguments.during and tuple(arguments.during),
        objects=arguments.objects,
    )


def query_text(arguments: argparse.Namespace) -> str:
    """Return the query in the words of the command line."""
    nots = "".join(f", not {words}" for words in arguments.exclude)
    text = f"{arguments.text}{nots}" if arguments.text else None
    return str(text or arguments.image or arguments.vector or arguments.click or arguments.point)


def answer_json(arguments: argparse.Namespace, answer: Answer) -> dict[str, Any]:
    """Return what every answer tells of its values; their range is without what a "not" left out."""
    import numpy as np

    values = answer.values[answer.values > answer.lowest]
    values = values if len(values) else np.full(1, answer.lowest, np.float32)
    return {
        "field": arguments.field,
        "query": query_text(arguments),
        "measure": answer.measure,
        "threshold": answer.threshold,
        "threshold_rule": answer.rule,
        "score_range": [float(values.min()), float(values.max())],
        "score_p99": float(np.percentile(values, 99)),
        "num_registered": len(answer.field),
        "num_selected": len(answer.gaussian_ids),
        "doubt": answer.doubt,
    }


RULES = {
    "given": "as given", "top share": "for the given share", "auto": "chosen for this query",
    "list": "above which the query fits better than a list of other words", "encoder": "that of the encoder",
    "default": "the default", "object": "the whole object at this place", "label": "the objects of this name",
}  # fmt: skip


def measured_text(answer: dict[str, Any]) -> str:
    """Return a line of the scores and the threshold, and a warning line if the answer is doubtful."""
    low, high = answer["score_range"]
    doubt = f"\nwarning: {answer['doubt']}" if answer["doubt"] else ""
    return (
        f"{answer['measure']} from {low:.3f} to {high:.3f}, 99 of 100 below {answer['score_p99']:.3f}; "
        f"threshold {answer['threshold']:.4g}, {RULES[answer['threshold_rule']]}{doubt}"
    )


def draw(arguments: argparse.Namespace, scene: Scene, ids: np.ndarray, note: str) -> str:
    """Write --picture: the photo, in colour where the Gaussians at `ids` are; returns its name."""
    from ...drawing.pictures import titled, write_picture

    view = chosen_view(arguments, scene, ids)
    title = f"“{query_text(arguments)}”" if arguments.text else query_text(arguments)
    picture = titled(scene.picture(view, ids, photo=True), title, note)
    write_picture(arguments.picture, picture, arguments.overwrite)
    return view.name


def chosen_view(arguments: argparse.Namespace, scene: Scene, ids: np.ndarray) -> View:
    """Return the named view, else the one that shows most of the Gaussians at `ids`."""
    return scene.view(arguments.view) if arguments.view else scene.best_view(ids)
