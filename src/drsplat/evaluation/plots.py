"""Charts of results: how well each word or class is found, how many answers are good, and what a threshold does."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from .svg import Number, bars, curves

MOST_BARS = 20  # words or classes, the worst ones where there are more
COLUMNS = ("automatic", "fixed")  # choices of a threshold, those without knowledge of the truth, best first
IOU_STEPS = 40  # of the curve over IoU, from 0 to 1

Results = Sequence[Mapping[str, Any]]
Curve = tuple[str, Sequence[tuple[Number, Number]]]


def charts_of(results: Results) -> list[str]:
    """Return SVG of all that these results have numbers for; several methods are curves of one chart."""
    asked = [(result, _column(result)) for result in results if result.get("queries")]
    charts = [_word_bars(result, column) for result, column in asked]
    charts += [_class_bars(result) for result in results if "segmentation" in result]
    if asked:
        charts.append(_success([_success_curve(result, column) for result, column in asked]))
    return [*charts, *_sweeps(results)]


def _column(result: Mapping[str, Any]) -> str:
    """Return the choice of a threshold that charts show: one without the truth where there is any."""
    known = list(result["queries"][0]["iou"])
    return next((column for column in COLUMNS if column in known), known[0])


def _word_bars(result: Mapping[str, Any], column: str) -> str:
    found: dict[str, list[float]] = {}
    for one in result["queries"]:
        found.setdefault(one["category"], []).append(one["iou"][column])
    return _bars(found, "word", f"{result['method']}, {column} threshold")


def _class_bars(result: Mapping[str, Any]) -> str:
    found: dict[str, list[float]] = {}
    for record in result["segmentation"]["by_scene"].values():
        for name, numbers in record["classes"].items():
            found.setdefault(name, []).append(numbers["iou"])
    return _bars(found, "class", str(result["method"]))


def _bars(found: Mapping[str, Sequence[float]], kind: str, whose: str) -> str:
    """Return a bar for each word or class, best first; the worst ones where they are many."""
    rows = sorted(((name, 100 * float(np.mean(ious))) for name, ious in found.items()), key=lambda row: -row[1])
    some = f", the {MOST_BARS} worst of {len(rows)}" if len(rows) > MOST_BARS else ""
    return bars(rows[-MOST_BARS:], "%", f"IoU of each {kind}: {whose}{some}")


def _success_curve(result: Mapping[str, Any], column: str) -> Curve:
    """Return the percent of the answers whose IoU reaches each of some values."""
    ious = np.array([one["iou"][column] for one in result["queries"]])
    steps = np.arange(IOU_STEPS + 1) / IOU_STEPS
    return str(result["method"]), [(float(step), 100 * float((ious >= step).mean())) for step in steps]


def _success(series: Sequence[Curve]) -> str:
    return curves(series, "IoU", "percent of answers that reach it", "How many answers are good")


def _sweeps(results: Results) -> Iterator[str]:
    """One chart of mIoU by threshold, if any method was asked with several."""
    series: list[Curve] = []
    for result in results:
        points = [(float(name.split()[-1]), 100 * miou) for name, miou in result.get("sweep", {}).items()]
        series += [(str(result["method"]), sorted(points))] if len(points) > 1 else []
    if series:
        yield curves(series, "threshold of all words", "mIoU, percent", "What one threshold for all words gives")
