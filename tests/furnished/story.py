"""From a room to answers, by way of files and through the public interface only: the fixture of many tests."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from drsplat.evaluation.demo.story import FIELD, Probe, Verdict
from drsplat.field import LanguageField, load_field
from drsplat.field.registration import register
from drsplat.formats.captures import read_views
from drsplat.formats.langsplat import read_features
from drsplat.formats.scenes import read_gaussians
from drsplat.photos.models.words import WordEncoder
from drsplat.query import Scene
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.views import View

from .cameras import walk
from .capture import write_capture
from .masks import MaskMaker
from .probes import PROBES
from .room import Room, build_room

COARSE, NUM_VIEWS, SIZE = 2.0, 12, (320, 240)


@dataclass(frozen=True, eq=False)
class Story:
    room: Room
    gaussians: Gaussians
    views: list[View]
    field: LanguageField
    verdicts: list[Verdict]
    num_masks: int


def tell(folder: Path) -> Story:
    """Make the room's files in `folder`, register them, ask the PROBES."""
    views = walk(NUM_VIEWS, *SIZE)
    room = build_room(COARSE).seen_from(views)
    write_capture(folder, room, views, MaskMaker(room, WordEncoder()))
    gaussians, views = read_gaussians(folder / "scene.ply"), read_views(folder)
    features = read_features(folder / "language_features", level="large", encoder=WordEncoder.identity)
    registration = register(gaussians, views, features)
    registration.to_field().save(folder / FIELD)
    field = load_field(folder / FIELD)
    scene = Scene(field, gaussians)
    verdicts = [ask(scene, room, probe) for probe in PROBES]
    return Story(room, gaussians, views, field, verdicts, len(registration.embeddings))


def ask(scene: Scene, room: Room, probe: Probe) -> Verdict:
    """Ask the scene and hold the matches against the truth, Gaussian by Gaussian."""
    answer = scene.ask(probe.text)
    matches = scene.locate(answer)
    ids = np.sort(np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)]))
    truth = np.flatnonzero(room.members(*probe.meant))
    iou = intersection_over_union(ids, truth) if probe.meant else None
    center = matches[0].center if matches else None
    limits = float(answer.scores.min(initial=1)), float(answer.scores.max(initial=-1))
    count, none = sum(match.sure for match in matches), np.empty(0, np.int64)
    return Verdict(probe, ids, none, count, len(matches), iou, center, limits, 0.0)


def intersection_over_union(a: Int64[np.ndarray, " m"], b: Int64[np.ndarray, " k"]) -> float:
    """Of two sets of different indices; two empty sets are equal."""
    union = len(np.union1d(a, b))
    return len(np.intersect1d(a, b)) / union if union else 1.0
