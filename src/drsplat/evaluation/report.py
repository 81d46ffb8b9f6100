"""results.json, and one HTML page that needs nothing else."""

import base64
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..arrays import UInt8
from ..formats.replacing import replacing
from .svg import scatter
from .tables import Table, pictures_note, tables_of

FORMAT, VERSION = "drsplat evaluation", 1
RESULTS, PAGE = "results.json", "report.html"
JPEG_QUALITY = 85
_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1e24; background: #fff; margin: 2rem auto;
  max-width: 70rem; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
table { border-collapse: collapse; margin: .5rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid #e3e5ea; text-align: right; }
th:first-child, td:first-child { text-align: left; } th { border-bottom: 2px solid #1c1e24; }
.scroll { overflow-x: auto; } p.note { color: #5a5e68; font-size: .9rem; max-width: 60rem; }
figure { display: inline-block; margin: .4rem; vertical-align: top; }
figcaption { font-size: .85rem; color: #5a5e68; max-width: 22rem; }
img { max-width: 22rem; height: auto; display: block; }
pre { background: #f5f6f8; padding: .8rem; overflow-x: auto; font-size: .8rem; }
"""


@dataclass(frozen=True, eq=False)
class Figure:
    """A picture and what it shows."""

    caption: str
    pixels: UInt8[np.ndarray, "h w 3"]


def write_report(
    folder: Path,
    results: Sequence[Mapping[str, Any]],
    figures: Sequence[Figure] = (),
    charts: Sequence[str] = (),
    overwrite: bool = False,
) -> list[Path]:
    """Write FOLDER/results.json and FOLDER/report.html; returns both.

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
    page = html_page(results, tables_of(results), figures, [*charts, *_study_charts(results)])
    written = []
    for name, content in ((RESULTS, text + "\n"), (PAGE, page)):
        with replacing(folder / name, overwrite) as file:
            file.write(content.encode())
        written.append(folder / name)
    return written


def without_nan(value: Any) -> Any:
    """JSON has no word for NaN and infinity: null.

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
    parts = [f"<h1>{escape(title)}</h1>", *(f'<p class="note">{escape(note)}</p>' for note in notes)]
    parts += map(_table, tables)
    if charts:
        parts += ["<h2>Charts</h2>", *(f"<figure>{chart}</figure>" for chart in charts)]
    if figures:
        parts += ["<h2>What was selected</h2>", *map(_figure, figures)]
    parts += ["<h2>How thresholds were chosen</h2>", *map(_thresholds, results)]
    parts += ["<h2>Inputs</h2>", *map(_inputs, results)]
    body = "\n".join(parts)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(shown(cell))}</td>" for cell in row) + "</tr>\n" for row in table.rows
    )
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<h2>{escape(table.title)}</h2>\n{note}<div class="scroll"><table><thead><tr>{head}</tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>"
    )


def shown(cell: str | float | None) -> str:
    """Numbers with two digits after the point, whole ones without.

    >>> shown(43.577), shown(4.0), shown(None), shown(float("nan"))
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
    known = {key: result[key] for key in ("scenes", "files") if key in result}
    text = json.dumps(without_nan(known), indent=1, default=str)
    return f"<details><summary>{escape(str(result['method']))}</summary><pre>{escape(text)}</pre></details>"


def _study_charts(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Fig. S3: without significance on the left, with it on the right."""
    charts = []
    for result in results:
        for kind in ("unweighted", "weighted") if "study" in result else ():
            study = result["study"]
            points = [(row["voxel"], row[kind], row["scene"]) for row in study["scenes"]]
            found = study["correlations"].get(kind)
            note = f"Pearson {found['pearson']:.3f}, Spearman {found['spearman']:.3f}" if found else ""
            title = "with significance" if kind == "weighted" else "without significance"
            charts.append(scatter(points, "mIoU of voxels", "mIoU of Gaussians", title, note))
    return charts
