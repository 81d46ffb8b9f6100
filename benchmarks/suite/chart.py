"""Groups of bars with their intervals as one SVG file, on paper of its own: legible on light pages and dark ones."""

import re
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

HEIGHT, TOP, BOTTOM, LEFT, RIGHT = 330, 64, 56, 44, 16
BAR, GAP, APART = 18, 22, 28  # width of a bar, between groups, and more between sections
STYLE = """\
.paper{fill:#fff}.ink{fill:#1c1e24}.faint{fill:#5f6672}.grid{stroke:#dfe2e8}.whisker{stroke:#1c1e24;stroke-width:1.3}
.b0{fill:#a9b4c2}.b1{fill:#2f6fb2}.b2{fill:none;stroke:#2f6fb2;stroke-width:1.4;stroke-dasharray:3 2}
@media (prefers-color-scheme:dark){.paper{fill:#14171c}.ink{fill:#e8eaee}.faint{fill:#a3abb8}.grid{stroke:#343a45}
.whisker{stroke:#e8eaee}.b0{fill:#6c7889}.b1{fill:#5aa2ea}.b2{stroke:#8cc0f5}}
text{font-family:system-ui,sans-serif;font-size:12px}.strong{font-weight:600}"""


class Bar(NamedTuple):
    """Percent, 0 to 100. low, high: of the interval."""

    value: float
    low: float
    high: float


class Group(NamedTuple):
    """One bar for each name of the legend. strong: the name is printed bold."""

    name: str
    bars: Sequence[Bar]
    strong: bool = False


def grouped_bars(title: str, legend: Sequence[str], sections: Sequence[tuple[str, Sequence[Group]]]) -> str:
    """Return SVG: sections side by side under their names, groups in them, up to three bars in a group."""
    parts, x = [], float(LEFT + APART / 2)
    for words, groups in sections:
        parts.append(_text(x, TOP - 6, words, "start", "faint"))
        for group in groups:
            parts += _drawn(group, x)
            x += BAR * len(legend) + GAP
        x += APART
    width = x - GAP - APART / 2 + RIGHT
    grid = [part for value in range(0, 101, 20) for part in _line(value, width)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {HEIGHT}" width="{width:g}" '
        f'height="{HEIGHT}" role="img"><title>{escape(title)}</title><style>{STYLE}</style>\n'
        f'<rect class="paper" width="100%" height="100%" rx="6"/>\n'
        + "\n".join([_text(LEFT, 22, title, "start", "ink strong"), *_legend(legend), *grid, *parts])
        + "\n</svg>\n"
    )


def _drawn(group: Group, x: float) -> list[str]:
    parts = []
    for number, bar in enumerate(group.bars):
        left, middle = x + BAR * number, x + BAR * (number + 0.5)
        tip = f"{group.name}: {bar.value:.1f} [{bar.low:.1f}, {bar.high:.1f}]"
        parts.append(
            f'<rect class="b{number}" x="{left + 1:.1f}" y="{_y(bar.value):.1f}" width="{BAR - 2}" '
            f'height="{_y(0) - _y(bar.value):.1f}"><title>{escape(tip)}</title></rect>'
            f'<path class="whisker" d="M{middle:.1f} {_y(bar.low):.1f}V{_y(bar.high):.1f}"/>'
        )
    kind = "ink strong" if group.strong else "ink"
    for line, word in enumerate(re.split(r"_(?!\d)", group.name)):
        parts.append(
            _text(
                x + BAR * len(group.bars) / 2, HEIGHT - BOTTOM + 18 + 15 * line, word.replace("_", " "), "middle", kind
            )
        )
    return parts


def _legend(names: Sequence[str]) -> list[str]:
    parts, x = [], float(LEFT)
    for number, name in enumerate(names):
        parts.append(f'<rect class="b{number}" x="{x + 1:.1f}" y="31" width="11" height="11"/>')
        parts.append(_text(x + 18, 41, name, "start", "ink"))
        x += 40 + 6.6 * len(name)
    return parts


def _line(value: int, width: float) -> tuple[str, str]:
    line = f'<path class="grid" d="M{LEFT} {_y(value):.1f}H{width - RIGHT:.1f}"/>'
    return line, _text(LEFT - 6, _y(value) + 4, f"{value}", "end", "faint")


def _y(value: float) -> float:
    return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP - 6) * min(max(value, 0), 100) / 100


def _text(x: float, y: float, words: str, anchor: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
