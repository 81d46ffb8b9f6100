"""Another scale for an existing capture: its poses stay, and no features are computed."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Any

from ...formats.colmap import read_colmap
from ...formats.json_files import read_json
from ...formats.replacing import replacing
from .finding import Source
from .measuring import units_between
from .program import ask_colmap
from .settings import KNOWN_DISTANCE, SCALE, CaptureSettings
from .work import MODEL, RECORD, Work

STAYING = ("images", "masks", "georeference.json")
_OF_LENGTHS = ("scale", "known_distance")
_IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def sources_key(sources: Sequence[Source]) -> str:
    """Return a text that changes with the photos, by their names, sizes and times."""
    photos = [(source.name, source.num_bytes, source.changed_ns) for source in sources]
    return hashlib.blake2b(json.dumps(photos).encode(), digest_size=16).hexdigest()


def differs_in_scale(sources: Sequence[Source], output: Path, settings: CaptureSettings) -> bool:
    """Return whether the output is of the same photos and settings, except for a new scale or known distance."""
    if not ((output / RECORD).is_file() and (output / MODEL / "0").is_dir()):
        return False
    record = read_json(output / RECORD)
    if not isinstance(record, dict) or record.get("sources") != sources_key(sources):
        return False
    before = record.get("settings")
    if not isinstance(before, dict):
        return False
    now: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    rest = [{key: value for key, value in each.items() if key not in _OF_LENGTHS} for each in (before, now)]
    return rest[0] == rest[1] and any(now[key] not in (None, before.get(key)) for key in _OF_LENGTHS)


def rescale(sources: Sequence[Source], output: Path, settings: CaptureSettings) -> None:
    """Write a capture's model and record at another scale, where `work.publish` expects them."""
    work = Work(output)
    model = output / MODEL / "0"
    record: dict[str, Any] = json.loads((output / RECORD).read_text(encoding="utf-8"))
    if settings.known_distance is None:
        factor = (settings.scale or 1.0) / record["scale_factor"]
    else:
        names = _names([view.name for view in read_colmap(model)], [source.name for source in sources])
        factor = settings.known_distance.metres / units_between(settings.known_distance, model, work.log, names)
    ask_colmap(
        "place", work.log, model=str(model), output=str(work.new / MODEL / "0"), names={}, scale=factor,
        rotation=_IDENTITY, translation=[0.0, 0.0, 0.0],
    )  # fmt: skip
    record |= {
        "unit": "m",
        "scale_from": SCALE if settings.known_distance is None else KNOWN_DISTANCE,
        "scale_factor": record["scale_factor"] * factor,
        "settings": asdict(settings),
    }
    with replacing(work.new / RECORD, overwrite=True) as file:
        file.write(json.dumps(record, indent=1).encode())


def _names(posed: Sequence[str], sources: Sequence[str]) -> dict[str, str]:
    """Return names in the capture by the same name and by the photo's name before it got another suffix."""
    by_stem = {str(PurePosixPath(name).with_suffix("")): name for name in posed}
    stems = {name: str(PurePosixPath(name).with_suffix("")) for name in sources}
    before = {name: by_stem[stem] for name, stem in stems.items() if stem in by_stem}
    return before | {name: name for name in posed}
