"""Options of verbs as fields of dataclasses: each is declared once, and the parser, help and settings follow from it.

    @declaration
    class Options(Verb):
        scene: str = argument("scene that was registered")
        topk: int = option("Gaussians per pixel (default: 40)", "K", count, 40)
        photos: Photos = part(Photos)

A verb's `run` takes its Options and nothing else, from the command line, a scan or Python. What several verbs share is
a dataclass too, which they hold as a part; so a function asks for the part that it needs. TITLE of a dataclass is the
section of its options in the help.

Kinds of values: each reads the text of an option, or says what was expected.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, dataclass_transform

from ...base.terminal import quoted

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


T = TypeVar("T")
Facts = dict[str, Any]
"""Answer of a verb, by name: a JSON object, but for NumPy's numbers and arrays, and paths."""


@dataclass_transform(frozen_default=True, kw_only_default=True)
def declaration(declared: type[T]) -> type[T]:
    """Make a class of options a dataclass."""
    return dataclass(frozen=True, kw_only=True)(declared)


class Item(NamedTuple):
    """An argument of a line.

    flags: none of a positional one. settings: as argparse takes them. title: of its section in the help. rivals: name
    of a group of which one can be given.
    """

    name: str
    flags: Sequence[str]
    settings: Mapping[str, Any]
    title: str = ""
    rivals: str = ""


def argument(meaning: str, kind: Callable[[str], Any] | None = None, value: str | None = None, **more: Any) -> Any:
    """Declare a positional argument. more: nargs and choices, as in argparse."""
    default: dict[str, Any] = {"default": None} if more.get("nargs") in ("?", "*") else {}
    settings = {"help": meaning, "type": kind, "metavar": value, **more}
    return field(**default, metadata={"settings": settings})


def option(
    meaning: str, value: Any = None, kind: Callable[[str], Any] | None = None, default: Any = None, *,
    flags: str = "", title: str = "", rivals: str = "", **more: Any,
) -> Any:  # fmt: skip
    """Declare an option with a value.

    Args:
        meaning: its help.
        value: what the help calls its value, with the unit.
        kind: reads the text of a value.
        default: value where it is not given.
        flags: other spellings, with spaces between; a long one stands instead of --NAME.
        title: section of the help.
        rivals: name of a group of options of which one can be given.
        more: nargs, const, choices, action and required, as in argparse.
    """
    given = {"metavar": value, "type": kind}
    settings = {"help": meaning, "default": default, **{name: one for name, one in given.items() if one}, **more}
    about = {"flags": flags, "title": title, "rivals": rivals, "settings": settings}
    if more.get("required"):
        return field(metadata=about)
    return field(default_factory=partial(copy, default), metadata=about)


def flag(meaning: str, **more: Any) -> Any:
    """Declare an option without a value, False where it is not given. more: flags, title and rivals of `option`."""
    return option(meaning, default=False, action="store_true", **more)


def part(declared: type[T], title: str = "", **others: Mapping[str, Any]) -> T:
    """Declare all options of another dataclass, whose values are one value. others: settings that differ, by name."""
    return several([*items_of(declared, title, others)], lambda given: made(declared, given))


def several(items: Sequence[Item], make: Callable[[Mapping[str, Any]], Any]) -> Any:
    """Declare arguments whose values are one value. make: returns it, of the line's values by name."""
    defaults = {item.name: item.settings.get("default") for item in items}
    return field(default_factory=lambda: make(defaults), metadata={"items": items, "make": make})


def items_of(
    declared: type, title: str = "", others: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
) -> Iterator[Item]:
    """Return the arguments that a dataclass declares, in order, without those of its bases."""
    title = title or getattr(declared, "TITLE", "")
    of_bases = {one.name for base in declared.__bases__ if is_dataclass(base) for one in fields(base)}
    for one in fields(declared):
        about = {} if one.name in of_bases else one.metadata
        if "items" in about:
            yield from (item if item.title else item._replace(title=title) for item in about["items"])
        elif "flags" in about:
            flags, settings = about["flags"].split(), about["settings"] | others.get(one.name, {})
            if not any(flag.startswith("--") for flag in flags):
                flags.insert(0, f"--{one.name.replace('_', '-')}")
            yield Item(one.name, flags, settings, about["title"] or title, about["rivals"])
        elif about:
            settings = about["settings"]
            value = None if settings.get("choices") else one.name.upper()  # choices are their own names
            yield Item(one.name, (), {**settings, "metavar": settings["metavar"] or value}, title)


def add_options(parser: argparse.ArgumentParser, items: Iterable[Item]) -> None:
    """Add arguments to a parser, in their sections and groups."""
    sections: dict[str, argparse._ActionsContainer] = {"": parser}
    rivals: dict[str, argparse._ActionsContainer] = {}
    for name, flags, settings, title, group in items:
        if title not in sections:
            sections[title] = parser.add_argument_group(title)
        if group and group not in rivals:
            rivals[group] = sections[title].add_mutually_exclusive_group()
        kept = {**settings, "dest": name} if flags else settings
        rivals.get(group, sections[title]).add_argument(*(flags or (name,)), **kept)


def made(declared: type[T], given: Mapping[str, Any]) -> T:
    """Return a dataclass of options of a line's values by name."""
    own = {
        one.name: one.metadata["make"](given) if "make" in one.metadata else given[one.name]
        for one in fields(declared)  # type: ignore[arg-type]
        if one.metadata
    }  # fmt: skip
    return declared(**own)
