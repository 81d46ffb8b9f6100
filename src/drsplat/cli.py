"""The command line: arguments -> one public call -> print.

Each verb is a module of `drsplat.commands` with SUMMARY, EXAMPLES, add_arguments(parser), run(arguments)
-> a JSON object, and show(object) for people. To add one, add the module and its name to VERBS.
"""

import argparse
import json
import os
import platform
import re
import shlex
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from io import TextIOWrapper
from typing import NoReturn, TextIO

from .commands.configuring import can_be_a_path, configuration, configured, path_of
from .commands.help_texts import HelpFormatter
from .commands.log import logged
from .commands.options import whole
from .errors import DrSplatError, DrSplatWarning, MissingExtraError
from .terminal import plain, plainly, quoted

# in the order of the pipeline
VERBS = (
    "train", "inspect", "embed", "codebook", "tile", "motion", "register", "add", "remove", "objects", "select",
    "locate", "when", "segment", "catalogue", "edit", "render", "view", "evaluate", "demo", "serve", "mcp", "doctor",
)  # fmt: skip
_ARGUMENT = re.compile(r"\b([a-z_]+)=(True\b|[A-Z][A-Z_]+\b(?:\.\w+)?|\d+\b)|\A([a-z_]+)(?=: )")
FAILED, MISUSED, INTERRUPTED, PIPE_CLOSED = 1, 2, 130, 141
SHELLS = ("bash", "zsh", "tcsh")
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class UsageError(Exception):
    """What argparse has to say; kept from it so that --json is heard first."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}\n(see {self.prog} --help)")


class _Version(argparse.Action):
    """Looks the version up only when asked: that costs more than all of --help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from . import __version__
        from .kernels import available_isas, compiler, default_isa

        print(f"drsplat {__version__}")
        print(f"Python {platform.python_version()} on {platform.system()} {platform.machine()}")
        print(f"native code by {compiler()}, {default_isa()} of {', '.join(available_isas())}")
        parser.exit()


class _Completion(argparse.Action):
    """Prints what a shell needs to complete verbs and options."""

    def __call__(self, parser: argparse.ArgumentParser, _: object, shell: object, __: object = None) -> NoReturn:
        if shell not in SHELLS:
            parser.error(f"--print-completion: expected {', '.join(SHELLS)}, got {quoted(str(shell))}")
        try:
            import shtab
        except ImportError:
            raise MissingExtraError('shtab is not installed: pip install "drsplat[completion]"') from None
        print(shtab.complete(parser, str(shell)))
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    as_json, debug = "--json" in given, "--debug" in given
    if isinstance(sys.stdout, TextIOWrapper):  # a name that the terminal has no letters for is told all the same
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with logged(path_of("--log", given), f"drsplat {shlex.join(given)}"):
            return _told(given, as_json, debug)
    except OSError as error:  # of the log
        return _failed(error, type(error).__name__, FAILED, as_json)


def _told(given: list[str], as_json: bool, debug: bool) -> int:
    """Run, and tell what goes wrong."""
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


def make_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="drsplat",
        description="Search a 3D Gaussian Splatting scene in words.",
        epilog="Each verb has its own help and examples: drsplat register --help",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="print version, build and instruction set, and exit"
    )
    parser.add_argument(
        "--print-completion", action=_Completion, metavar="SHELL",
        help="print what bash, zsh or tcsh needs to complete verbs and options, and exit",
    )  # fmt: skip
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for name in VERBS:
        _add_verb(verbs, name)
    return parser


