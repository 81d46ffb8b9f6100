#!/usr/bin/env python3
"""Write the table of formats in docs/formats.md from the records in the code; --check: fail if it is another one."""

import sys
from pathlib import Path

from drsplat.formats.known import FORMATS
from drsplat.formats.moving_scenes import ROWS

PAGE = Path(__file__).resolve().parents[1] / "docs/formats.md"
HEAD = ("| format | read | written | supported | refused, with the cure |", "|---|---|---|---|---|")


def table() -> list[str]:
    """Return the lines of the table; rows of what nothing reads or writes come last."""
    rows = [one.row for one in FORMATS if one.row]
    others = [row for row in rows if " | no | no | " in row]
    return [*HEAD, *(row for row in rows if row not in others), *ROWS, *others]


def main() -> int:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    begin = lines.index(HEAD[0])
    end = next(number for number in range(begin, len(lines)) if not lines[number].startswith("|"))
    made = [*lines[:begin], *table(), *lines[end:]]
    if sys.argv[1:] == ["--check"]:
        return 0 if made == lines else 1
    PAGE.write_text("\n".join(made) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
