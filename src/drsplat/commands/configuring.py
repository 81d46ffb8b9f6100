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
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..terminal import quoted

NOT_KEPT = ("config", "print_config", "help", "debug", "log")
_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d+)?")


def configured(argv: Sequence[str], parser: argparse.ArgumentParser) -> list[str]:
    """The arguments, with those of the file that --config names; what is given both here and there counts as here.

    Raises: InputError: the file is no TOML, or names what the verb does not have.
    """
    verb = verb_of(parser, argv)
    path = path_of("--config", argv)
    if verb is None or path is None:
        return list(argv)
    name, options = argv[0], _options(verb)
    added: list[str] = []
    for key, value in _chosen(_read(path), name, options, path).items():
        option = options[key]
        if not any(_is_given(flag, argv) for flag in option.option_strings):
            added += _as_arguments(option, value, f"{path}: {key}")
    end = argv.index("--") if "--" in argv else len(argv)
    return [*argv[:end], *added, *argv[end:]]


def configuration(argv: Sequence[str], parser: argparse.ArgumentParser) -> str:
    """TOML of what is given for a verb, and in comments what is not: --config takes it."""
    verb = verb_of(parser, argv)
    assert verb is not None
    options = _options(verb)
    defaults = {key: option.default for key, option in options.items()}
    for action in verb._actions:
        action.default, action.type = argparse.SUPPRESS, None
    given = vars(verb.parse_args(list(argv[1:])))
    lines = [f"[{argv[0]}]"]
    for key, option in options.items():
        if option.dest in given:
            lines.append(f"{key} = {_toml(given[option.dest])}")
        elif defaults[key] is not None and _plain(defaults[key]):
            lines.append(f"# {key} = {_toml(defaults[key])}")
    return "\n".join(lines)


def verb_of(parser: argparse.ArgumentParser, argv: Sequence[str]) -> argparse.ArgumentParser | None:
    """The parser of the verb that comes first."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction) and argv:
            found: argparse.ArgumentParser | None = action.choices.get(argv[0])
            return found
    return None


def _options(verb: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """By their long names without the dashes."""
    long = ((action, flag) for action in verb._actions for flag in action.option_strings[:1] or () if action.dest)
    named = {flag.lstrip("-"): action for action, flag in long if action.dest not in NOT_KEPT}
    return {key: action for key, action in named.items() if len(key) > 1}


def _read(path: str) -> dict[str, Any]:
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected TOML, such as 'threads = 4' under '[register]': {error}") from None


def _chosen(
    tables: dict[str, Any], verb: str, options: dict[str, argparse.Action], path: str
) -> dict[str, Any]:  # fmt: skip
    """What of a file is for the verb: of its own table all, of what stands above the tables what it has."""
    common = {_key(key): value for key, value in tables.items() if not isinstance(value, dict)}
    own = tables.get(verb, {})
    if not isinstance(own, dict):
        raise InputError(f"{path}: expected a table [{verb}], got {verb} = {quoted(str(own))}")
    own = {_key(key): value for key, value in own.items()}
    for key in own.keys() - options.keys():
        raise InputError(f"{path}: {verb} has no option {quoted(key)}; it has {', '.join(options)}")
    return {key: value for key, value in common.items() if key in options} | own


def _key(name: str) -> str:
    return name.replace("_", "-")


def _as_arguments(option: argparse.Action, value: object, where: str) -> list[str]:
    flag, several = option.option_strings[0], option.nargs not in (None, 0)
    if option.nargs == 0:
        if not isinstance(value, bool):
            raise InputError(f"{where}: expected true or false, got {quoted(str(value))}")
        return [flag] if value else []
    values = value if isinstance(value, list) else [value]
    texts = [_text(each, where) for each in values]
    if several:
        return [flag, *texts]
    if len(texts) > 1 and not isinstance(option, argparse._AppendAction):
        raise InputError(f"{where}: expected one value, got {len(texts)}")
    return [f"{flag}={text}" for text in texts]


def _text(value: object, where: str) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{where}: expected a text or a number, got {quoted(str(value))}")
    return str(value)


def _is_given(flag: str, argv: Sequence[str]) -> bool:
    return any(text == flag or (text.startswith(f"{flag}=") and flag.startswith("--")) for text in argv)


def path_of(flag: str, argv: Sequence[str]) -> str | None:
    """The path that the arguments have for an option. None also where it is no path, which is told with the others."""
    path = _value_of(flag, argv)
    return path if path and can_be_a_path(path) else None


def can_be_a_path(text: str) -> bool:
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return False
    return True


def _value_of(flag: str, argv: Sequence[str]) -> str | None:
    for text, after in _pairs(argv):
        if text == flag:
            return after
        if text.startswith(f"{flag}="):
            return text.partition("=")[2]
    return None


def _pairs(argv: Sequence[str]) -> Iterator[tuple[str, str | None]]:
    return zip(argv, [*argv[1:], None], strict=False)


def _plain(value: object) -> bool:
    return isinstance(value, str | int | float) or (isinstance(value, list) and all(map(_plain, value)))


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    text = str(value)
    if _NUMBER.fullmatch(text) and len(text) < 16:
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(each if each.isprintable() else f"\\U{ord(each):08x}" for each in escaped) + '"'
