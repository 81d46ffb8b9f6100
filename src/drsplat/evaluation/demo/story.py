"""Run of the demo through the public interface only: masks, embeddings, registration, field, words."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...base.arrays import Bool, Float32, Float64, Int64
from ...base.progress import Stopwatch
from ...field import LanguageField, load_field
from ...field.codes import Track, untracked
from ...field.objects.finding import find_objects
from ...field.registration import register
from ...formats.captures import read_views
from ...formats.langsplat import read_features
from ...formats.scenes import read_gaussians
from ...kernels import SplatArrays, render_channels, splat_arrays
from ...photos.embedding.embed import embed
from ...photos.models.graph import GraphSegmenter
from ...photos.models.mini import MiniEncoder
from ...query import Scene
from ...scene.gaussians import Gaussians
from ...scene.views import View
from ..metrics import mask_iou
from .household import SCENE, Household, unpack_household
from .probes import PROBES, Probe

FIELD, FEATURES = "room.field", "language_features"

MIN_RIGHT_IOU = 0.5  # an answer counts as right above


@dataclass(frozen=True, eq=False)
class Verdict:
    """Answer to a probe, compared with the truth.

    gaussian_ids: of all matches. center: of the best match, in metres, or None. iou: with the truth, in the demo over
    the pixels of all held-out photos; None where nothing is right. scores: lowest and highest of the field.
    """

    probe: Probe
    gaussian_ids: Int64[np.ndarray, " m"]
    num_matches: int
    iou: float | None
    center: Float64[np.ndarray, " 3"] | None
    scores: tuple[float, float]
    seconds: float

    @property
    def found(self) -> bool:
        return self.num_matches > 0

    @property
    def is_right(self) -> bool:
        """True for a match that overlaps the truth by more than MIN_RIGHT_IOU, or for rightly no match."""
        return not self.found if self.iou is None else self.iou > MIN_RIGHT_IOU


@dataclass(frozen=True, eq=False)
class Story:
    """Result of the demo. views: those registered. held_out: those in which answers are measured."""

    gaussians: Gaussians
    splats: SplatArrays
    views: list[View]
    held_out: list[View]
    field: LanguageField
    verdicts: list[Verdict]
    seconds: dict[str, float]
    num_masks: int
    num_weights: int


def tell(
    folder: Path,
    probes: Sequence[Probe] = PROBES,
    *,
    overwrite: bool = False,
    anew: bool = True,
    threads: int = 0,
    track: Track = untracked,
) -> Story:
    """Copy the scene to `folder`, mask and embed its photos, register them, ask the probes.

    anew: whether `overwrite` embeds again photos that a stopped demo has embedded.

    Raises: InputError: the folder has something in it and not `overwrite`.
    """
    watch = Stopwatch()
    household = unpack_household(folder, overwrite=overwrite)
    views = read_views(folder)
    used = [view for view in views if view.name not in household.held_out]
    held_out = [view for view in views if view.name in household.held_out]
    gaussians = read_gaussians(folder / SCENE)
    watch.lap("read")
    embed(used, folder / FEATURES, GraphSegmenter(), MiniEncoder(), overwrite=overwrite and anew, track=track)
    watch.lap("mask and embed")
    features = read_features(folder / FEATURES, level="large", encoder=MiniEncoder().identity)
    registration = register(gaussians, used, features, threads=threads, track=track)
    watch.lap("register")
    field = registration.to_field(threads=threads, track=track)
    watch.lap("field")
    field = field.with_objects(find_objects(field, gaussians, threads=threads))
    field.save(folder / FIELD, overwrite=overwrite)
    field, splats = load_field(folder / FIELD), splat_arrays(gaussians)
    watch.lap("objects")
    judge = _Judge(Scene(field, gaussians, threads=threads), splats, household, held_out)
    verdicts = judge.verdicts([judge.verdict_of(probe) for probe in track(probes, "asking")])
    watch.lap("query")
    size = len(registration.embeddings), int(registration.weights.nnz)
    return Story(gaussians, splats, used, held_out, field, verdicts, watch.seconds, *size)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Judge of answers, by the held-out photos."""

    scene: Scene
    splats: SplatArrays
    household: Household
    held_out: list[View]

    def verdict_of(self, probe: Probe) -> Verdict:
        """Ask the scene; the answer is not yet compared with the truth."""
        start = time.perf_counter()
        answer = self.scene.ask(probe.text)
        matches = self.scene.locate(answer)
        ids = np.sort(np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)]))
        seconds = time.perf_counter() - start
        limits = float(answer.scores.min(initial=1)), float(answer.scores.max(initial=-1))
        center = matches[0].center if matches else None
        return Verdict(probe, ids, len(matches), None, center, limits, seconds)

    def verdicts(self, answers: Sequence[Verdict]) -> list[Verdict]:
        """Compare answers with the truth, all of them in one rendering of each held-out photo.

        The IoU is of the visible parts of the Gaussians and of the objects, over all these photos.
        """
        chosen = np.zeros((len(self.scene.gaussians), len(answers)), np.float32)
        for column, verdict in enumerate(answers):
            chosen[verdict.gaussian_ids, column] = 1
        seen = [self._visible(view, chosen) for view in self.held_out]
        return [
            replace(
                verdict, iou=mask_iou(np.concatenate([v[..., column] for v in seen]), self._true(verdict.probe.meant))
            )
            if verdict.probe.meant
            else verdict
            for column, verdict in enumerate(answers)
        ]

    def _visible(self, view: View, chosen: Float32[np.ndarray, "n a"]) -> Bool[np.ndarray, "h w a"]:
        """Return where each answer's Gaussians have more than half of the weight."""
        drawn = render_channels(self.splats, view, chosen, threads=self.scene.threads)
        return np.asarray(drawn.channels > 0.5)

    def _true(self, meant: tuple[str, ...]) -> Bool[np.ndarray, "h w"]:
        """Return where the held-out photos show these categories."""
        return np.concatenate([self.household.mask(view.name, meant) for view in self.held_out])
