"""--help in the width of the terminal: prose is filled, examples go on in the next line after a backslash.

Errors name what resembles a slip.
"""

import argparse
import re
import textwrap
from collections.abc import Iterable

MAX_SHORT_EXAMPLES = 3
MIN_LIKENESS = 0.7  # of difflib, from 0 to 1; a slip of one letter in four is still recognised
VERB_COLUMN = 14  # where the summaries of the verbs begin
_NO_BREAK = "\xa0"
_COMMAND = re.compile(r"^  drsplat .*(?:(?<=\\)\n.*)*", re.MULTILINE)


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Formatter that fills prose and keeps the lines of commands."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        blocks = text.split("\n\n")
        return "\n\n".join("\n".join(_block(block.splitlines(), width, indent)) for block in blocks)

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)


class VerbListFormatter(HelpFormatter):
    """Formatter with a narrow left column, so that the summaries of the verbs have the room."""

    def __init__(self, prog: str, width: int | None = None) -> None:
        super().__init__(prog, max_help_position=VERB_COLUMN, width=width)


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


def _joined(lines: list[str]) -> list[str]:
    """Return the lines with those that go on after a backslash put together."""
    return re.sub(r" \\\n +", " ", "\n".join(lines)).split("\n")


def first_examples(epilog: str) -> str:
    """Return the first few commands of an epilog of examples."""
    return "\n".join(["examples:", *_COMMAND.findall(epilog)[:MAX_SHORT_EXAMPLES]])


def did_you_mean(text: str, names: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the name that resembles a text most, or nothing if none does."""
    from difflib import get_close_matches

    bare = {name.lstrip("-").lower(): name for name in names if len(name.lstrip("-")) > 1}
    meant = text.lstrip("-").replace("_", "-").lower()
    begins = [name for name in bare if len(meant) > 2 and name.startswith(meant)]
    nearest = get_close_matches(meant[:99], bare, 1, MIN_LIKENESS) or begins[:1]
    return f"; did you mean {bare[nearest[0]]}?" if nearest else ""
