"""Run of a protocol: from labelled data and methods to predictions, numbers, pictures and a report."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from ..base.arrays import Pixels, Vectors
from ..base.contents import AnyPath, Document
from ..drawing.heat import heat_colors
from ..drawing.pictures import as_pixels, best_views, highlighted, photo_or_rendering, visible_share
from ..errors import InputError
from ..field.codes import Track, untracked
from ..formats.captures import read_views
from ..formats.peer_features import Rows
from ..formats.tensors import hash_file
from ..kernels import SplatArrays, render_channels, splat_arrays
from ..query import Scene
from ..query.thresholds import CUT_SHARE, default_threshold
from ..scene.encoders import Encoder
from ..scene.gaussians import Gaussians
from ..scene.views import View
from . import lerf_ovs, scannet_points, scannet_volume, voxel
from .lerf_ovs import LerfScene
from .predictions import AUTOMATIC, Chooser
from .report import RESULTS, Figure, write_report
from .scannet import LabelSet, ScannetScene, label_set, read_nyu40_scene, read_raw_category_scene
from .scorers import Scorer, Scores, cosine_scorer, feature_scorer, relevant
from .tables import pictures_judged

LONG_SIDE_PIXELS = 480
SELECTED, OTHERS = (1.0, 0.85, 0.1), (0.1, 0.2, 0.65)  # Fig. S7: yellow, blue


def lerf_figures(
    scene: LerfScene, gaussians: Gaussians, scorer: Scorer, most: int = 6, *, threads: int = 0
) -> list[Figure]:
    """Draw photo, activation and selection of up to `most` pairs of photo and category, spread over the scene."""
    pairs = scene.pairs
    spread = np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).astype(int))
    splats, figures = splat_arrays(gaussians), []
    for at in spread.tolist():
        frame, category = pairs[at]
        view = small(scene.views[frame.name])
        scores = scorer.scores(category)
        photo = photo_or_rendering(gaussians, view, threads=threads)
        truth = np.asarray(Image.fromarray(frame.mask(category)).resize(view.size), np.float32)
        where = f"{scene.name}, {frame.name}, “{category}”"
        figures.append(Figure(f"{where}: the label", highlighted(photo, truth)))
        figures += _answers(splats, view, scores, scorer.threshold, where, threads)
    return figures


def scannet_figures(
    scene: ScannetScene, views: Sequence[View], scorer: Scorer, most: int = 6, *, threads: int = 0
) -> list[Figure]:
    """Draw photo with labelled Gaussians, activation and selection of up to `most` classes of the scene.

    Each class is drawn from the view that shows most of it.
    """
    present = np.unique(scene.pseudo_labels[scene.pseudo_labels > 0])
    chosen = present[np.unique(np.linspace(0, len(present) - 1, min(most, len(present))).astype(int))]
    members = [np.flatnonzero(scene.pseudo_labels == number) for number in chosen.tolist()]
    splats, figures = splat_arrays(scene.gaussians), []
    for number, ids, view in zip(
        chosen.tolist(), members, best_views(scene.gaussians, views, members, threads=threads), strict=True
    ):
        at, scores = small(view), scorer.scores(scene.labels.prompts[number - 1])
        photo = photo_or_rendering(scene.gaussians, at, threads=threads)
        share = visible_share(scene.gaussians, at, ids, splats=splats, threads=threads)
        where = f"{scene.name}, {Path(view.name).stem}, “{scene.labels.prompts[number - 1]}”"
        figures.append(Figure(f"{where}: pseudo labels", highlighted(photo, share)))
        figures += _answers(splats, at, scores, scorer.threshold, where, threads)
    return figures


def _answers(
    splats: SplatArrays, view: View, scores: Scores, threshold: float, where: str, threads: int
) -> list[Figure]:
    picture = selection(splats, view, scores, threshold, threads)
    return [
        Figure(f"{where}: scores", activation(splats, view, scores, threads)),
        Figure(f"{where}: above {threshold:g}", picture),
    ]


def small(view: View) -> View:
    """Resize a view to a longer side of at most LONG_SIDE_PIXELS."""
    scale = min(1.0, LONG_SIDE_PIXELS / max(view.size))
    return view.resized(max(1, round(view.width * scale)), max(1, round(view.height * scale)))


def activation(splats: SplatArrays, view: View, scores: Scores, threads: int = 0) -> Pixels:
    """Draw scores from the 50th to the 99.9th percentile as heat."""
    finite = scores[np.isfinite(scores)]
    low, high = np.percentile(finite, (50, 99.9)) if len(finite) else (0.0, 1.0)
    level = (np.nan_to_num(scores, nan=low) - low) / max(high - low, 1e-9)
    return _drawn(splats, view, heat_colors(level.astype(np.float32)), threads)


def selection(splats: SplatArrays, view: View, scores: Scores, threshold: float, threads: int = 0) -> Pixels:
    """Draw Gaussians above the threshold in yellow, the others in blue.  Source: Fig. S7."""
    chosen = (scores > np.float32(threshold))[:, None]
    return _drawn(splats, view, np.where(chosen, SELECTED, OTHERS).astype(np.float32), threads)


def _drawn(splats: SplatArrays, view: View, colors: Vectors, threads: int) -> Pixels:
    return as_pixels(render_channels(splats, view, colors, threads=threads).channels)


PROTOCOLS = ("lerf-ovs", "scannet-points", "scannet-volume", "voxel")
_SCANNET = {"scannet-points": scannet_points, "scannet-volume": scannet_volume, "voxel": voxel}

Judged = Scene | Gaussians | tuple[Gaussians, Rows, Encoder]
Names = Callable[[Sequence[str]], Collection[str]]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Task:
    """Arguments of `evaluate`."""

    data: Path
    report: Path
    labels: LabelSet
    label_table: Path | None
    relevancy: bool
    threshold: float | None
    method: str | None
    automatic: bool
    without: Names | None
    figures: int
    score_only: bool
    threads: int
    track: Track

    @property
    def folder(self) -> Path:
        return self.report / "predictions"

    def scorer(self, judged: Judged) -> Scorer:
        if isinstance(judged, Gaussians):
            raise InputError("there is nothing to judge: expected a scene with a field, or features and an encoder")
        if isinstance(judged, Scene):
            scorer = cosine_scorer(judged.field, judged.encoder, threads=self.threads)
        else:
            scorer = feature_scorer(*judged[1:])
        scorer = relevant(scorer) if self.relevancy else scorer
        threshold = scorer.threshold if self.threshold is None else self.threshold
        return replace(scorer, name=self.method or scorer.name, threshold=threshold)

    def choosers(self, scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
        return automatic_choosers(scorer) if self.automatic else {}


def evaluate(
    protocol: str,
    data: AnyPath,
    judged: Mapping[str, Judged | Callable[[], Judged]],
    report: AnyPath,
    *,
    labels: str | LabelSet = "scannet19",
    label_table: Path | None = None,
    relevancy: bool = False,
    threshold: float | None = None,
    method: str | None = None,
    automatic: bool = False,
    without: Names | None = None,
    voxel_side: float = voxel.VOXEL_SIDE,
    figures: int = 6,
    score_only: bool = False,
    overwrite: bool = False,
    files: Sequence[Path] = (),
    threads: int = 0,
    track: Track = untracked,
) -> Document:
    """Judge fields, or features of other systems, by a protocol of the papers; return the numbers.

    protocol: "lerf-ovs", "scannet-points", "scannet-volume" or "voxel". data: a folder with a folder per scene, of
    lerf-ovs also with label/. judged: by scene folder an opened scene, or Gaussians, features (N, D) with a row for
    each and an encoder of texts; or a function that returns either when it is its turn. report: the folder to write to;
    predictions are written there and scored from there.

    labels, label_table: classes of ScanNet, a name or a file, and for scannet200 the table of categories. relevancy:
    measure it instead of cosines. threshold: the fixed one, None: the encoder's own, else 0.5. method: its name in
    tables. automatic: score with a threshold per query as well. without: returns which of the labelled photos' names to
    leave out. figures: pictures per scene. score_only: predictions exist already; Gaussians are enough to judge then.
    files: further files whose hashes the report states.

    Raises: InputError: no such protocol, files or classes; results exist already and not `overwrite`. FormatError:
    damaged files. MismatchError: inputs that do not belong together.
    """
    report, data = Path(report), Path(data)
    if protocol not in PROTOCOLS:
        raise InputError(f"protocol: expected one of {', '.join(PROTOCOLS)}; got {protocol!r}")
    if (report / RESULTS).exists() and not (overwrite or score_only):
        raise InputError(f"{report} holds results already: pass overwrite=True, or name another folder")
    task = _Task(
        data=data, report=report, labels=label_set(labels) if isinstance(labels, str) else labels,
        label_table=label_table, relevancy=relevancy, threshold=threshold, method=method, automatic=automatic,
        without=without, figures=figures, score_only=score_only, threads=threads, track=track,
    )  # fmt: skip
    pictures: list[Figure] = []
    if protocol == "lerf-ovs":
        result = lerf_ovs.score(list(_lerf_scenes(task, judged, pictures)), task.folder)
        labelled = [file for name in judged for file in sorted((data / "label" / name).glob("*.json"))]
    else:
        scenes = list(_scannet_scenes(task, protocol, judged, pictures))
        options = {"side": voxel_side, "threads": threads} if protocol == "voxel" else {}
        result = _SCANNET[protocol].score(scenes, task.folder, **options)
        labelled = [file for name in judged for file in sorted((data / name).glob("*_vh_clean_2.labels.ply"))]
    result["pictures"] = pictures_judged(result)
    result["files"] = {f"{path.parent.name}/{path.name}": hash_file(path) for path in [*files, *labelled]}
    written = write_report(report, [result], pictures, overwrite=True)
    return {**result, "written": [str(path) for path in written]}


def _loaded(entry: Judged | Callable[[], Judged]) -> tuple[Judged, Gaussians]:
    """Return what is judged, and its Gaussians."""
    judged = entry() if callable(entry) else entry
    if isinstance(judged, Scene):
        return judged, judged.gaussians
    return judged, judged if isinstance(judged, Gaussians) else judged[0]


def _lerf_scenes(
    task: _Task, judged: Mapping[str, Judged | Callable[[], Judged]], pictures: list[Figure]
) -> Iterator[lerf_ovs.LerfScene]:
    for name, entry in judged.items():
        scene = lerf_ovs.read_lerf_scene(task.data, name)
        if task.without is not None:
            left_out = task.without([frame.name for frame in scene.frames])
            scene = replace(scene, frames=tuple(frame for frame in scene.frames if frame.name not in left_out))
        if not task.score_only:
            loaded, gaussians = _loaded(entry)
            scorer = task.scorer(loaded)
            options: Document = {"threads": task.threads, "track": task.track, "choosers": task.choosers(scorer)}
            lerf_ovs.predict(scene, gaussians, scorer, task.folder, **options)
            pictures += lerf_figures(scene, gaussians, scorer, task.figures, threads=task.threads)
        yield scene


def _scannet_scenes(
    task: _Task, protocol: str, judged: Mapping[str, Judged | Callable[[], Judged]], pictures: list[Figure]
) -> Iterator[ScannetScene]:
    for name, entry in judged.items():
        (loaded, gaussians), folder = _loaded(entry), task.data / name
        scene = (
            read_raw_category_scene(folder, task.labels, gaussians, task.label_table)
            if task.labels.name == "scannet200"
            else read_nyu40_scene(folder, task.labels, gaussians)
        )
        if not task.score_only:
            scorer = task.scorer(loaded)
            options = {"choosers": task.choosers(scorer)} if protocol == "scannet-volume" else {}
            _SCANNET[protocol].predict(scene, scorer, task.folder, track=task.track, **options)
            cameras = folder / "transforms_test.json"
            if protocol == "scannet-volume" and cameras.is_file():
                pictures += scannet_figures(scene, read_views(cameras), scorer, task.figures, threads=task.threads)
        yield scene


def automatic_choosers(scorer: Scorer) -> dict[str, tuple[Chooser, str]]:
    """Return, by column, a function from scores to a threshold, and its description.

    Gaussians without a feature do not count; without any feature, nothing is selected.
    """
    least = scorer.least
    how = "from" if least is None else f"the encoder's {least:g} or {CUT_SHARE:g} of the peak of"

    def chosen(scores: Scores) -> float:
        finite = scores[np.isfinite(scores)]
        return default_threshold(finite, least) if len(finite) else float("inf")

    return {AUTOMATIC: (chosen, f"per query, {how} its scores")}
