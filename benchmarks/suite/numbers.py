"""Records of a run to lists over its scenes, means and intervals. All in percent."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drsplat.evaluation import scorers
from drsplat.evaluation.predictions import FIXED

MIN_SCENES = 3  # for a correlation to be printed

Record = Mapping[str, Any]
Results = Mapping[str, Any]
Pick = Callable[[Record], float]


def _column(protocol: str, column: str, number: str) -> Pick:
    return lambda record: float(record[protocol]["columns"][column][number])


def _segmentation(protocol: str, number: str) -> Pick:
    return lambda record: float(record[protocol]["segmentation"][number])


MEASURES: dict[str, Pick] = {
    "selection": _column("lerf-ovs", FIXED, "miou"),
    "automatic": _column("lerf-ovs", "automatic", "miou"),
    "localization": _column("lerf-ovs", FIXED, "localization"),
    "volume": _segmentation("scannet-volume", "miou"),
    "points": _segmentation("scannet-points", "miou"),
    "voxel": _segmentation("voxel", "miou"),
}


def records_of(results: Results, masks: str, method: str) -> list[Record]:
    """Of all scenes, in their order."""
    return [r for r in results["records"] if (r["masks"], r["method"]) == (masks, method)]


def values(results: Results, masks: str, method: str, key: str) -> list[float]:
    """Return a number per scene, in percent."""
    return [100 * MEASURES[key](record) for record in records_of(results, masks, method)]


def by_scene(results: Results, masks: str, method: str, key: str) -> dict[str, float]:
    scenes = [record["scene"] for record in records_of(results, masks, method)]
    return dict(zip(scenes, values(results, masks, method, key), strict=True))


def difference(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """Scene by scene."""
    return [x - y for x, y in zip(a, b, strict=True)]


def over_places(places: Sequence[Sequence[float]], words: Sequence[Sequence[str]]) -> tuple[float, float, float]:
    """Return the mean over places of the mean over answers, and its 95 % interval over the words.

    Answers to the same word in the same place are one draw: with other masks wrong they are about as good. Places are
    few, so they are taken as given, and the interval says how other words would do in the same places.
    Source: variance of a mean of clusters, Liang and Zeger 1986.
    """
    mean = scorers.mean([scorers.mean(numbers) for numbers in places])
    variance = sum(map(_variance, places, words)) / len(places) ** 2
    half = 1.96 * variance**0.5
    return mean, mean - half, mean + half


def _variance(numbers: Sequence[float], words: Sequence[str]) -> float:
    """Of the mean of some numbers, of which those of one word belong together."""
    _, word_of = np.unique(words, return_inverse=True)
    of_word = np.bincount(word_of, np.asarray(numbers) - np.mean(numbers))
    return float((of_word**2).sum()) / len(numbers) ** 2


def within(mean: float, low: float, high: float, signed: bool = False) -> str:
    """Say a mean with its interval.

    >>> within(1.25, 1.0, 1.5, signed=True)
    '+1.2 [+1.0, +1.5]'
    """
    style = "+.1f" if signed else ".1f"
    return f"{mean:{style}} [{low:{style}}, {high:{style}}]"


def said(numbers: Sequence[float], signed: bool = False) -> str:
    """Mean and, of two scenes or more, its interval.

    >>> said([10.0, 10.0]), said([1.25], signed=True)
    ('10.0 [10.0, 10.0]', '+1.2')
    """
    style = "+.1f" if signed else ".1f"
    mean = f"{scorers.mean(numbers):{style}}"
    if len(numbers) < 2:
        return mean
    return within(scorers.mean(numbers), *scorers.mean_interval(numbers), signed)


def methods_of(results: Results, masks: str) -> list[str]:
    """In the order of the run."""
    found = [r["method"] for r in results["records"] if r["masks"] == masks]
    return list(dict.fromkeys(found))


def masks_of(results: Results) -> list[str]:
    return list(dict.fromkeys(r["masks"] for r in results["records"]))


def correlations(records: Sequence[Record]) -> dict[str, dict[str, float]]:
    """Of mIoU by Gaussians with voxels, with and without significance; {} of fewer than three scenes.

    Source: Dr. Splat Fig. S3.
    """
    rows = [record["voxel"]["study"] for record in records]
    if len(rows) < MIN_SCENES:
        return {}
    voxels = [row["voxel"] for row in rows]
    return {
        kind: {
            "pearson": scorers.pearson(voxels, [row[kind] for row in rows]),
            "spearman": scorers.spearman(voxels, [row[kind] for row in rows]),
        }
        for kind in ("weighted", "unweighted")
    }
