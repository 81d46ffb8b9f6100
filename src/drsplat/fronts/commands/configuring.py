"""--config FILE and --print-config: the options of a verb in a file of TOML.

threads = 4                  # for every verb that has such an option

[register]
features = "capture/language_features"
level = "large"
"""

from __future__ import annotations

import argparse
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from ...base.system import NO_WAITING, OWN_FILE_FLAGS, can_be_a_path
from ...base.terminal import counted, plain, quoted
from ...errors import InputError

OPTIONS_NOT_KEPT = ("config", "print_config", "help", "help_all", "debug", "log")
MAX_FILE_BYTES = 1 << 15  # tomllib's time grows with the square of the length of some lines
MIN_LIKENESS = 0.7  # of difflib, from 0 to 1; a slip of one letter in four is still recognised
_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d+)?")


class Given(NamedTuple):
    """One use of an option: its action, and the texts that came with it."""

    option: argparse.Action
    texts: list[str]


def uses_of(path: str, verb: str, options: Mapping[str, argparse.Action]) -> Iterator[tuple[str, Given]]:
    """Return each use of an option of a verb that a file has, with its name there.

    Raises: InputError: the file is no TOML, or has what the verb does not take. OSError: it cannot be read.
    """
    for key, value in _chosen(_tables(path), verb, options, path).items():
        for texts in _uses(options[key], value, f"{path}: {key}"):
            yield key, Given(options[key], texts)


def configuration(verb: str, options: Mapping[str, argparse.Action], given: Iterable[Given]) -> str:
    """Return TOML of what a line gives for a verb, and in comments the defaults of the rest.

    Raises: InputError: TOML cannot hold it.
    """
    uses = [use for use in given if use.option in options.values()]
    # refuse a sequence that returns to an option: a table has each key once
    sequence = [use.option for use in uses if hasattr(use.option, "sequence")]
    groups = [option for at, option in enumerate(sequence) if at == 0 or sequence[at - 1] is not option]
    for option in groups:
        bare = option.nargs == 0 and sequence.count(option) > 1
        if bare or groups.count(option) > 1:
            flag = option.option_strings[0]
            raise InputError(f"{flag} {counted(sequence.count(option), 'time')}: a file of TOML has each option once")
    keys = {option: key for key, option in options.items()}
    lines = [f"{keys[option]} = {_value(option, uses)}" for option in dict.fromkeys(use.option for use in uses)]
    rest = {key: option.default for key, option in options.items() if option not in {use.option for use in uses}}
    lines += [f"# {key} = {_toml(default)}" for key, default in rest.items() if _is_plain(default)]
    return "\n".join([f"[{verb}]", *lines])


def options_of(options: Iterable[argparse.Action]) -> dict[str, argparse.Action]:
    """Return the options that a file can set, by their long names without the dashes."""
    kept = (option for option in options if option.dest not in OPTIONS_NOT_KEPT)
    return {next(flag for flag in option.option_strings if flag.startswith("--"))[2:]: option for option in kept}


def table_keys(path: str) -> dict[str, set[str]]:
    """Return the options that each table of a file of --config sets, by the tables' names.

    Raises: InputError: the file is no TOML. OSError: it cannot be read.
    """
    return {name: {_key(key) for key in own} for name, own in _tables(path).items() if isinstance(own, dict)}


def place(option: argparse.Action) -> str:
    """Return the name under which an option's value is kept, several options' together where they are a sequence."""
    return str(getattr(option, "sequence", option.dest))


def _tables(path: str) -> dict[str, Any]:
    import tomllib

    content, fault = _content(path), ""
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        fault = plain(str(error))[:200]
    except RecursionError:
        fault = "brackets in brackets, too deep to read"
    except ValueError:  # of thousands of digits
        fault = "a number is too long to read"
    raise InputError(f"{path}: expected TOML, such as 'threads = 4' under '[register]': {fault}")


