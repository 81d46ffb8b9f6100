"""Report of an evaluation: results.json, and one self-contained HTML page with its charts as SVG."""

import base64
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from ..base.arrays import Pixels
from ..formats.json_files import write_json
from ..formats.replacing import replacing
from .tables import Table, pictures_note, tables_of

WIDTH, HEIGHT, MARGIN = 420, 320, 56
INK, FAINT, MARK = "#1c1e24", "#c9ccd3", "#2f6fb2"
LINES = ("#2f6fb2", "#b3126b", "#2a7d46", "#8a5a00", "#5a45a8", "#5b606b")  # of curves, each 4.5 to 1 on white
FONT = 'font-family="system-ui, sans-serif" font-size="12"'

Number = float | int
Point = tuple[Number, Number, str]


def scatter(points: Sequence[Point], x_name: str, y_name: str, title: str, note: str = "") -> str:
    """Draw points (x, y, name) on one scale from 0 for both axes, and the diagonal.  Source: Fig. S3."""
    top = _round_up(max([max(x, y) for x, y, _ in points] or [1.0]))
    axes = _Axes(0.0, top, top)
    (x0, y0), (x1, y1) = axes.place(0, 0), axes.place(top, top)
    parts = [*axes.drawn(x_name, y_name, title), _text((x0 + x1) / 2, 34, note, "middle"), _line(x0, y0, x1, y1, FAINT)]
    for x, y, name in points:
        cx, cy = axes.place(x, y)
        tip = escape(f"{name}: {x:.4f}, {y:.4f}")
        parts.append(
            f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="5" fill="{MARK}" fill-opacity="0.75"><title>{tip}</title></circle>'
        )
    return _svg(HEIGHT, parts)


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
    axes = _Axes(min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1, 100)
    parts, (x0, _) = axes.drawn(x_name, y_name, title), axes.place(axes.low, 0)
    for number, (name, points) in enumerate(series):
        color, y = LINES[number % len(LINES)], HEIGHT + 18 * number
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in (axes.place(*point) for point in points))
        parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts += [_line(x0, y, x0 + 24, y, color), _text(x0 + 32, y + 4, name, "start")]
    return _svg(HEIGHT + 18 * len(series), parts)


class _Axes(NamedTuple):
    """Axes of a chart: x from `low` to `high`, y from 0 to `top`."""

    low: Number
    high: Number
    top: Number

    def place(self, x: Number, y: Number) -> tuple[float, float]:
        """Return where a point is drawn."""
        across = (WIDTH - 1.5 * MARGIN) * (x - self.low) / (self.high - self.low)
        return MARGIN + across, HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * y / self.top

    def drawn(self, x_name: str, y_name: str, title: str) -> list[str]:
        """Return both axes with five numbers each, faint lines at the heights of these, and the names."""
        (x0, y0), (x1, y1) = self.place(self.low, 0), self.place(self.high, self.top)
        parts = [_line(x0, y0, x1, y0), _line(x0, y0, x0, y1)]
        for k in range(5):
            x, y = self.low + (self.high - self.low) * k / 4, self.top * k / 4
            tx, ty = self.place(x, y)
            parts += [_text(tx, y0 + 16, f"{x:.2g}", "middle"), _text(x0 - 6, ty + 4, f"{y:.3g}", "end")]
            parts += [_line(x0, ty, x1, ty, FAINT)] if k else []
        return [
            *parts,
            _text((x0 + x1) / 2, 18, title, "middle", bold=True),
            _text((x0 + x1) / 2, HEIGHT - 20, x_name, "middle"),
            f'<g transform="translate(14 {(y0 + y1) / 2:.1f}) rotate(-90)">{_text(0, 0, y_name, "middle")}</g>',
        ]


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


FORMAT, VERSION = "drsplat evaluation", 1
RESULTS, PAGE = "results.json", "report.html"
JPEG_QUALITY = 85
_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1c1e24; background: #fff; margin: 0 auto; max-width: 72rem;
  padding: 1.5rem 1rem 4rem; }
