"""Picture of the table of stages in docs/speed.md: bars on a logarithmic axis, ours above the rival's.

usage: python -m scripts.made_tables   writes it, with the tables
"""

import math
import re
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, PICTURE = DOCS / "speed.md", DOCS / "images" / "speed.svg"
HEAD = "| stage | drsplat | rival | what the rival is |"
SECONDS = {"µs": 1e-6, "ms": 1e-3, "s": 1.0}
LEFT, WIDTH, TOP, ROW, BAR = 290, 900, 34, 46, 15  # pixels
OURS, THEIRS, INK, LINE = "#2f6db5", "#b9bfc7", "#24292f", "#e3e6ea"


class Stage(NamedTuple):
    """Row of the table. Times in seconds; a rival that was not measured is None."""

    name: str
    ours: float
    theirs: float | None
    rival: str


def stages(page: str) -> list[Stage]:
    """Return the rows of the table, in their order."""
    lines = page.splitlines()
    begin = lines.index(HEAD) + 2
    rows = []
    for line in lines[begin:]:
        if not line.startswith("|"):
            break
        name, ours, theirs, rival = (re.sub(r"\s*\(?`[^`]*`\)?", "", cell).strip() for cell in line.split("|")[1:5])
        rows.append(Stage(name, _seconds(ours), _seconds(theirs) if theirs else None, rival))
    return rows


def _seconds(text: str) -> float:
    number, unit = text.replace(",", "").split()
    return float(number) * SECONDS[unit]


def drawn(rows: Sequence[Stage]) -> str:
    """Return the picture as SVG."""
    times = [time for row in rows for time in (row.ours, row.theirs) if time]
    low, high = math.floor(math.log10(min(times) / 2)), math.ceil(math.log10(max(times)))
    height = TOP + ROW * len(rows) + 8
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        f'font-size="12"><rect width="{WIDTH}" height="{height}" fill="#ffffff"/>'
    ]
    for power in range(low, high + 1):
        x = _place(10.0**power, low, high)
        parts.append(f'<path d="M{x:.1f} {TOP - 6}V{height - 8}" stroke="{LINE}"/>')
        parts.append(f'<text x="{x:.1f}" y="{TOP - 14}" fill="{INK}" text-anchor="middle">{_power(power)}</text>')
    for number, row in enumerate(rows):
        parts += _bars(row, TOP + ROW * number, low, high)
    return "\n".join([*parts, "</svg>", ""])


def _bars(row: Stage, top: int, low: int, high: int) -> Iterator[str]:
    middle = top + (20 if row.theirs is not None else 12)
    yield f'<text x="{LEFT - 12}" y="{middle}" fill="{INK}" text-anchor="end">{escape(row.name)}</text>'
    bars = [(row.ours, OURS, _told(row.ours))]
    if row.theirs is not None:
        bars.append((row.theirs, THEIRS, f"{_told(row.theirs)} {row.rival}"))
    for line, (time, color, told) in enumerate(bars):
        end, y = _place(time, low, high), top + line * (BAR + 3)
        yield f'<rect x="{LEFT}" y="{y}" width="{end - LEFT:.1f}" height="{BAR}" fill="{color}"/>'
        # a long name beside a long bar stands within it
        inside = end + 6.5 * len(told) > WIDTH
        x, anchor = (end - 6, "end") if inside else (end + 6, "start")
        ink = "#ffffff" if inside and color == OURS else INK
        yield f'<text x="{x:.1f}" y="{y + 12}" fill="{ink}" text-anchor="{anchor}">{escape(told)}</text>'


def _place(seconds: float, low: int, high: int) -> float:
    return LEFT + (WIDTH - LEFT - 30) * (math.log10(seconds) - low) / (high - low)


def _power(power: int) -> str:
    return f"{10 ** (power + 3)} ms" if power < 0 else f"{10**power:,} s"


def _told(seconds: float) -> str:
    return f"{seconds * 1000:.3g} ms" if seconds < 1 else f"{seconds:.3g} s" if seconds < 1000 else f"{seconds:,.0f} s"