def _add_verb(verbs: "argparse._SubParsersAction[_Parser]", name: str) -> None:
    command = import_module(f".commands.{name}", __package__)
    summary: str = command.SUMMARY
    parser = verbs.add_parser(
        name, aliases=getattr(command, "ALIASES", ()), help=summary, description=summary[0].upper() + summary[1:] + ".",
        epilog=f"examples:\n{command.EXAMPLES}", formatter_class=HelpFormatter,
        allow_abbrev=False,
    )  # fmt: skip
    command.add_arguments(parser)
    common = parser.add_argument_group("all verbs")
    common.add_argument("--json", action="store_true", help="print one JSON object to stdout and nothing else there")
    common.add_argument(
        "--threads", type=whole, default=0, metavar="N",
        help="CPU threads; results are the same for any number (default: 0, all cores)",
    )  # fmt: skip
    common.add_argument(
        "--config",
        metavar="FILE",
        help="TOML with options under [VERB]; what is given here counts, not what it has there",
    )
    common.add_argument("--print-config", action="store_true", help="print such a file of what is given, and exit")
    common.add_argument("--log", metavar="FILE", help="append what is said on stderr to a file, with times")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.set_defaults(command=command, flags=_flags(parser))


def _flags(parser: argparse.ArgumentParser) -> dict[str, str]:
    """The long flag of each option, by the name that the library has for it."""
    named = ((action.dest, action.option_strings) for action in parser._actions)
    return {dest: next((flag for flag in flags if flag.startswith("--")), "") for dest, flags in named}


def spelled(message: str, flags: Mapping[str, str]) -> str:
    """A message of the library in the words of the command line.

    "overwrite=True" is "--overwrite", "images=FOLDER" is "--images FOLDER", and "images: " at the beginning
    is "--images: ". flags: of the verb, as `_flags` gives them; arguments without one stay as they are.
    """

    def spell(found: re.Match[str]) -> str:
        name, value, heading = found.groups()
        flag = flags.get(name or heading)
        if not flag:
            return found[0]
        return f"{flag} {value}" if value and value != "True" else flag

    return _ARGUMENT.sub(spell, message)


def _run(argv: list[str]) -> int:
    argv = configured(argv, make_parser())
    arguments = make_parser().parse_args(argv)
    _refuse_no_texts(arguments)
    if arguments.print_config:
        print(configuration(argv, make_parser()))
        return 0
    if arguments.threads and "numpy" not in sys.modules:  # its BLAS reads them once
        os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(arguments.threads)))
    with _warnings_as_lines(arguments.flags):
        try:
            answer = arguments.command.run(arguments)
        except (DrSplatError, KeyboardInterrupt) as error:
            error.args = tuple(spelled(str(part), arguments.flags) for part in error.args)
            raise
    if arguments.json:
        print(json.dumps(answer, default=_as_json))
    else:
        arguments.command.show(plainly(answer))
    sys.stdout.flush()
    return 0


def _refuse_no_texts(arguments: argparse.Namespace) -> None:
    """An empty value is a variable that a shell found empty: as a path it would be the current folder."""
    for name, value in vars(arguments).items():
        flag = arguments.flags.get(name) or name.upper()
        for text in value if isinstance(value, list) else [value]:
            if text == "" and name != "ask":  # which asks nothing by default
                raise UsageError(f"{flag} is empty: give a value, or leave it out")
            if isinstance(text, str) and not can_be_a_path(text):
                raise UsageError(f"{flag}: expected text in UTF-8, got {quoted(text)}")


def _as_json(value: object) -> object:
    """NumPy's numbers and arrays, paths: as JSON has them."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _failed(error: BaseException, kind: str, code: int, as_json: bool) -> int:
    message = str(error) or kind
    print(f"drsplat: error: {plain(message)}", file=sys.stderr)
    try:
        if as_json:
            print(json.dumps({"error": message, "kind": kind}))
        sys.stdout.flush()
    except OSError:  # what failed may be stdout itself
        _drop_stdout()
    return code


def _drop_stdout() -> None:
    """What stdout still holds goes nowhere, also in the interpreter's last flush."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _warnings_as_lines(flags: Mapping[str, str]) -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("always", DrSplatWarning)
        shown = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], filename: str, lineno: int,
            file: TextIO | None = None, line: str | None = None,
        ) -> None:  # fmt: skip
            if issubclass(category, DrSplatWarning):
                line = spelled(str(message), flags)
                print(f"drsplat: warning: {plain(line)}", file=sys.stderr)
            else:
                shown(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield
