#!/usr/bin/env python3
"""Write the tables of the documents that are made of the code: formats of scenes, and options that verbs share. And the
picture of the times in docs/speed.md.

usage: python -m scripts.made_tables
"""

from collections import Counter
from importlib import import_module

from drsplat.cli import VERBS
from drsplat.formats.known import FORMATS
from drsplat.formats.moving_scenes import MOVING
from drsplat.fronts.commands.declaring import Item, items_of
from drsplat.fronts.commands.options import Verb

from .speed_picture import DOCS, PAGE, PICTURE, drawn, stages

MIN_VERBS = 8  # that share an option


def formats() -> list[str]:
    """Return the lines of the table of formats; rows of what nothing reads or writes come last."""
    rows = [one.row for one in FORMATS if one.row]
    others = [row for row in rows if " | no | no | " in row]
    head = ["| format | read | written | supported | refused, with the cure |", "|---|---|---|---|---|"]
    return [*head, *(row for row in rows if row not in others), *(one.row for one in MOVING), *others]


def options() -> list[str]:
    """Return the lines of the table of options that all verbs, or some, have with the same meaning."""
    verbs: Counter[tuple[str, str, str]] = Counter()
    for verb in VERBS:
        items = items_of(import_module(f"drsplat.fronts.commands.{verb}").Options)
        verbs.update(_cells(item) for item in items if item.flags)
    rows = [_cells(item) for item in items_of(Verb)]
    rows += [cells for cells, number in verbs.items() if number >= MIN_VERBS]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return ["| option | value | meaning |", "|---|---|---|", *lines]


def _cells(item: Item) -> tuple[str, str, str]:
    flags, settings = ", ".join(f"`{flag}`" for flag in item.flags), item.settings
    value = settings.get("metavar") or (", ".join(map(str, settings["choices"])) if settings.get("choices") else "")
    if settings.get("action") == "store_true":
        value = ""
    elif not value:
        value = item.name.upper()
    return flags, " ".join(value) if isinstance(value, tuple) else value, settings["help"]


TABLES = {DOCS / "formats.md": formats, DOCS / "settings.md": options}


def main() -> None:
    for page, table in TABLES.items():
        lines, made = page.read_text(encoding="utf-8").splitlines(), table()
        begin = lines.index(made[0])
        end = next(number for number in range(begin, len(lines) + 1) if not lines[number].startswith("|"))
        page.write_text("\n".join([*lines[:begin], *made, *lines[end:]]) + "\n", encoding="utf-8")
    PICTURE.write_text(drawn(stages(PAGE.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
