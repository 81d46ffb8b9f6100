"""A method on one scene under every protocol: predicted to a folder, scored from there."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from drsplat.evaluation import lerf_ovs, scannet_points, scannet_volume, voxel
from drsplat.evaluation.predictions import FIXED, Chooser, sweep_column
from drsplat.evaluation.running import AUTOMATIC, automatic_choosers
from drsplat.evaluation.scorers import Scorer

from .scenes import BenchScene

SWEEP = tuple(k / 20 for k in range(2, 13))
"""Thresholds that the tuned one is chosen from."""
DIGITS = 5


@dataclass(frozen=True)
class Methods:
    """One method on the trained Gaussians, and on those at the points."""

    volume: Scorer
    points: Scorer


def scored(scene: BenchScene, methods: Methods, threads: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Numbers of each protocol, from 0 to 1, and the seconds that it took."""
    with TemporaryDirectory(prefix="drsplat-benchmark-") as place:
        return _scored(scene, methods, Path(place), threads)


def _scored(scene: BenchScene, methods: Methods, folder: Path, threads: int) -> tuple[dict[str, Any], dict[str, float]]:
    volume = replace(methods.volume, sweep=SWEEP)
    choosers = {AUTOMATIC: automatic_choosers(volume)[AUTOMATIC]}
    numbers: dict[str, Any] = {}
    seconds: dict[str, float] = {}
    start = time.perf_counter()
    numbers["lerf-ovs"] = _selection(scene, volume, choosers, folder / "lerf", threads)
    seconds["lerf-ovs"], start = time.perf_counter() - start, time.perf_counter()
    numbers["scannet-volume"] = _volume(scene, volume, choosers, folder / "volume")
    seconds["scannet-volume"], start = time.perf_counter() - start, time.perf_counter()
    numbers["voxel"] = _voxel(scene, folder / "volume", threads)
    seconds["voxel"], start = time.perf_counter() - start, time.perf_counter()
    scannet_points.predict(scene.points, methods.points, folder / "points")
    found = scannet_points.score([scene.points], folder / "points")
    numbers["scannet-points"] = {"segmentation": found["segmentation"]["scene_macro"]}
    seconds["scannet-points"] = time.perf_counter() - start
    return rounded(numbers), seconds


def _selection(
    scene: BenchScene, scorer: Scorer, choosers: Mapping[str, tuple[Chooser, str]], folder: Path, threads: int
) -> dict[str, Any]:
    lerf_ovs.predict(scene.lerf, scene.gaussians, scorer, folder, choosers=choosers, threads=threads)
    result = lerf_ovs.score([scene.lerf], folder)
    columns = {name: result["columns"][name]["scene_macro"] for name in (FIXED, AUTOMATIC)}
    leaked = result["scenes"][0]["leaked"]
    seen = [result["sweep_seen"][sweep_column(threshold)] for threshold in SWEEP]
    return {"columns": columns, "sweep": _sweep(result), "sweep_seen": seen, "leaked": leaked}


def _volume(
    scene: BenchScene, scorer: Scorer, choosers: Mapping[str, tuple[Chooser, str]], folder: Path
) -> dict[str, Any]:
    scannet_volume.predict(scene.volume, scorer, folder, choosers=choosers)
    result = scannet_volume.score([scene.volume], folder)
    found = result["localization"]
    columns = {name: found[name]["scene_macro"] for name in (FIXED, AUTOMATIC)}
    segmentation = result["segmentation"]["scene_macro"]
    return {"segmentation": segmentation, "columns": columns, "sweep": _sweep(result)}


def _sweep(result: Mapping[str, Any]) -> list[float]:
    """mIoU at each threshold of SWEEP."""
    return [result["sweep"][sweep_column(threshold)] for threshold in SWEEP]


def _voxel(scene: BenchScene, folder: Path, threads: int) -> dict[str, Any]:
    """Of the predictions of scannet-volume."""
    result = voxel.score([scene.volume], folder, threads=threads)
    compared = dict(result["study"]["scenes"][0])
    return {"segmentation": result["segmentation"]["scene_macro"], "study": compared}


def rounded(value: Any) -> Any:
    """All numbers to five digits: the last ones are noise of the processor's arithmetic."""
    if isinstance(value, float):
        return round(value, DIGITS)
    if isinstance(value, Mapping):
        return {key: rounded(part) for key, part in value.items()}
    return [rounded(part) for part in value] if isinstance(value, list) else value
