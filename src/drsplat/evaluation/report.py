"""Report of an evaluation: results.json, and one self-contained HTML page."""

import base64
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..base.arrays import Pixels
from ..formats.replacing import replacing
from .svg import Number, bars, curves, scatter
from .tables import Table, pictures_note, tables_of

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
    text = json.dumps(without_nan(document), indent=1, allow_nan=False)
    page = html_page(results, tables_of(results), figures, [*charts, *charts_of(results), *_study_charts(results)])
    written = []
    for name, content in ((RESULTS, text + "\n"), (PAGE, page)):
        with replacing(folder / name, overwrite) as file:
            file.write(content.encode())
        written.append(folder / name)
    return written


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
    parts = [f"<h1>{escape(title)}</h1>", *(f'<p class="note">{escape(note)}</p>' for note in notes), _tiles(results)]
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


def _tiles(results: Sequence[Mapping[str, Any]]) -> str:
    """Return tiles of the first method's means over scenes, with a threshold chosen without the truth."""
    first = results[0]
    columns = first.get("columns", {})
    chosen = next((name for name in COLUMNS if name in columns), None)
    means = columns[chosen]["scene_macro"] if chosen else first.get("segmentation", {}).get("scene_macro", {})
    source = f"{first['method']}, {chosen} threshold" if chosen else str(first["method"])
    tiles = "".join(f"<div><dt>{escape(key)}</dt><dd>{100 * means[key]:.1f} %</dd></div>" for key in means)
    return f'<p class="note">{escape(source)}: means over scenes</p>\n<dl class="tiles">{tiles}</dl>' if tiles else ""


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
    charts = [_word_bars(result, column) for result, column in with_queries]
    charts += [_class_bars(result) for result in results if "segmentation" in result]
    if with_queries:
        series = [_success_curve(result, column) for result, column in with_queries]
        charts.append(curves(series, "IoU", "percent of answers that reach it", "How many answers are good"))
    return [*charts, *_sweeps(results)]


def _column(result: Mapping[str, Any]) -> str:
    """Return the choice of a threshold to show: one without the truth, if any."""
    columns = list(result["queries"][0]["iou"])
    return next((column for column in COLUMNS if column in columns), columns[0])


def _word_bars(result: Mapping[str, Any], column: str) -> str:
    ious: dict[str, list[float]] = {}
    for query in result["queries"]:
        ious.setdefault(query["category"], []).append(query["iou"][column])
    return _bars(ious, "word", f"{result['method']}, {column} threshold")


def _class_bars(result: Mapping[str, Any]) -> str:
    ious: dict[str, list[float]] = {}
    for record in result["segmentation"]["by_scene"].values():
        for name, numbers in record["classes"].items():
            ious.setdefault(name, []).append(numbers["iou"])
    return _bars(ious, "class", str(result["method"]))


def _bars(by_name: Mapping[str, Sequence[float]], kind: str, source: str) -> str:
    """Draw a bar for each word or class, best first; only the worst ones where they are many."""
    rows = sorted(((name, 100 * float(np.mean(ious))) for name, ious in by_name.items()), key=lambda row: -row[1])
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
