"""Options of all verbs that search a field, and what they stand for."""

from __future__ import annotations

import argparse
import math
import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.terminal import quoted
from ...errors import FormatError, InputError, placed
from ...query.defaults import AUTO
from ...query.schema import FIELDS, SUBJECTS, Place, QueryField, fields
from .declaring import Facts, Item, argument, declaration, finite, option, part, several, words
from .edit_options import note_own_scene
from .options import Encoders, Photos, new_output, overwrite, search_device

if TYPE_CHECKING:
    from ...base.arrays import Array
    from ...query import Answer, Query, Scene
    from ...query.schema import Kind
    from ...scene.views import View

    Asked = Mapping[str, Any]

FIELD_HELP = "field that `drsplat register` wrote, or a folder with a field, its scene and photos"
TEXT, *OTHER_FIELDS = fields(Place.COMMAND_LINE)
RULES = {
    "given": "as given", "top share": "for the given share", "auto": "chosen for this query",
    "list": "above which the query fits better than a list of other words", "encoder": "that of the encoder",
    "default": "the default", "object": "the whole object at this place", "label": "the objects of this name",
}  # fmt: skip


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


def pixel(text: str) -> tuple[str, float, float]:
    """Return the view's name and the pixel of "photo_003:210,140". Raises: InputError: it has another form."""
    match = re.fullmatch(r"(.+):(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if match is None:
        raise InputError(f"--click {text}: expected VIEW:X,Y in pixels, e.g. photo_003:210,140")
    return match[1], float(match[2]), float(match[3])


def numbers(option: str, count: int, text: str) -> Any:
    """Return the numbers "0.3,-0.14,1.2" of an option. Raises: InputError: not so many finite ones."""
    try:
        given = tuple(float(part) for part in text.split(","))
    except ValueError:
        given = ()
    if len(given) != count or not all(map(math.isfinite, given)):
        raise InputError(f"{option} {text}: expected {count} finite numbers with commas between them")
    return given


def negatives(text: str) -> tuple[str, ...] | Array:
    """Return words with commas between them, or the vectors of a .npy file."""
    if text.endswith(".npy"):
        return read_vectors(text)
    return tuple(word.strip() for word in text.split(","))


def read_picture(path: str) -> Array:
    """Read the RGB of a picture file, upright, on black where it is transparent.

    Raises: InputError: there is no such file. FormatError: damaged, or not a picture.
    """
    from ...scene.photos import decoded_picture

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such picture")
    try:
        return decoded_picture(Path(path))
    except FormatError as error:
        raise FormatError(placed(path, error)) from error


def read_vector(path: str) -> Array:
    """Read one vector of a .npy file, (D,) or (1, D).

    Raises: InputError: there is no such file, or it holds more than one. FormatError: damaged.
    """
    vectors = read_vectors(path)
    if len(vectors) != 1:
        raise InputError(f"{path}: expected one vector, got {len(vectors)}")
    return vectors[0]


def read_vectors(path: str) -> Array:
    """Read the vectors of a .npy file, (n, D) or (D,), as float32.

    Raises: InputError: there is no such file. FormatError: damaged, not numbers.
    """
    import numpy as np

    from ...formats.npy import map_npy

    array = np.atleast_2d(map_npy(Path(path)))
    if array.ndim != 2 or array.dtype.kind != "f" or array.size == 0:
        raise FormatError(f"{path}: expected floats (D,) or (n, D), got {array.dtype} {array.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused with zeros
        return np.ascontiguousarray(array, np.float32)


class Way(NamedTuple):
    """How the command line takes values of a kind: argparse's options, how they are read, and a note to the help."""

    options: Mapping[str, Any]
    read: Callable[[Any], Any] = lambda value: value
    note: str = ""


WAYS: Mapping[Kind, Way] = {
    "text": Way({"type": words}),
    "texts": Way({"type": words, "action": "append", "default": []}, tuple, "; may be repeated"),
    "negatives": Way(
        {"type": words, "metavar": "WORDS|FILE.npy"}, negatives, "; commas between texts; FILE.npy: vectors"
    ),
    "vector": Way({"metavar": "FILE.npy"}, read_vector, ": (D,) floats"),
    "picture": Way({}, read_picture, "; embedded by --encoder"),
    "point": Way({"type": words}, partial(numbers, "--point", 3), ", but --scene"),
    "pixel": Way({"type": words}, pixel, ", but --views and --scene; e.g. photo_003:210,140"),
    "threshold": Way({"type": threshold}),
    "share": Way({"type": share}),
    "flag": Way({"action": "store_true"}),
    "span": Way({"type": finite, "nargs": 2, "metavar": ("START", "END")}, tuple),
    "choice": Way({}),
}


def asked(offered: Iterable[QueryField], title: str = "") -> Asked:
    """Declare an option for each of some fields of a query; their values come by name, not read yet."""
    items = [_item(field, title) for field in offered]
    return several(items, lambda values: {item.name: values[item.name] for item in items})


def _item(field: QueryField, title: str) -> Item:
    way, flag = WAYS[field.kind], f"--{field.name.replace('_', '-')}"
    more: dict[str, Any] = {"choices": field.choices, "default": field.default} if field.choices else {}
    if not field.choices and field.kind != "flag":
        more["metavar"] = field.value
    return Item(
        field.name, [flag], {"help": field.meaning + way.note, **more, **way.options}, title, field.group
    )  # fmt: skip


@declaration
class Question:
    """A question: what is looked for, who embeds it, and where its scores are cut."""

    field: str = argument(FIELD_HELP)
    text: str | None = argument(TEXT.meaning, words, TEXT.value, nargs="?")
    others: Asked = asked(OTHER_FIELDS)
    encoders: Encoders = part(Encoders)
    search_device: str = search_device()

    @property
    def asked(self) -> Asked:
        return {TEXT.name: self.text, **self.others}


@declaration
class Outputs:
    """Place of the scene of an answer, and what is written of it."""

    scene: str | None = option("scene that was registered; needed for positions, --save and --picture")
    save: str | None = option("file to write", "OUT.ply", title="output")
    picture: str | None = option(
        "write a photo with the answer in colour and the rest in grey", "OUT.png", title="output"
    )
    views: str | None = option("poses and photos, for --picture and --click", "CAPTURE", title="output")
    view: str | None = option(
        "photo for --picture (default: the photo that shows most of the answer)", "NAME", words, title="output"
    )
    overwrite: bool = overwrite("output")
    photos: Photos = part(Photos)

    def check(self, suffixes: tuple[str, ...] = (".ply",)) -> None:
        """Check all that can be known to be wrong before any work is done. suffixes: those of --save."""
        check_outputs(self.save, self.picture, self.overwrite, suffixes)

    def open_scene(self, field: str, **others: Any) -> Scene:
        """Open the scene, if --save and --picture can be made of it.

        Raises: InputError: they cannot; as `drsplat.open_scene`.
        """
        from ... import open_scene

        scene = open_scene(field, scene=self.scene, views=self.views, **vars(self.photos), **others)
        drawn = self.picture is not None
        if drawn or (self.save is not None and not self.save.lower().endswith(".npy")):  # which holds no Gaussians
            _ = scene.rows  # or the error that says what is missing, before any work
        if drawn:
            scene.best_view()
        if drawn or self.save is not None:
            note_own_scene(scene.path, scene.rows if scene.has_gaussians else None)
        return scene

    def chosen_view(self, scene: Scene, ids: Array) -> View:
        """Return the named view, else the one that shows most of the Gaussians at `ids`."""
        return scene.view(self.view) if self.view else scene.best_view(ids)


def check_outputs(
    save: str | None, picture: str | None, overwrite: bool, suffixes: tuple[str, ...] = (".ply",)
) -> None:  # fmt: skip
    """Check --save and --picture. Raises: InputError: one exists, has another suffix, or there is no such folder."""
    for flag, output in (("--save", save), ("--picture", picture)):
        if output is None:
            continue
        folder, name = new_output(output, overwrite).parent, output.lower()
        if flag == "--save" and not name.endswith(suffixes):
            raise InputError(f"{output}: expected a name that ends in {' or '.join(suffixes)}")
        if flag == "--picture" and not name.endswith((".jpg", ".jpeg", ".png")):
            raise InputError(f"{output}: pictures are written as .png or .jpg")
        if not folder.is_dir():
            raise InputError(f"{flag}: there is no folder {folder}: make it first")


def ask(
    question: Question, outputs: Outputs, threads: int, suffixes: tuple[str, ...] = (".ply",)
) -> tuple[Scene, Answer]:
    """Open the scene that the options name and ask it; wrong outputs are refused before any work.

    Raises: as `Outputs.check` and `Outputs.open_scene`; InputError: the words stand where the field should.
    """
    outputs.check(suffixes)
    field, text = question.field, question.text
    if text and not Path(field).exists() and Path(text).exists():
        raise InputError(f"the field comes first, then the words: {text} {shlex.quote(field)}")
    scene = outputs.open_scene(
        field, **vars(question.encoders), search_device=question.search_device, threads=threads
    )  # fmt: skip
    return scene, scene.ask(query_of(question.asked))


def open_with(options: Any, field: str, scene: str | None) -> Scene:
    """Open a scene with the views, encoders, photos and threads that a verb's options have.

    Raises: as `drsplat.open_scene`.
    """
    from ... import open_scene

    return open_scene(
        field, scene=scene, views=options.views, threads=options.threads,
        **vars(options.encoders), **vars(options.photos),
    )  # fmt: skip


def values_of(given: Asked, offered: Iterable[QueryField] = FIELDS) -> dict[str, Any]:
    """Return what the options of some fields give, as `Query` takes it."""
    values = {field.name: (WAYS[field.kind].read, given.get(field.name)) for field in offered}
    return {name: read(value) for name, (read, value) in values.items() if value not in (None, [])}


def query_of(given: Asked) -> Query:
    """Return the query that the options of a verb describe."""
    from ...query import Query

    return Query(**values_of(given))


def query_text(given: Asked) -> str:
    """Return the query in the words of the command line."""
    nots = "".join(f", not {words}" for words in given["exclude"])
    return f"{next(given[one.name] for one in SUBJECTS if given[one.name])}{nots}"


def answer_json(question: Question, answer: Answer) -> Facts:
    """Return what every answer says of its values, and what was asked."""
    from ...query.documents import answer_document

    return {"field": question.field, "query": query_text(question.asked), **answer_document(answer)}


def measured_text(answer: Facts) -> str:
    """Return a line of the scores and the threshold."""
    low, high = answer["score_range"]
    return (
        f"{answer['measure']} from {low:.3f} to {high:.3f}, 99 of 100 below {answer['score_p99']:.3f}; "
        f"threshold {answer['threshold']:.4g}, {RULES[answer['threshold_rule']]}"
    )


def print_doubt(answer: Facts) -> None:
    """Print what to know before the answer: why to doubt it, and the photo that sides are meant from."""
    if answer["doubt"]:
        print(f"warning: {answer['doubt']}")
    if answer["seen_from"]:
        print(f"left and right are those of the photo {answer['seen_from']}")


def draw(question: Question, outputs: Outputs, scene: Scene, ids: Array, note: str) -> str:
    """Write --picture: the photo, in colour where the Gaussians at `ids` are; returns its name."""
    from ...drawing.pictures import titled, write_picture

    assert outputs.picture is not None
    view, text = outputs.chosen_view(scene, ids), query_text(question.asked)
    picture = titled(scene.picture(view, ids, photo=True), f"“{text}”" if question.text else text, note)
    write_picture(outputs.picture, picture, outputs.overwrite)
    return view.name
