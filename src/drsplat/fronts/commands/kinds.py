"""Kinds of values: each reads the text of an option, or says what was expected."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import TYPE_CHECKING

from ...base.terminal import quoted

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_COUNT = 2**31 - 1  # the kernels count with 32 bits
MAX_NUMBER = 3.4e38  # the kernels measure with float32
MIN_POSITIVE = 1e-30


def whole(text: str, least: int = 0, most: int = MAX_COUNT) -> int:
    """Return an option's whole number."""
    digits = text.lstrip("0") or text[:1]
    readable = digits.isascii() and digits.isdecimal() and len(digits) <= len(str(most))
    if not readable or not least <= int(digits) <= most:
        raise argparse.ArgumentTypeError(f"expected a whole number from {least} to {most}, got {quoted(text)}")
    return int(digits)


def count(text: str) -> int:
    """Return an option's positive whole number."""
    return whole(text, least=1)


def count_or_all(text: str) -> int | None:
    return None if text == "all" else count(text)


def up_to(most: int) -> Callable[[str], int]:
    """Return the parser of an option's positive whole number that is no larger."""
    return partial(whole, least=1, most=most)


PORT = up_to(65535)


def finite(text: str) -> float:
    """Return an option's finite number: NaN compares with nothing, and JSON cannot hold it."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise argparse.ArgumentTypeError(f"expected a finite number, got {quoted(text)}")
    return number


def length(text: str) -> float:
    """Return an option's positive number, as scenes are measured."""
    number = finite(text)
    if not number >= MIN_POSITIVE:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {quoted(text)}")
    return number


def words(text: str) -> str:
    """Return an option's text, or a name; a path may be any bytes, but these are compared and kept."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(f"expected text in UTF-8, got {quoted(text)}") from None
    return text