h1 { font-size: 1.9rem; letter-spacing: -.02em; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; } h3 { font-size: 1rem; margin: 1rem 0 .2rem; }
table { border-collapse: collapse; margin: .5rem 0; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .3rem .8rem; border-bottom: 1px solid #e3e5ea; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } thead th { border-bottom: 2px solid #1c1e24; }
tbody tr:hover { background: #f3f4f7; }
.scroll { overflow-x: auto; } p.note { color: #565b66; font-size: .9rem; max-width: 60rem; margin: .2rem 0; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); gap: 1rem; margin: 0; }
.tiles div { border-top: 3px solid #b3126b; background: #f3f4f7; padding: .7rem 1rem; }
.tiles dt { color: #565b66; font-size: .9rem; } .tiles dd { margin: 0; font-size: 1.7rem; font-weight: 600; }
.charts, .pictures { display: grid; gap: 1.2rem; align-items: start; }
.charts { grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); }
.pictures { grid-template-columns: repeat(auto-fill, minmax(min(20rem, 100%), 1fr)); }
figure { margin: 0; } .charts figure { border: 1px solid #e3e5ea; padding: .8rem; }
figcaption { font-size: .88rem; color: #565b66; padding-top: .3rem; }
img, svg { width: 100%; height: auto; display: block; }
pre { background: #f3f4f7; padding: .8rem; overflow-x: auto; font-size: .8rem; }
"""
MAX_BARS = 20  # words or classes; the worst ones where there are more
COLUMNS = ("automatic", "fixed")  # choices of a threshold without the truth, best first
IOU_STEPS = 40  # of the curve over IoU, from 0 to 1

Results = Sequence[Mapping[str, Any]]
Curve = tuple[str, Sequence[tuple[Number, Number]]]


@dataclass(frozen=True, eq=False)
class Figure:
    """Picture with a caption."""

    caption: str
    pixels: Pixels


def write_report(
    folder: Path,
    results: Sequence[Mapping[str, Any]],
    figures: Sequence[Figure] = (),
    charts: Sequence[str] = (),
    overwrite: bool = False,
) -> list[Path]:
    """Write FOLDER/results.json and FOLDER/report.html; return both paths.

    results: of one protocol, one or several methods. charts: SVG, as `svg` makes it. The same results
    give the same bytes: there is no date in them.

    Raises: InputError: the files exist and not `overwrite`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "drsplat": version("drsplat"),
        "results": [dict(result) for result in results],
    }
    page = html_page(results, tables_of(results), figures, [*charts, *charts_of(results), *_study_charts(results)])
    write_json(folder / RESULTS, without_nan(document), overwrite, allow_nan=False)
    with replacing(folder / PAGE, overwrite) as file:
        file.write(page.encode())
    return [folder / RESULTS, folder / PAGE]


def without_nan(value: Any) -> Any:
    """Replace NaN and infinity, which JSON does not have, by null.

    >>> without_nan({"a": [1.0, float("nan")]})
    {'a': [1.0, None]}
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): without_nan(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(part) for part in value]
    return value


def html_page(
    results: Sequence[Mapping[str, Any]], tables: Sequence[Table], figures: Sequence[Figure], charts: Sequence[str]
) -> str:
    title = f"{results[0]['protocol']}: {', '.join(str(r['method']) for r in results)}"
    notes = [note for note in map(pictures_note, results) if note]
    # tiles of the first method's means over scenes, with a threshold chosen without the truth
    first = results[0]
    columns = first.get("columns", {})
    chosen = next((name for name in COLUMNS if name in columns), None)
    means = columns[chosen]["scene_macro"] if chosen else first.get("segmentation", {}).get("scene_macro", {})
    source = f"{first['method']}, {chosen} threshold" if chosen else str(first["method"])
    tiles = "".join(f"<div><dt>{escape(key)}</dt><dd>{100 * means[key]:.1f} %</dd></div>" for key in means)
    parts = [
        f"<h1>{escape(title)}</h1>",
        *(f'<p class="note">{escape(note)}</p>' for note in notes),
        (f'<p class="note">{escape(source)}: means over scenes</p>\n<dl class="tiles">{tiles}</dl>' if tiles else ""),
    ]
    if charts:
        drawn = "".join(f"<figure>{chart}</figure>\n" for chart in charts)
        parts.append(f'<h2>Charts</h2>\n<div class="charts">{drawn}</div>')
    if figures:
        parts.append(f'<h2>What was selected</h2>\n<div class="pictures">{"".join(map(_figure, figures))}</div>')
    parts += map(_table, tables)
    parts += ["<h2>How thresholds were chosen</h2>", *map(_thresholds, results)]
    parts += ["<h2>Inputs</h2>", *map(_inputs, results)]
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell_text(cell))}</td>" for cell in row) + "</tr>\n" for row in table.rows
    )
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<h2>{escape(table.title)}</h2>\n{note}<div class="scroll"><table><thead><tr>{head}</tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>"
    )


def cell_text(cell: str | float | None) -> str:
    """Format a number with two digits after the point, a whole one without.

    >>> cell_text(43.577), cell_text(4.0), cell_text(None), cell_text(float("nan"))
    ('43.58', '4', '', '')
    """
    if cell is None or isinstance(cell, str):
        return cell or ""
    if not math.isfinite(cell):
        return ""
    return f"{cell:.0f}" if cell == int(cell) else f"{cell:.2f}"


def _figure(figure: Figure) -> str:
    buffer = io.BytesIO()
    Image.fromarray(figure.pixels).save(buffer, "JPEG", quality=JPEG_QUALITY)
    data = base64.b64encode(buffer.getvalue()).decode()
    caption = escape(figure.caption)
    image = f'<img alt="{caption}" src="data:image/jpeg;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def _thresholds(result: Mapping[str, Any]) -> str:
    rows = "".join(f"<li><b>{escape(name)}</b>: {escape(how)}</li>" for name, how in result["thresholds"].items())
    return f"<h3>{escape(str(result['method']))}</h3><ul>{rows}</ul>"


def _inputs(result: Mapping[str, Any]) -> str:
    inputs = {key: result[key] for key in ("scenes", "files") if key in result}
    text = json.dumps(without_nan(inputs), indent=1, default=str)
    return f"<details><summary>{escape(str(result['method']))}</summary><pre>{escape(text)}</pre></details>"


def _study_charts(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Draw Fig. S3: without significance on the left, with it on the right."""
    charts = []
    for result in results:
        for kind in ("unweighted", "weighted") if "study" in result else ():
            study = result["study"]
            points = [(row["voxel"], row[kind], row["scene"]) for row in study["scenes"]]
            correlations = study["correlations"].get(kind)
            note = (
                f"Pearson {correlations['pearson']:.3f}, Spearman {correlations['spearman']:.3f}"
                if correlations
                else ""
            )
            title = "with significance" if kind == "weighted" else "without significance"
            charts.append(scatter(points, "mIoU of voxels", "mIoU of Gaussians", title, note))
    return charts


def charts_of(results: Results) -> list[str]:
    """Return the SVG charts that these results have numbers for; several methods are curves of one chart."""
    with_queries = [(result, _column(result)) for result in results if result.get("queries")]
    charts = [
        _bars(
            ((query["category"], query["iou"][column]) for query in result["queries"]),
            "word", f"{result['method']}, {column} threshold",
        )
        for result, column in with_queries
    ]  # fmt: skip
    for result in results:
        records = result["segmentation"]["by_scene"].values() if "segmentation" in result else ()
        pairs = [(name, numbers["iou"]) for record in records for name, numbers in record["classes"].items()]
        charts += [_bars(pairs, "class", str(result["method"]))] if "segmentation" in result else []
    if with_queries:
        series = [_success_curve(result, column) for result, column in with_queries]
        charts.append(curves(series, "IoU", "percent of answers that reach it", "How many answers are good"))
    return [*charts, *_sweeps(results)]


def _column(result: Mapping[str, Any]) -> str:
    """Return the choice of a threshold to show: one without the truth, if any."""
    columns = list(result["queries"][0]["iou"])
    return next((column for column in COLUMNS if column in columns), columns[0])


def _bars(pairs: Iterable[tuple[str, float]], kind: str, source: str) -> str:
    """Draw a bar for each word or class, best first; only the worst ones where they are many. pairs: names and IoUs."""
    ious: dict[str, list[float]] = {}
    for name, iou in pairs:
        ious.setdefault(name, []).append(iou)
    rows = sorted(((name, 100 * float(np.mean(of))) for name, of in ious.items()), key=lambda row: -row[1])
    cut = f", the {MAX_BARS} worst of {len(rows)}" if len(rows) > MAX_BARS else ""
    return bars(rows[-MAX_BARS:], "%", f"IoU of each {kind}: {source}{cut}")


def _success_curve(result: Mapping[str, Any], column: str) -> Curve:
    """Return the percentage of answers whose IoU reaches each step."""
    ious = np.array([query["iou"][column] for query in result["queries"]])
    steps = np.arange(IOU_STEPS + 1) / IOU_STEPS
    return str(result["method"]), [(float(step), 100 * float((ious >= step).mean())) for step in steps]


def _sweeps(results: Results) -> Iterator[str]:
    """Draw one chart of mIoU by threshold, if any method has several."""
    series: list[Curve] = []
    for result in results:
        points = [(float(name.split()[-1]), 100 * miou) for name, miou in result.get("sweep", {}).items()]
        series += [(str(result["method"]), sorted(points))] if len(points) > 1 else []
    if series:
        yield curves(series, "threshold of all words", "mIoU, percent", "What one threshold for all words gives")
