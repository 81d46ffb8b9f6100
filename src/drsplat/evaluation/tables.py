"""Results as tables: ours by choice of threshold, those of papers beside them.

Numbers of papers, each with its source, are in published.tsv. `same_data` says whether a result is of the same scenes
and labels; only then is a difference shown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from ..scene.views import PHOTOS
from .scorers import mean_interval

Cell = str | float | None
SEEN = "seen is the mIoU of where it is more than half of the whole picture"
DR_SPLAT = "Dr. Splat"


@dataclass(frozen=True)
class Published:
    """Line of a paper's table. numbers: by metric, in per cent."""

    method: str
    numbers: Mapping[str, float]
    source: str

    @property
    def named(self) -> str:
        """Method and source."""
        return f"{self.method} ({self.source})"


@dataclass(frozen=True)
class Table:
    """Table of numbers as they are shown; `note` explains them.

    aside: for the report only, not for the terminal.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    aside: bool = False


def pictures_judged(result: Mapping[str, Any]) -> str | None:
    """Return what the fields of a result were made from: "photos", "renderings" or both; None if unknown."""
    scorers = [scene.get("inputs", {}).get("scorer", {}) for scene in result.get("scenes", ())]
    kinds = [kind for scorer in scorers for kind in str(scorer.get("pictures", "")).split(" and ") if kind]
    return " and ".join(sorted(set(kinds))) or None


def pictures_note(result: Mapping[str, Any]) -> str:
    """Return a sentence where a field was made from renderings, else ""."""
    pictures = result.get("pictures") or PHOTOS
    return "" if pictures == PHOTOS else f"{result['method']}: its fields were made from {pictures} of the scenes"


def tables_of(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return all tables of results of one protocol, of one or several methods."""
    tables = []
    for task, pick in (("selection", _selection), ("localization", lambda result: result.get("localization", {}))):
        blocks = [(result, pick(result)) for result in results if pick(result)]
        if blocks:
            tables.append(_by_column(task, blocks))
            tables += _other_data(blocks[0][0], task)
    segmented = [result for result in results if "segmentation" in result]
    if segmented:
        tables.append(_segmentation(segmented))
        tables += _other_data(segmented[0], "segmentation")
        tables += [_classes(result) for result in segmented]
    tables += [_scenes(result) for result in results if _selection(result)]
    tables += [_study(result["study"]) for result in results if "study" in result]
    return tables


def _selection(result: Mapping[str, Any]) -> Mapping[str, Any]:
    return result.get("columns", {})


