"""The commands of README and docs/: every shell line and Python block, in the order of the pages."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MAX_WIDTH = 88  # characters of a line of code that a page shows at 1280 pixels
_FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
_OPEN_ENDS = ("\\", "|", "&&", "--")


@dataclass(frozen=True)
class Block:
    """Code between fences. page: relative to the repository; line: of its first line of code, from 1."""

    page: str
    line: int
    language: str
    text: str


@dataclass(frozen=True)
class Piece:
    """What is run at once: a command, or a block of Python."""

    page: str
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def words(self) -> list[str]:
        """The words of a command, without its comment."""
        return shlex.split(self.text.replace("\\\n", " "), comments=True)


def blocks(page: Path) -> Iterator[Block]:
    text, name = page.read_text(encoding="utf-8"), page.relative_to(ROOT).as_posix()
    for found in _FENCE.finditer(text):
        indent, language, code = found.groups()
        lines = [line.removeprefix(indent) for line in code.splitlines()]
        yield Block(name, text[: found.start(3)].count("\n") + 1, language.strip(), "\n".join(lines))


def pieces(page: Path) -> list[Piece]:
    """Return what is to be run of a page, in its order."""
    found: list[Piece] = []
    for block in blocks(page):
        if block.language == "bash":
            found += commands(block)
        elif block.language == "python":
            found.append(Piece(block.page, block.line, "python", block.text))
    return found


def commands(block: Block) -> Iterator[Piece]:
    """Yield the commands of a block of shell; one ends where its line does, unless it goes on."""
    open_lines: list[str] = []
    for number, line in enumerate(block.text.splitlines(), block.line):
        open_lines.append(line)
        text = "\n".join(open_lines)
        if not _complete(text):
            continue
        first = number - len(open_lines) + 1
        open_lines = []
        if shlex.split(text, comments=True):
            parts = [text] if "\n" in text else text.split(" && ")
            yield from (Piece(block.page, first, "bash", part) for part in parts)
    if open_lines:
        raise ValueError(f"{block.page}:{block.line}: a command that does not end: {open_lines[0]}")


def _complete(text: str) -> bool:
    try:
        shlex.split(text, comments=True)
    except ValueError:  # a quotation is open
        return False
    return not text.rstrip().endswith(_OPEN_ENDS)
