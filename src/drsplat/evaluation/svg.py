"""Three kinds of chart as inline SVG, which needs no script: a scatter, bars and curves."""

from collections.abc import Sequence
from html import escape

WIDTH, HEIGHT, MARGIN = 420, 320, 56
INK, FAINT, MARK = "#1c1e24", "#c9ccd3", "#2f6fb2"
LINES = ("#2f6fb2", "#b3126b", "#2a7d46", "#8a5a00", "#5a45a8", "#5b606b")  # of curves, each 4.5 to 1 on white
FONT = 'font-family="system-ui, sans-serif" font-size="12"'

Number = float | int
Point = tuple[Number, Number, str]


def scatter(points: Sequence[Point], x_name: str, y_name: str, title: str, note: str = "") -> str:
    """Draw points (x, y, name) on one scale from 0 for both axes, and the diagonal.  Source: Fig. S3."""
    top = _round_up(max([max(x, y) for x, y, _ in points] or [1.0]))
    inner_w, inner_h = WIDTH - 1.5 * MARGIN, HEIGHT - 2 * MARGIN

    def place(x: Number, y: Number) -> tuple[float, float]:
        return MARGIN + inner_w * x / top, HEIGHT - MARGIN - inner_h * y / top

    marks = []
    for x, y, name in points:
        cx, cy = place(x, y)
        tip = escape(f"{name}: {x:.4f}, {y:.4f}")
        marks.append(
            f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="5" fill="{MARK}" fill-opacity="0.75"><title>{tip}</title></circle>'
        )
    (x0, y0), (x1, y1) = place(0, 0), place(top, top)
    lines = [_line(x0, y0, x1, y0), _line(x0, y0, x0, y1), _line(x0, y0, x1, y1, FAINT)]
    for k in range(5):
        value = top * k / 4
        (tx, _), (_, ty) = place(value, 0), place(0, value)
        lines.append(_text(tx, y0 + 16, f"{value:.2g}", "middle"))
        lines.append(_text(x0 - 6, ty + 4, f"{value:.2g}", "end"))
    middle = (x0 + x1) / 2
    words = [
        _text(middle, 18, title, "middle", bold=True),
        _text(middle, 34, note, "middle"),
        _text(middle, HEIGHT - 14, x_name, "middle"),
        f'<g transform="translate(14 {(y0 + y1) / 2:.1f}) rotate(-90)">{_text(0, 0, y_name, "middle")}</g>',
    ]
    return _svg(HEIGHT, [*lines, *marks, *words])


def bars(rows: Sequence[tuple[str, Number]], unit: str, title: str) -> str:
    """Draw a horizontal bar per row, the longest at full width, with its number.  Source: Fig. S4."""
    longest = max([value for _, value in rows] or [1.0]) or 1.0
    height, left = 44 + 30 * len(rows), 150
    parts = [_text(WIDTH / 2, 20, title, "middle", bold=True)]
    for k, (name, value) in enumerate(rows):
        y, length = 36 + 30 * k, (WIDTH - left - 90) * value / longest
        parts.append(_text(left - 8, y + 15, name, "end"))
        parts.append(f'<rect x="{left}" y="{y}" width="{max(length, 1):.1f}" height="20" rx="3" fill="{MARK}"/>')
        parts.append(_text(left + length + 6, y + 15, f"{value:.3g} {unit}", "start"))
    return _svg(height, parts)


def curves(series: Sequence[tuple[str, Sequence[tuple[Number, Number]]]], x_name: str, y_name: str, title: str) -> str:
    """Draw named curves of points (x, y), y from 0 to 100 percent, with their names below the chart."""
    xs = [x for _, points in series for x, _ in points] or [0.0, 1.0]
    low, high = min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1
    inner_w, inner_h = WIDTH - 1.5 * MARGIN, HEIGHT - 2 * MARGIN

    def place(x: Number, y: Number) -> tuple[float, float]:
        return MARGIN + inner_w * (x - low) / (high - low), HEIGHT - MARGIN - inner_h * y / 100

    (x0, y0), (x1, y1) = place(low, 0), place(high, 100)
    parts = [_line(x0, y0, x1, y0), _line(x0, y0, x0, y1), _text((x0 + x1) / 2, 20, title, "middle", bold=True)]
    for k in range(5):
        value = low + (high - low) * k / 4
        (tx, _), (_, ty) = place(value, 0), place(low, 25 * k)
        parts += [_text(tx, y0 + 16, f"{value:.2g}", "middle"), _text(x0 - 6, ty + 4, f"{25 * k}", "end")]
        parts += [_line(x0, ty, x1, ty, FAINT)] if k else []
    for number, (name, points) in enumerate(series):
        color, y = LINES[number % len(LINES)], HEIGHT + 18 * number
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in (place(*point) for point in points))
        parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts += [_line(x0, y, x0 + 24, y, color), _text(x0 + 32, y + 4, name, "start")]
    words = [
        _text((x0 + x1) / 2, HEIGHT - 20, x_name, "middle"),
        f'<g transform="translate(14 {(y0 + y1) / 2:.1f}) rotate(-90)">{_text(0, 0, y_name, "middle")}</g>',
    ]
    return _svg(HEIGHT + 18 * len(series), [*parts, *words])


def _round_up(value: Number) -> float:
    """Round up to 0.1, 0.2, 0.4, 0.6, 0.8 or 1 of a power of ten.

    >>> _round_up(0.43), _round_up(0.08)
    (0.6, 0.08)
    """
    power = 1e-6
    while power < value:
        power *= 10
    return next(
        (round(step * power, 9) for step in (0.2, 0.4, 0.6, 0.8) if step * power >= value * (1 - 1e-9)), round(power, 9)
    )


def _svg(height: Number, parts: Sequence[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" width="{WIDTH}" '
        f'height="{height:g}" role="img">{"".join(parts)}</svg>'
    )


def _line(x0: Number, y0: Number, x1: Number, y1: Number, color: str = INK) -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}"/>'


def _text(x: Number, y: Number, words: str, anchor: str, *, bold: bool = False) -> str:
    weight = ' font-weight="600"' if bold else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{INK}" {FONT}{weight}>{escape(words)}</text>'
