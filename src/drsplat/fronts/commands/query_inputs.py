"""Values of queries on the command line: texts, numbers, pictures, vectors, pixels, points."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.terminal import quoted
from ...errors import FormatError, InputError, placed
from ...query.defaults import AUTO
from .kinds import finite, words

if TYPE_CHECKING:
    import numpy as np

    from ...query.schema import Kind


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
    import re

    match = re.fullmatch(r"(.+):(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if match is None:
        raise InputError(f"--click {text}: expected VIEW:X,Y in pixels, e.g. photo_003:210,140")
    return match[1], float(match[2]), float(match[3])


def point(text: str) -> tuple[float, float, float]:
    """Return the point "0.3,-0.14,1.2". Raises: InputError: not three finite numbers."""
    x, y, z = numbers("--point", text, 3)
    return x, y, z


def numbers(option: str, text: str, count: int) -> list[float]:
    """Return the numbers "0.3,-0.14,1.2" of an option. Raises: InputError: not so many finite ones."""
    import math

    try:
        given = [float(part) for part in text.split(",")]
    except ValueError:
        given = []
    if len(given) != count or not all(math.isfinite(number) for number in given):
        raise InputError(f"{option} {text}: expected {count} finite numbers with commas between them")
    return given


def negatives(text: str) -> tuple[str, ...] | np.ndarray:
    """Return words with commas between them, or the vectors of a .npy file."""
    if text.endswith(".npy"):
        return read_vectors(text)
    return tuple(word.strip() for word in text.split(","))


def read_picture(path: str) -> np.ndarray:
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


def read_vector(path: str) -> np.ndarray:
    """Read one vector of a .npy file, (D,) or (1, D).

    Raises: InputError: there is no such file, or it holds more than one. FormatError: damaged.
    """

    vectors = read_vectors(path)
    if len(vectors) != 1:
        raise InputError(f"{path}: expected one vector, got {len(vectors)}")
    vector: np.ndarray = vectors[0]
    return vector


def read_vectors(path: str) -> np.ndarray:
    """Read the vectors of a .npy file, (n, D) or (D,), as float32.

    Raises: InputError: there is no such file. FormatError: damaged, not numbers.
    """
    import numpy as np

    from ...formats.npy import map_npy

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file")
    array = np.atleast_2d(map_npy(Path(path)))
    if array.ndim != 2 or array.dtype.kind != "f" or array.size == 0:
        raise FormatError(f"{path}: expected floats (D,) or (n, D), got {array.dtype} {array.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused with zeros
        return np.ascontiguousarray(array, np.float32)


def _same(value: Any) -> Any:
    return value


class Way(NamedTuple):
    """How the command line takes values of a kind: argparse's options, how they are read, and a note to the help."""

    options: Mapping[str, Any]
    read: Callable[[Any], Any] = _same
    note: str = ""


WAYS: Mapping[Kind, Way] = {
    "text": Way({"type": words}),
    "texts": Way({"type": words, "action": "append", "default": []}, tuple, "; may be repeated"),
    "negatives": Way(
        {"type": words, "metavar": "WORDS|FILE.npy"}, negatives, "; commas between texts; FILE.npy: vectors"
    ),
    "vector": Way({"metavar": "FILE.npy"}, read_vector, ": (D,) floats"),
    "picture": Way({}, read_picture, "; embedded by --encoder"),
    "point": Way({"type": words}, point, ", but --scene"),
    "pixel": Way({"type": words}, pixel, ", but --views and --scene; e.g. photo_003:210,140"),
    "threshold": Way({"type": threshold}),
    "share": Way({"type": share}),
    "flag": Way({"action": "store_true"}),
    "span": Way({"type": finite, "nargs": 2, "metavar": ("START", "END")}, tuple),
    "choice": Way({}),
}
