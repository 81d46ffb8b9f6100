"""The command line: arguments -> one public call -> print.

Each verb is a module of `drsplat.fronts.commands` with EXAMPLES, Options, which declares its options (see `declaring`),
run(options) -> a JSON object, and show(object) for people. Optional are DAILY, the options that --help shows if not
all, USAGE instead of the line that argparse makes, interrupted(options) -> how to go on after Ctrl-C, and
device(options) -> where it draws and registers. To add a verb, add the module, and its name and summary to
`drsplat.fronts.commands.verbs`.
"""

import argparse
import os
import re
import shlex
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib import import_module
from io import TextIOWrapper
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn

from .base.system import can_be_a_path
from .base.terminal import plain, plain_json, quoted
from .errors import DrSplatError, DrSplatWarning, InputError, MissingExtraError
from .fronts.commands.configuring import did_you_mean
from .fronts.commands.log import logged, path_of
from .fronts.commands.parsing import HelpFormatter, Parser, UsageError, VerbParser
from .fronts.commands.verbs import GROUPS, SUMMARIES

if TYPE_CHECKING:
    from .fronts.commands.options import Verb

VERBS = tuple(SUMMARIES)
_ARGUMENT = re.compile(r"\b([a-z_][a-z_0-9]*)=(True\b|[A-Z][A-Z_]*\b(?:\.\w+|[,:][A-Z]\b)*|\d+\b)|\A([a-z_]+)(?=: )")
FAILED, MISUSED, INTERRUPTED, PIPE_CLOSED = 1, 2, 130, 141
VERB_COLUMN = 14  # where the summaries of the verbs begin
SHELLS = ("bash", "zsh", "tcsh", "fish")
ODD_NUMBERS = (
    "some numbers became too large or undefined on the way, so the result may be wrong: check the input for huge or "
    "missing values (--debug shows where)"
)
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class _LineParser(Parser):
    """The parser of the whole line: a verb first, then what is the verb's."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        first = args[0] if args else ""
        if first.startswith("-") and not any(first.split("=")[0] in action.option_strings for action in self._actions):
            self.error(f"expected a verb first, then its options: drsplat VERB {plain(first)}")
        if not args:
            self.error(f"expected a verb, and none was given; a first one to try is drsplat demo:{_listed_verbs()}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            name = str(value)
            hint = did_you_mean(name, VERBS)
            raise argparse.ArgumentError(None, f"there is no verb {quoted(name)}{hint or ':' + _listed_verbs()}")

    def format_help(self) -> str:
        """Return usage, the verbs in their groups, and the options, with the room for the summaries of the verbs."""
        formatter = HelpFormatter(self.prog, max_help_position=VERB_COLUMN)
        formatter.add_text(f"usage: {self.prog} VERB ...")
        formatter.add_text(self.description)
        verbs = next(action for action in self._actions if isinstance(action, argparse._SubParsersAction))
        summaries = {action.dest: action for action in verbs._choices_actions}
        for title, names in GROUPS.items():
            formatter.start_section(title)
            formatter.add_arguments([summaries[name] for name in names])
            formatter.end_section()
        formatter.start_section("options")
        formatter.add_arguments([action for action in self._actions if action.option_strings])
        formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


def _listed_verbs() -> str:
    """Return a line for each group of verbs."""
    return "".join(f"\n  {title}: {', '.join(verbs)}" for title, verbs in GROUPS.items())


class _Version(argparse.Action):
    """Action that looks the version up only when asked, which costs more than all of --help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        import platform

        from . import __version__
        from .kernels import available_isas, compiler, default_isa

        print(f"drsplat {__version__}")
        print(f"Python {platform.python_version()} on {platform.system()} {platform.machine()}")
        print(f"native code by {compiler()}, {default_isa()} of {', '.join(available_isas())}")
        parser.exit()


