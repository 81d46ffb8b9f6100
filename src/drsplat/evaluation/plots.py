"""Charts of results: IoU by word or class, share of good answers, and the effect of the threshold."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from .svg import Number, bars, curves

MAX_BARS = 20  # words or classes; the worst ones where there are more
COLUMNS = ("automatic", "fixed")  # choices of a threshold without the truth, best first
IOU_STEPS = 40  # of the curve over IoU, from 0 to 1

Results = Sequence[Mapping[str, Any]]
Curve = tuple[str, Sequence[tuple[Number, Number]]]


def charts_of(results: Results) -> list[str]:
    """Return the SVG charts that these results have numbers for; several methods are curves of one chart."""
    with_queries = [(result, _column(result)) for result in results if result.get("queries")]
    charts = [_word_bars(result, column) for result, column in with_queries]
    charts += [_class_bars(result) for result in results if "segmentation" in result]
    if with_queries:
        charts.append(_success([_success_curve(result, column) for result, column in with_queries]))
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


def _success(series: Sequence[Curve]) -> str:
    return curves(series, "IoU", "percent of answers that reach it", "How many answers are good")


def _sweeps(results: Results) -> Iterator[str]:
    """Draw one chart of mIoU by threshold, if any method has several."""
    series: list[Curve] = []
    for result in results:
        points = [(float(name.split()[-1]), 100 * miou) for name, miou in result.get("sweep", {}).items()]
        series += [(str(result["method"]), sorted(points))] if len(points) > 1 else []
    if series:
        yield curves(series, "threshold of all words", "mIoU, percent", "What one threshold for all words gives")