def _content(path: str) -> bytes:
    """Read a regular file without waiting: a pipe could block for ever, a device has no end."""
    if not can_be_a_path(path):
        raise InputError(f"--config: expected text in UTF-8, got {quoted(path)}")
    number = os.open(path, os.O_RDONLY | NO_WAITING | OWN_FILE_FLAGS)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise InputError(f"{path}: expected a file of TOML, this is a folder, a pipe or a device")
    with open(number, "rb") as file:
        content = file.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        raise InputError(f"{path}: expected a file of options, at most {MAX_FILE_BYTES:,} bytes")
    return content


def _chosen(
    tables: dict[str, Any], verb: str, options: Mapping[str, argparse.Action], path: str
) -> dict[str, Any]:  # fmt: skip
    """Return a verb's settings: all of its own table, and of what stands above the tables what the verb has."""
    common = {_key(key): value for key, value in tables.items() if not isinstance(value, dict)}
    own = tables.get(verb, {})
    if not isinstance(own, dict):
        raise InputError(f"{path}: expected a table [{verb}], got {verb} = {quoted(str(own))}")
    own = {_key(key): value for key, value in own.items()}
    for key in own.keys() - options.keys():
        hint = did_you_mean(key, options) or f"; it has {', '.join(options)}"
        raise InputError(f"{path}: {verb} has no option {quoted(key)}{hint}")
    return {key: value for key, value in common.items() if key in options} | own


def _key(name: str) -> str:
    return name.replace("_", "-")


def _uses(option: argparse.Action, value: object, where: str) -> list[list[str]]:
    """Return the texts of each use of an option that a value of TOML stands for."""
    if isinstance(value, bool) and option.nargs in (0, argparse.OPTIONAL):
        return [[]] if value else []
    if option.nargs == 0:
        raise InputError(f"{where}: expected true or false, got {quoted(_shown(value))}")
    if not isinstance(value, list):
        return [[_text(value, where)]]
    if not _repeats(option):
        return [[_text(each, where) for each in value]]
    if option.nargs is None or any(isinstance(each, list) for each in value):
        return [[_text(part, where) for part in (each if isinstance(each, list) else [each])] for each in value]
    return [[_text(each, where) for each in value]]


def _repeats(option: argparse.Action) -> bool:
    return isinstance(option, argparse._AppendAction) or hasattr(option, "sequence")


def _text(value: object, where: str) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{where}: expected a text or a number, got {quoted(_shown(value))}")
    return _shown(value)


def _shown(value: object) -> str:
    try:
        return str(value)
    except (ValueError, RecursionError):  # thousands of digits, or of brackets
        return f"a {type(value).__name__} that is too long"


def _value(option: argparse.Action, uses: list[Given]) -> str:
    """Return the TOML of all uses of one option."""
    texts = [use.texts for use in uses if use.option is option]
    if not _repeats(option):
        texts = texts[-1:]  # the last one counts
    if not texts[0]:
        return "[]" if option.nargs == argparse.ZERO_OR_MORE else "true"
    if option.nargs in (None, argparse.OPTIONAL):
        values = [use[0] for use in texts]
        return _toml(values if _repeats(option) and len(values) > 1 else values[0])
    return _toml(texts if len(texts) > 1 else texts[0])


def _is_plain(value: object) -> bool:
    if isinstance(value, list):
        return all(map(_is_plain, value))
    return isinstance(value, str | int | float) and value != argparse.SUPPRESS


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    text = str(value)
    if _NUMBER.fullmatch(text) and len(text) < 16 and text == str(float(text) if "." in text else int(text)):
        return text
    try:
        text.encode()
    except UnicodeEncodeError:
        raise InputError(f"--print-config: a file of TOML holds text in UTF-8, got {quoted(text)}") from None
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(each if each.isprintable() else f"\\U{ord(each):08x}" for each in escaped) + '"'


def did_you_mean(text: str, names: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the name that resembles a text most, or nothing if none does."""
    from difflib import get_close_matches

    bare = {name.lstrip("-").lower(): name for name in names if len(name.lstrip("-")) > 1}
    meant = text.lstrip("-").replace("_", "-").lower()
    begins = [name for name in bare if len(meant) > 2 and name.startswith(meant)]
    nearest = get_close_matches(meant[:99], bare, 1, MIN_LIKENESS) or begins[:1]
    return f"; did you mean {bare[nearest[0]]}?" if nearest else ""
