"""argparse with help in two lengths, errors that name what was meant, and a record of what the line gives."""

import argparse
import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from ...base.terminal import counted, quoted
from ...errors import InputError
from .configuring import Given, configuration, did_you_mean, name_of, options_of, place, uses_of

MAX_SHORT_EXAMPLES = 3
_NO_BREAK = "\xa0"
_COMMAND = re.compile(r"^  drsplat .*(?:(?<=\\)\n.*)*", re.MULTILINE)


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Formatter that fills prose and keeps the lines of commands."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        blocks = text.split("\n\n")
        return "\n\n".join("\n".join(_block(block.splitlines(), width, indent)) for block in blocks)

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)


def _block(lines: list[str], width: int, indent: str) -> list[str]:
    """Return lines in a width: commands and lists, which are indented, each by itself, and prose filled."""
    made: list[str] = []
    prose: list[str] = []
    for line in [*re.sub(r" \\\n +", " ", "\n".join(lines)).split("\n"), "  "]:  # with those put together that go on
        if not line.startswith("  "):
            prose.append(line)
            continue
        made += textwrap.wrap(
            " ".join(prose), width, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
        )
        prose = []
        made += _command(indent + line, width) if line.strip() else []
    return made


def _command(line: str, width: int) -> list[str]:
    """Return a command in lines that end before an option, so that the option's value stays with it."""
    if len(line) <= width:
        return [line]
    whole = re.sub(r"(?<=\S) (?=[^\s-])", _NO_BREAK, line)
    parts = textwrap.wrap(whole, width - 2, subsequent_indent="      ", break_long_words=False, break_on_hyphens=False)
    parts = [part.replace(_NO_BREAK, " ") for part in parts]
    return [*(f"{part} \\" for part in parts[:-1]), parts[-1]]


class UsageError(Exception):
    """A misuse that argparse found; raised instead of printed so that --json and --log apply to it."""


class Parser(argparse.ArgumentParser):
    """The parser of the whole line; `VerbParser` is that of a verb.

    needed: actions that the line has to name, which argparse does not hear of while it parses.
    """

    def __init__(self, **settings: Any) -> None:
        self.needed: list[argparse.Action] = []
        super().__init__(**settings, add_help=False, allow_abbrev=False)
        self.add_argument("--help", "-h", action=_Help, help="print this help, and exit")

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}\n(see {self.prog} --help)")

    def short_help(self) -> str:
        """Return the text of --help."""
        return self.format_help()

    def _match_argument(self, action: argparse.Action, arg_strings_pattern: str) -> int:
        try:
            return super()._match_argument(action, arg_strings_pattern)
        except argparse.ArgumentError:
            if not action.option_strings:
                raise
            names = self._get_formatter()._format_args(action, action.dest.upper())
            worded = {"None": "a value", "+": "one value or more"}
            number = worded.get(str(action.nargs), f"{action.nargs} values")
            raise argparse.ArgumentError(action, f"expected {number}: {names}") from None

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            expected = " or ".join(filter(None, (", ".join(choices[:-1]), choices[-1])))
            hint = did_you_mean(str(value), choices)
            raise argparse.ArgumentError(action, f"expected {expected}, got {quoted(str(value))}{hint}")