def _by_column(task: str, blocks: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Table:
    """Return a table with a row for each choice of threshold and each kind of mean."""
    first = next(iter(blocks[0][1].values()))
    keys = tuple(first["scene_macro"])
    rows: list[tuple[Cell, ...]] = []
    for result, columns in blocks:
        for column, summary in columns.items():
            for mean in ("scene_macro", "query_micro"):
                numbers = [100 * summary[mean][key] for key in keys]
                rows.append((result["method"], column, mean.replace("_", "-"), *numbers))
    ours = [100 * first["scene_macro"][key] for key in keys]
    rows += _papers(blocks[0][0], task, keys, ours, 3)
    notes = [f"{name}: {how}" for name, how in blocks[0][0]["thresholds"].items()]
    if "seen" in keys:
        notes.append(f"miou and accuracies are of the selection drawn alone, {SEEN}")
    note = "; ".join(notes)
    title = f"{blocks[0][0]['protocol']}: {task}"
    return Table(title, ("method", "threshold", "mean", *keys), tuple(rows), note)


def _segmentation(results: Sequence[Mapping[str, Any]]) -> Table:
    keys = ("miou", "macc")
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        numbers = [100 * result["segmentation"]["scene_macro"][key] for key in keys]
        by_scene = [100 * r["miou"] for r in result["segmentation"]["by_scene"].values()]
        rows.append((result["method"], *numbers, *mean_interval(by_scene)))
    ours = [float(value) for value in rows[0][1:3] if isinstance(value, float)]
    first = results[0]
    rows += [(*row, None, None) for row in _papers(first, "segmentation", keys, ours, 1)]
    title = f"{first['protocol']}: segmentation, {first['label_set']}"
    columns = ("method", *keys, "miou, 95 % from", "to")
    return Table(title, columns, tuple(rows), "interval: bootstrap over scenes")


def _papers(
    result: Mapping[str, Any], task: str, keys: Sequence[str], ours: Sequence[float], width: int
) -> list[tuple[Cell, ...]]:
    """Return the papers' rows and our difference from the paper's, on the same data only."""
    published = published_for(result, task) if same_data(result) else ()
    empty: list[Cell] = [""] * (width - 1)
    rows: list[tuple[Cell, ...]] = [(entry.named, *empty, *map(entry.numbers.get, keys)) for entry in published]
    for entry in [entry for entry in published if entry.method == DR_SPLAT][:1]:
        theirs = map(entry.numbers.get, keys)
        gaps = [None if their is None else mine - their for mine, their in zip(ours, theirs, strict=True)]
        rows.append(("ours minus the paper's", *empty, *gaps))
    return rows


def _other_data(result: Mapping[str, Any], task: str) -> list[Table]:
    """Return a table of the papers' numbers for this protocol, if our data is not theirs."""
    published = published_for(result, task)
    if not published or same_data(result):
        return []
    keys = tuple(dict.fromkeys(key for entry in published for key in entry.numbers))
    rows = tuple((entry.named, *map(entry.numbers.get, keys)) for entry in published)
    title = f"{result['protocol']}: {task} in papers"
    note = "Of other scenes than those above: the numbers cannot be compared."
    return [Table(title, ("method", *keys), rows, note, aside=True)]


def _classes(result: Mapping[str, Any]) -> Table:
    by_scene = result["segmentation"]["by_scene"]
    names = sorted({name for record in by_scene.values() for name in record["classes"]})
    rows = []
    for name in names:
        ious = [r["classes"][name]["iou"] for r in by_scene.values() if name in r["classes"]]
        rows.append((name, float(len(ious)), 100 * sum(ious) / len(ious)))
    title = f"{result['protocol']}: IoU of each class, {result['method']}"
    return Table(title, ("class", "scenes", "mean IoU"), tuple(rows))


def _scenes(result: Mapping[str, Any]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    keys: tuple[str, ...] = ()
    for column, summary in result["columns"].items():
        for scene, numbers in summary["by_scene"].items():
            keys = tuple(numbers)
            rows.append((scene, column, *(100 * numbers[key] for key in keys)))
    leaked = [
        f"{s['name']}: labelled photos that the method was made from: "
        + ("not known" if s["leaked"] is None else ", ".join(s["leaked"]) or "none")
        for s in result["scenes"]
    ]
    title = f"{result['protocol']}: by scene, {result['method']}"
    return Table(title, ("scene", "threshold", *keys), tuple(rows), "; ".join(leaked))


def _study(study: Mapping[str, Any]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (row["scene"], *(100 * row[key] for key in ("voxel", "weighted", "unweighted"))) for row in study["scenes"]
    ]
    for name in ("pearson", "spearman"):
        correlations = study["correlations"]
        if correlations:
            rows.append((f"{name} with voxels", None, *(correlations[k][name] for k in ("weighted", "unweighted"))))
    note = "" if study["enough_scenes"] else "fewer than eight scenes: too few for a correlation to mean much"
    columns = ("scene", "voxels", "with significance", "without")
    return Table("Fig. S3: mIoU by voxels, and by Gaussians", columns, tuple(rows), note)


LERF_PAIRS = {"figurines": 56, "ramen": 71, "teatime": 59, "waldo_kitchen": 22}
"""Number of pairs of a photo and a category in the labels of LERF-OVS."""

SCANNET_8 = frozenset(
    f"scene{number}_00" for number in ("0000", "0062", "0070", "0097", "0140", "0347", "0400", "0590")
)
SCANNET_10 = SCANNET_8 | {"scene0200_00", "scene0645_00"}


def published_for(result: Mapping[str, Any], task: str) -> tuple[Published, ...]:
    """Return the numbers of papers for a protocol and task ("selection", "segmentation", "localization")."""
    wanted = result["protocol"].partition("@")[0], task, str(result.get("label_set"))
    text = (files(__package__) / "published.tsv").read_text(encoding="utf-8")
    names, *rows = (line.split("\t") for line in text.splitlines())
    return tuple(
        Published(
            row[3], {name: float(cell) for name, cell in zip(names[5:], row[5:], strict=True) if cell != "-"}, row[4]
        )
        for row in rows
        if all(cell in ("-", own) for cell, own in zip(row, wanted, strict=False))
    )


def same_data(result: Mapping[str, Any]) -> bool:
    """Return whether a result is of the same scenes as the published numbers.

    >>> same_data({"protocol": "lerf-ovs@1", "scenes": [{"name": "teatime", "pairs": 59}]})
    False
    """
    scenes = result["scenes"]
    names = {scene["name"] for scene in scenes}
    if result["protocol"].startswith("lerf-ovs@"):
        return {scene["name"]: scene["pairs"] for scene in scenes} == LERF_PAIRS
    if result["protocol"].startswith("scannet-points@"):
        return names == SCANNET_10
    return result["protocol"].startswith("scannet-volume@") and names == SCANNET_8
