"""The documents that the page is made from: records of a run, a line each, beside what they were made with."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drsplat import MiniEncoder
from drsplat.evaluation.voxel import VOXEL_SIDE
from drsplat.formats.replacing import replacing
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.encoders import identity_json

from . import answers, running
from .masks import MASKS
from .scenes import LABEL_SET, about, read_scene
from .scoring import SWEEP

BENCHMARK, ANSWERS = "drsplat benchmark", "drsplat answers"
SAME = ("version", "encoder", "label_set", "sweep", "voxel_side")


def results_of(folders: Sequence[Path], every: int, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All that the page is made from; the same scenes and code give the same document, but for the seconds."""
    scenes = {folder.resolve().name: about(read_scene(folder, every)) for folder in folders}
    return {
        "format": BENCHMARK,
        "version": running.VERSION,
        "drsplat": version("drsplat"),
        "encoder": {**identity_json(MiniEncoder().identity), "threshold": MiniEncoder().threshold},
        "segmenter": dict(GraphSegmenter().identity),
        "label_set": LABEL_SET,
        "sweep": list(SWEEP),
        "voxel_side": VOXEL_SIDE,
        "code": {method: running.code_of(method) for method in running.ALL},
        "scenes": scenes,
        "records": list(records),
    }


def with_earlier(results: dict[str, Any], path: Path) -> dict[str, Any]:
    """Add what an earlier run wrote to a file, as far as this run did not make it and it had the same inputs.

    Inputs are the photos, truth and Gaussians of the scene, the encoder and, for masks of `graph`, the segmenter.
    Records of older code are taken too, and the page names them by their stamp: fitted rivals take hours.
    """
    earlier = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if any(earlier.get(key) != results[key] for key in SAME):
        return results
    scenes = earlier["scenes"] | results["scenes"]
    changed = {name for name in earlier["scenes"] if earlier["scenes"][name] != scenes[name]}
    changed_masks = {"graph"} if earlier["segmenter"] != results["segmenter"] else set()
    records = {
        _place_of(record): record
        for record in earlier["records"]
        if record["scene"] not in changed and record["masks"] not in changed_masks
    } | {_place_of(record): record for record in results["records"]}
    return results | {
        "scenes": {name: scenes[name] for name in sorted({name for name, *_ in records} | {*results["scenes"]})},
        "records": [records[place] for place in sorted(records)],
    }


def _place_of(record: dict[str, Any]) -> tuple[str, int, int]:
    return record["scene"], tuple(MASKS).index(record["masks"]), running.ALL.index(record["method"])


def answers_of(draws: answers.Draws, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All that the page says of answers in rooms and captures."""
    return {
        "format": ANSWERS,
        "version": answers.VERSION,
        "drsplat": version("drsplat"),
        "segmenter": dict(GraphSegmenter().identity),
        "wrong": list(draws.wrong),
        "seeds": draws.seeds,
        "records": list(records),
    }


def write_results(path: Path, results: dict[str, Any]) -> None:
    """JSON, a line per record."""
    head = {key: value for key, value in results.items() if key != "records"}
    lines = ",\n".join(json.dumps(record, separators=(",", ":")) for record in results["records"])
    text = json.dumps(head, indent=1)[: -len("\n}")]
    with replacing(path, overwrite=True) as file:
        file.write(f'{text},\n "records": [\n{lines}\n ]\n}}\n'.encode())
