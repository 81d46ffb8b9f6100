"""Picture of the table of stages in docs/speed.md: bars on a logarithmic axis, ours above the others.

usage: python -m scripts.made_tables   writes it, with the tables
"""

import math
import re
from collections.abc import Iterator, Sequence
from html import escape
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, PICTURE = DOCS / "speed.md", DOCS / "images" / "speed.svg"
HEAD = "| stage | drsplat | 0be0b917 | rival | what the rival is |"
SECONDS = {"µs": 1e-6, "ms": 1e-3, "s": 1.0}
LEFT, WIDTH, TOP, BAR, GAP = 300, 900, 34, 14, 12  # pixels
OURS, BEFORE, THEIRS, INK, LINE = "#2f6db5", "#a9c8ea", "#c4c8ce", "#24292f", "#e3e6ea"


class Stage(NamedTuple):
    """Row of the table. Times in seconds; what was not measured is None."""

    name: str
    ours: float
    before: float | None
    theirs: float | None
    rival: str

    @property
    def bars(self) -> list[tuple[float, str, str]]:
        """Times, colours and words of the bars that it has."""
        bars = (self.ours, OURS, ""), (self.before, BEFORE, "before"), (self.theirs, THEIRS, self.rival)
        return [(time, color, f"{told(time)} {name}".strip()) for time, color, name in bars if time is not None]


def stages(page: str) -> list[Stage]:
    """Return the rows of the table, in their order."""
    lines = page.splitlines()
    begin = lines.index(HEAD) + 2
    rows = []
    for line in lines[begin:]:
        if not line.startswith("|"):
            break
        cells = [re.sub(r"\s*\(`[^`]*`\)", "", cell).replace("`", "").strip() for cell in line.split("|")[1:6]]
        ours, before, theirs = (_seconds(cell) for cell in cells[1:4])
        assert ours is not None, f"{cells[0]}: expected a time"
        rows.append(Stage(cells[0], ours, before, theirs, cells[4]))
    return rows


def _seconds(text: str) -> float | None:
    number, _, unit = text.replace(",", "").partition(" ")
    return float(number) * SECONDS[unit] if text else None


def drawn(rows: Sequence[Stage]) -> str:
    """Return the picture as SVG."""
    times = [time for row in rows for time, _, _ in row.bars]
    low, high = math.floor(math.log10(min(times) / 2)), math.ceil(math.log10(max(times)))
    tops = list(accumulate((len(row.bars) * BAR + GAP for row in rows), initial=TOP))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {tops[-1]}" font-family="sans-serif" '
        f'font-size="12"><rect width="{WIDTH}" height="{tops[-1]}" fill="#ffffff"/>'
    ]
    for power in range(low, high + 1):
        x = _place(10.0**power, low, high)
        parts.append(f'<path d="M{x:.1f} {TOP - 6}V{tops[-1] - 6}" stroke="{LINE}"/>')
        parts.append(f'<text x="{x:.1f}" y="{TOP - 14}" fill="{INK}" text-anchor="middle">{told(10.0**power)}</text>')
    for row, top in zip(rows, tops, strict=False):
        middle = top + len(row.bars) * BAR / 2 + 4
        parts.append(f'<text x="{LEFT - 12}" y="{middle:g}" fill="{INK}" text-anchor="end">{escape(row.name)}</text>')
        parts += _bars(row, top, low, high)
    return "\n".join([*parts, "</svg>", ""])


def _bars(row: Stage, top: int, low: int, high: int) -> Iterator[str]:
    for line, (time, color, words) in enumerate(row.bars):
        end, y = _place(time, low, high), top + line * BAR
        yield f'<rect x="{LEFT}" y="{y}" width="{end - LEFT:.1f}" height="{BAR - 2}" fill="{color}"/>'
        # a long name beside a long bar stands within it
        inside = end + 6.5 * len(words) > WIDTH
        x, anchor, ink = (end - 6, "end", INK if color != OURS else "#ffffff") if inside else (end + 6, "start", INK)
        yield f'<text x="{x:.1f}" y="{y + 10}" fill="{ink}" text-anchor="{anchor}">{escape(words)}</text>'


def _place(seconds: float, low: int, high: int) -> float:
    return LEFT + (WIDTH - LEFT - 30) * (math.log10(seconds) - low) / (high - low)


def told(seconds: float) -> str:
    """Return a time in words."""
    return f"{seconds * 1000:.3g} ms" if seconds < 1 else f"{seconds:.3g} s" if seconds < 1000 else f"{seconds:,.0f} s"