class _Completion(argparse.Action):
    """Action that prints what a shell needs to complete verbs and options."""

    def __call__(self, parser: argparse.ArgumentParser, _: object, shell: object, __: object = None) -> NoReturn:
        if shell not in SHELLS:
            parser.error(f"--print-completion: expected {', '.join(SHELLS)}, got {quoted(str(shell))}")
        import shtab

        if shell not in shtab.SUPPORTED_SHELLS:
            raise MissingExtraError(f'shtab {shtab.__version__} does not know {shell}: pip install -U "shtab>=1.9.3"')
        print(shtab.complete(make_parser(), str(shell)))
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    if given[:1] == ["help"]:  # as other programs have it
        given = [*given[1:], "--help"]
    options = given[: given.index("--")] if "--" in given else given
    as_json, debug = "--json" in options, "--debug" in options
    if isinstance(sys.stdout, TextIOWrapper):  # a name that the terminal has no letters for is told all the same
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with logged(path_of(options), f"drsplat {shlex.join(given)}"):
            return _run_reporting(given, as_json, debug)
    except (InputError, OSError) as error:  # of the log, or what --debug lets through
        if debug:
            raise
        return _failed(error, type(error).__name__, FAILED, as_json)


def _run_reporting(given: list[str], as_json: bool, debug: bool) -> int:
    """Run a command and report its errors; return the exit code."""
    try:
        return _run(given)
    except UsageError as error:
        return _failed(error, "usage", MISUSED, as_json)
    except (DrSplatError, OSError, MemoryError) as error:
        if isinstance(error, BrokenPipeError):
            _drop_stdout()
            return PIPE_CLOSED  # the reader has gone: exit without a word
        if debug:
            raise
        return _failed(error, type(error).__name__, FAILED, as_json)
    except KeyboardInterrupt as interrupt:
        said = ": ".join(["drsplat: interrupted", *map(str, interrupt.args)])
        print(spelled(said, {"overwrite": "--overwrite"}), file=sys.stderr)
        return INTERRUPTED
    except SystemExit as ending:  # argparse, after --help or --version
        return ending.code if isinstance(ending.code, int) else 0


def make_parser(verbs: Sequence[str] = VERBS) -> argparse.ArgumentParser:
    """Return the parser of the command line. verbs: those to load; of the others it has only the summaries."""
    parser = _LineParser(
        prog="drsplat",
        description="Search a 3D Gaussian Splatting scene in words.",
        epilog="Each verb has its own help and examples: drsplat register --help",
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="print version, build and instruction set, and exit"
    )
    parser.add_argument(
        "--print-completion", action=_Completion, metavar="SHELL",
        help="print the completion script for bash, zsh, tcsh or fish, and exit",
    )  # fmt: skip
    subparsers = parser.add_subparsers(metavar="VERB", required=True, parser_class=VerbParser)
    for name, summary in SUMMARIES.items():
        verb = subparsers.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name in verbs:
            from .fronts.commands.options import add_verb

            command = import_module(f".fronts.commands.{name}", __package__)
            verb.epilog, verb.usage = f"examples:\n{command.EXAMPLES}", getattr(command, "USAGE", None)
            add_verb(verb, command.Options)
            if hasattr(command, "DAILY"):
                verb.daily = {"json", *command.DAILY.split()}
            verb.set_defaults(command=command, parser=verb, flags=verb.flags)
    return parser


def spelled(message: str, flags: Mapping[str, str]) -> str:
    """Return a message of the library in the words of the command line.

    "overwrite=True" is "--overwrite", "images=FOLDER" is "--images FOLDER", and "images: " at the beginning
    is "--images: ". A positional argument loses its name: "text=WORDS" is "WORDS".
    flags: those of the verb by name, empty for positional arguments; names that the verb has not stay as they are.
    """

    def spell(match: re.Match[str]) -> str:
        name, value, heading = match.groups()
        flag = flags.get(name or heading)
        if flag is None or (not flag and not name):
            return match[0]
        return flag if value in (None, "True") else f"{flag} {value}".strip()

    return _ARGUMENT.sub(spell, message)


