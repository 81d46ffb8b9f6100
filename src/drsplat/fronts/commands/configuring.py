"""--config FILE and --print-config: the options of a verb in a file of TOML.

threads = 4                  # for every verb that has such an option

[register]
features = "capture/language_features"
level = "large"
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

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
    """Return each use of an option that a file has for a verb, with its name there.

    All of the verb's own table counts, and of what stands above the tables what the verb has.

    Raises: InputError: the file is no TOML, or has what the verb does not take. OSError: it cannot be read.
    """
    tables = tables_of(path)
    own = tables.get(verb, {})
    if not isinstance(own, dict):
        raise InputError(f"{path}: expected a table [{verb}], got {verb} = {quoted(str(own))}")
    for key in own.keys() - options.keys():
        hint = did_you_mean(key, options) or f"; it has {', '.join(options)}"
        raise InputError(f"{path}: {verb} has no option {quoted(key)}{hint}")
    common = {key: value for key, value in tables.items() if key in options and not isinstance(value, dict)}
    for key, value in (common | own).items():
        for texts in _uses(options[key], value, f"{path}: {key}"):
            yield key, Given(options[key], texts)


def configuration(verb: str, options: Mapping[str, argparse.Action], given: Sequence[Given]) -> str:
    """Return TOML of what a line gives for a verb, and in comments the defaults of the rest.

    Raises: InputError: TOML cannot hold it.
    """
    uses: dict[str, list[list[str]]] = {}
    keys = {option: key for key, option in options.items()}
    last = None
    for option, texts in given:
        if option not in keys:
            continue
        key = keys[option]
        if hasattr(option, "sequence"):  # which cannot return to an option: a table has each key once
            if key in uses and (option.nargs == 0 or key != last):
                number = counted(sum(use.option is option for use in given), "time")
                raise InputError(f"--{key} {number}: a file of TOML has each option once")
            last = key
        uses.setdefault(key, []).append(texts)
    lines = [f"{key} = {_value(options[key], texts)}" for key, texts in uses.items()]
    rest = {key: option.default for key, option in options.items() if key not in uses}
    lines += [f"# {key} = {_toml(default)}" for key, default in rest.items() if _is_plain(default)]
    return "\n".join([f"[{verb}]", *lines])


def name_of(option: argparse.Action) -> str:
    """Return the long name of an option without the dashes; nothing of a positional argument."""
    return next((flag[2:] for flag in option.option_strings if flag.startswith("--")), "")


def options_of(options: Iterable[argparse.Action]) -> dict[str, argparse.Action]:
    """Return the options that a file can set, by their long names without the dashes."""
    return {name_of(option): option for option in options if option.dest not in OPTIONS_NOT_KEPT}


def place(option: argparse.Action) -> str:
    """Return the name under which an option's value is kept, several options' together where they are a sequence."""
    return str(getattr(option, "sequence", option.dest))


def tables_of(path: str) -> dict[str, Any]:
    """Return what a file of --config has, and in its tables; names have dashes as on the line.

    Raises: InputError: the file is no TOML. OSError: it cannot be read.
    """
    import tomllib

    from ...base.contents import open_file

    with open_file(path) as file:
        content = file.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        raise InputError(f"{path}: expected a file of options, at most {MAX_FILE_BYTES:,} bytes")
    try:
        tables = _with_dashes(tomllib.loads(content.decode("utf-8-sig")))
        return {name: _with_dashes(own) if isinstance(own, dict) else own for name, own in tables.items()}
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        fault = plain(str(error))[:200]
    except RecursionError:
        fault = "brackets in brackets, too deep to read"
    except ValueError:  # of thousands of digits
        fault = "a number is too long to read"
    raise InputError(f"{path}: expected TOML, such as 'threads = 4' under '[register]': {fault}")


def _with_dashes(table: dict[str, Any]) -> dict[str, Any]:
    return {name.replace("_", "-"): value for name, value in table.items()}


def _uses(option: argparse.Action, value: object, where: str) -> list[list[str]]:
    """Return the texts of each use of an option that a value of TOML stands for."""
    if isinstance(value, bool) and option.nargs in (0, argparse.OPTIONAL):
        return [[]] if value else []
    if option.nargs == 0:
        raise InputError(f"{where}: expected true or false, got {quoted(_shown(value))}")
    uses = _listed(value)
    if _repeats(option) and (option.nargs is None or any(isinstance(use, list) for use in uses)):
        return [[_text(part, where) for part in _listed(use)] for use in uses]
    return [[_text(part, where) for part in uses]]


def _listed(value: object) -> list[Any]:
    return value if isinstance(value, list) else [value]


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


def _value(option: argparse.Action, uses: list[list[str]]) -> str:
    """Return the TOML of all uses of one option."""
    kept = uses if _repeats(option) else uses[-1:]  # the last one counts
    if not kept[0]:
        return "[]" if option.nargs == argparse.ZERO_OR_MORE else "true"
    values = [use[0] for use in kept] if option.nargs in (None, argparse.OPTIONAL) else kept
    return _toml(values if len(values) > 1 else values[0])


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