class VerbParser(Parser):
    """The parser of one verb. Its --help shows only the options named in `daily`, and a few examples.

    given: what the parsed line names, in order, then what the file of --config adds.
    """

    def __init__(self, **settings: Any) -> None:
        self.given: list[Given] = []
        self.daily: Collection[str] = ()
        super().__init__(**settings, formatter_class=HelpFormatter)
        self.add_argument("--help-all", action=_Help, help="print all options and examples, and exit")

    @property
    def options(self) -> list[argparse.Action]:
        return [action for action in self._actions if action.option_strings]

    @property
    def flags(self) -> dict[str, str]:
        """The long flag of each argument, or nothing for a positional one, by the name that the library has for it."""
        return {action.dest: f"--{name}" if (name := name_of(action)) else "" for action in self._actions}

    def rivals(self, option: argparse.Action) -> list[argparse.Action]:
        """Return the other options that cannot be given beside one."""
        groups = [group._group_actions for group in self._mutually_exclusive_groups]
        return [other for group in groups if option in group for other in group if other is not option]

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse the line; then the file of --config sets what the line leaves open."""
        self.given, self.needed = [], [action for action in self._actions if action.required]
        with _each_with(self.needed, required=False):
            namespace, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(self._left_over(rest))
        if namespace.config:
            self._apply_file(namespace.config, namespace)
        used = {option for option, _ in self.given}
        missing = [
            "/".join(action.option_strings) or str(action.metavar or action.dest)
            for action in self.needed
            if action not in used and action.nargs != "*"
        ]
        if missing:
            self.error(f"the following arguments are required: {', '.join(missing)}")
        return namespace, []

    @property
    def configuration(self) -> str:
        """TOML of the parsed line, as --print-config prints it."""
        return configuration(self.verb, options_of(self.options), self.given)

    @property
    def verb(self) -> str:
        return self.prog.rpartition(" ")[2]

    def _apply_file(self, path: str, namespace: argparse.Namespace) -> None:
        """Set the options that a file of --config has and the parsed line does not give.

        Options that share a place, or exclude each other, count as given when one of them is.
        """
        taken = {place(option) for use in self.given for option in (use.option, *self.rivals(use.option))}
        used: list[argparse.Action] = []
        for key, (option, texts) in uses_of(path, self.verb, options_of(self.options)):
            if place(option) in taken:
                continue
            for other in self.rivals(option):
                if other in used:
                    raise InputError(f"{path}: {name_of(other)} and {key} exclude each other: leave one out")
            used.append(option)
            try:
                if self._match_argument(option, "A" * len(texts)) != len(texts):
                    raise argparse.ArgumentError(option, f"expected one value, got {len(texts)}")
                option(self, namespace, self._get_values(option, texts), option.option_strings[0])
            except argparse.ArgumentError as error:
                raise InputError(f"{path}: {key}: {error.message}") from None

    def short_help(self) -> str:
        hidden = [action for action in self.options if action.dest not in self.daily]
        # the verb, what it cannot do without, and [options] for the rest
        formatter = self.formatter_class(prog=f"{self.prog} [options]")
        needed = [action for action in self._actions if action.required or not action.option_strings]
        formatter.add_usage(None, needed, [], prefix="usage: ")
        usage = self.usage or formatter.format_help().removeprefix("usage: ").strip()
        epilog = "\n".join(["examples:", *_COMMAND.findall(self.epilog or "")[:MAX_SHORT_EXAMPLES]])
        with _each_with(hidden, help=argparse.SUPPRESS), _each_with([self], epilog=epilog, usage=usage):
            text = self.format_help()
        more = counted(sum(not isinstance(action, _Help) for action in hidden), "more option")
        return f"{text}\n{more}: {self.prog} --help-all\n"

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings and "--" in arg_strings:  # which some versions of argparse drop
            raise argparse.ArgumentError(action, "expected a value, got '--'")
        values = super()._get_values(action, arg_strings)
        if action.option_strings or arg_strings:
            self.given.append(Given(action, list(arg_strings)))
        return values

    def _left_over(self, rest: Sequence[str]) -> str:
        flag = next((text for text in rest if text.startswith("-") and text.strip("-")), None)
        if flag is not None:
            name = flag.partition("=")[0]
            flags = [string for action in self.options for string in action.option_strings]
            return f"there is no option {quoted(name)}{did_you_mean(name, flags)}"
        last = next((use for use in reversed(self.given) if not use.option.option_strings), None)
        from .declaring import words  # which needs more than the help of all verbs may load

        if last is not None and last.option.type is words:
            sentence = " ".join([*last.texts, *rest])
            return f'unexpected {quoted(rest[0])}: several words need quotes: "{sentence}"'
        names = [str(action.metavar or action.dest) for action in self._actions if not action.option_strings]
        expected = f"only {' '.join(names)}" if names else "no arguments but options"
        return f"unexpected {quoted(rest[0])}: expected {expected}"


class _Help(argparse.Action):
    """Action that prints the short help for --help, and all of it for --help-all."""

    def __init__(self, option_strings: Sequence[str], dest: str, **settings: Any) -> None:
        super().__init__(option_strings, dest, default=argparse.SUPPRESS, nargs=0, help=settings["help"])

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        assert isinstance(parser, Parser)
        with _each_with(parser.needed, required=True):  # this is in the middle of parsing
            print(parser.format_help() if "--help-all" in self.option_strings else parser.short_help(), end="")
        parser.exit()


@contextmanager
def _each_with(things: Iterable[object], **values: object) -> Iterator[None]:
    """Set attributes of several objects for the length of a block."""
    before = [(vars(thing), vars(thing).copy()) for thing in things]
    for now, _ in before:
        now.update(values)
    try:
        yield
    finally:
        for now, earlier in before:
            now.update(earlier)