def _run(argv: list[str]) -> int:
    arguments = make_parser(argv[:1]).parse_args(argv)
    from .fronts.commands.declaring import made  # --help has left by now, without it

    command, flags = arguments.command, arguments.flags
    _refuse_no_texts(vars(arguments), flags)
    options: Verb = made(command.Options, vars(arguments))
    if options.print_config:
        print(arguments.parser.configuration)
        return 0
    if options.threads and "numpy" not in sys.modules:  # its BLAS reads them once
        os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(options.threads)))
    with _warnings_as_lines(flags, options.debug):
        try:
            with _on_device(command, options):
                answer = command.run(options)
        except (DrSplatError, KeyboardInterrupt) as error:
            if isinstance(error, KeyboardInterrupt) and not error.args and hasattr(command, "interrupted"):
                error.args = (command.interrupted(options),)
            error.args = tuple(spelled(str(part), flags) for part in error.args)
            raise
    if options.json:
        _print_json(answer)
    else:
        command.show(plain_json(answer))
    sys.stdout.flush()
    return 0


def _on_device(command: ModuleType, options: "Verb") -> AbstractContextManager[object]:
    """Draw and register where a verb says, if it has a choice. Raises: MissingExtraError: there is no such GPU."""
    if not hasattr(command, "device"):
        return nullcontext()
    from .kernels.cuda.devices import using_device

    return using_device(command.device(options))


def _refuse_no_texts(given: Mapping[str, Any], flags: Mapping[str, str]) -> None:
    """Refuse an empty value, a variable that a shell found empty: as a path it would be the current folder."""
    for name, value in given.items():
        flag = flags.get(name)
        shown = flag or ("WORDS" if name == "text" else name.upper())
        for text in value if isinstance(value, list) else [value]:
            if text == "" and name != "ask":  # which asks nothing by default
                raise UsageError(f"{shown} is empty: give a value{', or leave it out' if flag else ''}")
            if isinstance(text, str) and not can_be_a_path(text):
                raise UsageError(f"{shown}: expected text in UTF-8, got {quoted(text)}")


def _print_json(answer: object) -> None:
    import json

    print(json.dumps(answer, default=_as_json))


def _as_json(value: object) -> object:
    """Return NumPy's numbers and arrays, and paths, as JSON has them."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _failed(error: BaseException, kind: str, code: int, as_json: bool) -> int:
    message = str(error) or kind
    if isinstance(error, OSError) and error.strerror:  # without its number
        message = ": ".join(str(part) for part in (error.filename, error.strerror) if part is not None)
    print(f"drsplat: error: {plain(message)}", file=sys.stderr)
    try:
        if as_json:
            _print_json({"error": message, "kind": kind})
        sys.stdout.flush()
    except OSError:  # what failed may be stdout itself
        _drop_stdout()
    return code


def _drop_stdout() -> None:
    """Discard buffered output, so that the interpreter's last flush cannot fail on a closed pipe."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _warnings_as_lines(flags: Mapping[str, str], debug: bool) -> Iterator[None]:
    """Print the project's own warnings as lines. Those of libraries speak to programmers: only `debug` shows them.

    NumPy's RuntimeWarning stands for numbers that went wrong, so a line of ours says that once.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", DrSplatWarning)
        shown = warnings.showwarning
        went_wrong = False

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            nonlocal went_wrong
            if issubclass(category, DrSplatWarning):
                _warn(spelled(str(message), flags))
            elif debug:
                shown(message, category, *place, **more)
            elif issubclass(category, RuntimeWarning) and not went_wrong:
                went_wrong = True
                _warn(ODD_NUMBERS)

        warnings.showwarning = show
        yield


def _warn(line: str) -> None:
    print(f"drsplat: warning: {plain(line)}", file=sys.stderr)
