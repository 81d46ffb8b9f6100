"""From a room to answers, by way of files and through the public interface only: the fixture of many tests."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from drsplat.codes import Track, untracked
from drsplat.errors import InputError
from drsplat.field import LanguageField, load_field
from drsplat.formats.captures import read_views
from drsplat.formats.langsplat import read_features
from drsplat.formats.scenes import read_gaussians
from drsplat.gaussians import Gaussians
from drsplat.registration import register
from drsplat.tasks import locate
from drsplat.views import View
from drsplat.words import WordEncoder

from .cameras import walk
from .capture import write_capture
from .masks import MaskMaker
from .questions import QUESTIONS, Question
from .room import Room, build_room

FIELD = "room.field"
MIN_GAUSSIANS = 40  # smaller things are specks where masks met


@dataclass(frozen=True)
class Setup:
    """coarse: stretches the distances between Gaussians; 2 makes a quarter as many. size: photos, in pixels."""

    coarse: float = 1.0
    num_views: int = 24
    size: tuple[int, int] = (640, 480)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Answer:
    """gaussian_ids: of all that was found. iou: with the truth, over Gaussians; None where nothing is right.

    center: of the best instance, in metres, or None. scores: lowest and highest of the field.
    """

    question: Question
    gaussian_ids: Int64[np.ndarray, " m"]
    num_instances: int
    iou: float | None
    center: Float64[np.ndarray, " 3"] | None
    scores: tuple[float, float]
    seconds: float

    @property
    def found(self) -> bool:
        return self.num_instances > 0

    @property
    def is_right(self) -> bool:
        """Found, and more right than wrong; or rightly not found."""
        return not self.found if self.iou is None else self.iou > 0.5


@dataclass(frozen=True, eq=False)
class Story:
    """All that the demo did. seconds: by stage."""

    room: Room
    gaussians: Gaussians
    views: list[View]
    field: LanguageField
    answers: list[Answer]
    seconds: dict[str, float]
    num_segments: int
    num_weights: int


def tell(
    folder: Path,
    setup: Setup = Setup(),
    *,
    overwrite: bool = False,
    threads: int = 0,
    track: Track = untracked,
) -> Story:
    """Make the room's files in `folder`, register them, ask the QUESTIONS.

    Raises: InputError: the folder has something in it and not `overwrite`.
    """
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(
            f"{folder} exists already: choose another folder, or pass overwrite=True (--overwrite)"
        )
    clock = _Clock()
    views = walk(setup.num_views, *setup.size)
    room = build_room(setup.coarse, setup.seed).seen_from(views)
    clock.lap("build")
    masks = MaskMaker(room, WordEncoder(), setup.seed)
    write_capture(folder, room, views, masks, overwrite=overwrite, track=track, threads=threads)
    clock.lap("photograph")

    gaussians = read_gaussians(folder / "scene.ply")
    views = read_views(folder)
    features = read_features(
        folder / "language_features", level="large", encoder=WordEncoder.identity
    )
    registration = register(gaussians, views, features, topk=40, threads=threads, track=track)
    clock.lap("register")
    registration.to_field(threads=threads, track=track).save(folder / FIELD, overwrite=overwrite)
    field = load_field(folder / FIELD)
    clock.lap("field")
    answers = [ask(field, gaussians, room, question) for question in QUESTIONS]
    clock.lap("query")
    size = len(registration.embeddings), int(registration.weights.nnz)
    return Story(room, gaussians, views, field, answers, clock.laps, *size)


def ask(field: LanguageField, gaussians: Gaussians, room: Room, question: Question) -> Answer:
    """Query the field and hold the answer against the truth."""
    start = time.perf_counter()
    encoder = WordEncoder()
    scores = field.scores(encoder.encode_texts([question.text])[0])
    threshold, least = encoder.threshold, MIN_GAUSSIANS
    things = locate(field, gaussians, scores, threshold=threshold, min_gaussians=least)
    ids = np.sort(
        np.concatenate([thing.gaussian_ids for thing in things] or [np.empty(0, np.int64)])
    )
    seconds = time.perf_counter() - start
    truth = np.flatnonzero(room.members(*question.things))
    iou = intersection_over_union(ids, truth) if question.things else None
    center = things[0].center if things else None
    limits = float(scores.min(initial=1)), float(scores.max(initial=-1))
    return Answer(question, ids, len(things), iou, center, limits, seconds)


def intersection_over_union(a: Int64[np.ndarray, " m"], b: Int64[np.ndarray, " k"]) -> float:
    """Of two sets of different indices; two empty sets are equal."""
    union = len(np.union1d(a, b))
    return len(np.intersect1d(a, b)) / union if union else 1.0


class _Clock:
    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name], self._last = now - self._last, now
