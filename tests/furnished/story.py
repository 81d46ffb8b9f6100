"""From a room to answers, by way of files and through the public interface only: the fixture of many tests."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from drsplat.base.progress import Stopwatch
from drsplat.errors import InputError
from drsplat.evaluation.demo.story import FIELD, Probe, Verdict
from drsplat.field import LanguageField, load_field
from drsplat.field.codes import Track, untracked
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


@dataclass(frozen=True)
class Setup:
    """coarse: stretches the distances between Gaussians; 2 makes a quarter as many. size: photos, in pixels."""

    coarse: float = 1.0
    num_views: int = 24
    size: tuple[int, int] = (640, 480)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Story:
    """All that the demo did. seconds: by stage."""

    room: Room
    gaussians: Gaussians
    views: list[View]
    field: LanguageField
    verdicts: list[Verdict]
    seconds: dict[str, float]
    num_masks: int
    num_weights: int


def tell(
    folder: Path, setup: Setup = Setup(), *, overwrite: bool = False, threads: int = 0, track: Track = untracked
) -> Story:
    """Make the room's files in `folder`, register them, ask the PROBES.

    Raises: InputError: the folder has something in it and not `overwrite`.
    """
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder} exists already: choose another folder, or pass overwrite=True (--overwrite)")
    watch = Stopwatch()
    views = walk(setup.num_views, *setup.size)
    room = build_room(setup.coarse, setup.seed).seen_from(views)
    watch.lap("build")
    masks = MaskMaker(room, WordEncoder(), setup.seed)
    write_capture(folder, room, views, masks, overwrite=overwrite, track=track, threads=threads)
    watch.lap("photograph")

    gaussians = read_gaussians(folder / "scene.ply")
    views = read_views(folder)
    features = read_features(folder / "language_features", level="large", encoder=WordEncoder.identity)
    registration = register(gaussians, views, features, threads=threads, track=track)
    watch.lap("register")
    registration.to_field(threads=threads, track=track).save(folder / FIELD, overwrite=overwrite)
    field = load_field(folder / FIELD)
    watch.lap("field")
    scene = Scene(field, gaussians)
    verdicts = [ask(scene, room, probe) for probe in PROBES]
    watch.lap("query")
    size = len(registration.embeddings), int(registration.weights.nnz)
    return Story(room, gaussians, views, field, verdicts, watch.seconds, *size)


def ask(scene: Scene, room: Room, probe: Probe) -> Verdict:
    """Ask the scene and hold the matches against the truth, Gaussian by Gaussian."""
    start = time.perf_counter()
    answer = scene.ask(probe.text)
    matches = scene.locate(answer)
    ids = np.sort(np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)]))
    seconds = time.perf_counter() - start
    truth = np.flatnonzero(room.members(*probe.meant))
    iou = intersection_over_union(ids, truth) if probe.meant else None
    center = matches[0].center if matches else None
    limits = float(answer.scores.min(initial=1)), float(answer.scores.max(initial=-1))
    count, none = sum(match.sure for match in matches), np.empty(0, np.int64)
    return Verdict(probe, ids, none, count, len(matches), iou, center, limits, seconds)


def intersection_over_union(a: Int64[np.ndarray, " m"], b: Int64[np.ndarray, " k"]) -> float:
    """Of two sets of different indices; two empty sets are equal."""
    union = len(np.union1d(a, b))
    return len(np.intersect1d(a, b)) / union if union else 1.0
