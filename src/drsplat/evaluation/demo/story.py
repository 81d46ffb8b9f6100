"""Run of the demo through the public interface only: masks, embeddings, registration, field, words.

Its household is packed by `world/packing.py` from a room of the procedural household world that no model here was
trained on.
"""

import json
import shutil
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from ...base.arrays import Int64, Mask, MaskIds, OtherPixels, RowIds, Vector3
from ...base.progress import Stopwatch
from ...base.terminal import counted
from ...drawing.pictures import (
    as_pixels,
    best_views,
    contact_sheet,
    highlighted,
    photo_or_rendering,
    titled,
    visible_share,
    write_picture,
    zoomed,
)
from ...drawing.rendering import render
from ...errors import InputError
from ...field import LanguageField, load_field
from ...field.codes import Track, untracked
from ...field.objects.finding import find_objects
from ...field.registration import register
from ...formats.captures import read_views
from ...formats.langsplat import read_features
from ...formats.replacing import replacing, saying_what_is_full
from ...formats.scenes import read_gaussians
from ...kernels import SplatArrays, render_channels, splat_arrays
from ...photos.embedding.embed import embed
from ...photos.models.graph import GraphSegmenter
from ...photos.models.mini import MiniEncoder
from ...query import Match, Scene
from ...scene.gaussians import Gaussians
from ...scene.views import View
from ..scorers import mask_iou

FIELD, FEATURES = "room.field", "language_features"

MIN_RIGHT_IOU = 0.5  # an answer counts as right above
UNSURE_SHARE = 0.35  # of its colour, that a match keeps in a picture which the answer is not sure of
SCENE = "scene.compressed.ply"
UNFINISHED = "UNFINISHED"  # name of the file that marks a folder of a demo that was stopped


class Probe(NamedTuple):
    """Query in words, and the names of the right objects (categories of `truth.json`); none if there are none."""

    text: str
    meant: tuple[str, ...]


PROBES = (
    Probe("yellow apple", ("yellow apple",)),
    Probe("orange carrot", ("orange carrot",)),
    Probe("green cup", ("green mug",)),
    Probe("toy duck", ("green toy duck",)),
    Probe("green car", ("green toy car",)),
    Probe("red vase", ("red vase",)),
    Probe("blue candle", ("blue candle",)),
    Probe("couch", ("orange sofa",)),
    Probe("houseplant", ("green plant",)),
    Probe("wooden table", ("brown table",)),
    Probe("chair", ("brown chair",)),
    Probe("bookcase", ("red shelf",)),
    Probe("something to eat", ("yellow apple", "orange carrot")),
    Probe("fork", ("grey fork",)),
    Probe("laptop", ()),
    Probe("teddy bear", ()),
)


@dataclass(frozen=True)
class Household:
    """Scene of the demo. categories: by id. held_out: photos that neither training nor registration used."""

    folder: Path
    categories: dict[int, str]
    held_out: tuple[str, ...]

    def ids(self, view_name: str) -> MaskIds:
        """Return what each pixel of a held-out photo shows: an id of `categories`, -1 for none."""
        with Image.open(self.folder / "ids" / f"{Path(view_name).stem}.png") as picture:
            return np.asarray(picture).astype(np.int32) - 1

    def mask(self, ids: MaskIds, meant: Collection[str]) -> Mask:
        """Return which ids are of these categories."""
        return np.isin(ids, [number for number, name in self.categories.items() if name in meant])


@dataclass(frozen=True, eq=False)
class Verdict:
    """Answer to a probe, compared with the truth.

    gaussian_ids: of the matches that are judged, those that the answer is sure of; where it is only maybe, all.
    unsure_ids: of the others. count: matches that are sure. center: of the best match, in metres, or None. iou: of what
    is judged with the truth, in the demo over the pixels of all held-out photos; None where nothing is right. scores:
    lowest and highest of the field.
    """

    probe: Probe
    gaussian_ids: RowIds
    unsure_ids: Int64[np.ndarray, " u"]
    count: int
    num_matches: int
    iou: float | None
    center: Vector3 | None
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
        seconds = time.perf_counter() - start
        sure = [match for match in matches if match.sure]
        judged, others = (sure, [match for match in matches if not match.sure]) if sure else (matches, [])
        limits = float(answer.scores.min(initial=1)), float(answer.scores.max(initial=-1))
        center = matches[0].center if matches else None
        return Verdict(probe, _ids(judged), _ids(others), len(sure), len(matches), None, center, limits, seconds)

    def verdicts(self, answers: Sequence[Verdict]) -> list[Verdict]:
        """Compare answers with the truth, all of them in one rendering of each held-out photo.

        The IoU is of the visible parts of the Gaussians and of the objects, over all these photos.
        """
        chosen = np.zeros((len(self.scene.gaussians), len(answers)), np.float32)
        for column, verdict in enumerate(answers):
            chosen[verdict.gaussian_ids, column] = 1
        drawn = [render_channels(self.splats, view, chosen, threads=self.scene.threads) for view in self.held_out]
        # more than half of the weight; a plane an answer, as it is compared
        seen = np.concatenate([np.moveaxis(one.channels, -1, 0) > 0.5 for one in drawn], axis=1)
        ids, judged = np.concatenate([self.household.ids(view.name) for view in self.held_out]), []
        for verdict, shown in zip(answers, seen, strict=True):
            meant = verdict.probe.meant
            iou = mask_iou(shown, self.household.mask(ids, meant)) if meant else None
            judged.append(replace(verdict, iou=iou))
        return judged


def _ids(matches: Sequence[Match]) -> RowIds:
    return np.sort(np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)]))


def unpack_household(folder: Path, *, overwrite: bool = False) -> Household:
    """Copy the scene's files to `folder`, where a user finds them.

    Raises: InputError: the folder has something in it and not `overwrite`, or cannot be written to; the disk is full.
    """
    refuse_full(folder, overwrite)
    with as_file(files(__package__) / "scene") as shipped:
        for file in sorted(shipped.rglob("*")):
            if file.is_file():
                place = folder / file.relative_to(shipped)
                with saying_what_is_full(place.parent):
                    place.parent.mkdir(parents=True, exist_ok=True)
                with file.open("rb") as source, replacing(place, overwrite=True) as target:
                    shutil.copyfileobj(source, target)
    return read_household(folder)


def refuse_full(folder: Path, overwrite: bool) -> None:
    """Check a folder for output. Raises: InputError: it has something in it and not `overwrite`."""
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder} exists already: choose another folder, or pass overwrite=True to replace it")


@contextmanager
def resumable(folder: Path, overwrite: bool) -> Iterator[None]:
    """Mark a folder as unfinished until the block ends well, so that a stopped demo can be continued in it.

    Raises: InputError: the folder has something in it, that no stopped demo left, and not `overwrite`.
    """
    marker = folder / UNFINISHED
    refuse_full(folder, overwrite or marker.is_file())
    with saying_what_is_full(folder):
        folder.mkdir(parents=True, exist_ok=True)
        marker.write_text("drsplat demo was stopped here; the same command goes on.\n", encoding="utf-8")
    yield
    marker.unlink(missing_ok=True)


def read_household(folder: Path) -> Household:
    """Read the truth of an unpacked scene."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    categories = {thing["id"]: thing["category"] for thing in truth["objects"]}
    return Household(folder, categories, tuple(truth["held_out"]))


OVERVIEW = "overview.png"


def write_album(folder: Path, story: Story, *, overwrite: bool = False) -> list[Path]:
    """Write a PNG per answer to folder/answers, and folder/overview.png; return the paths, the overview first."""
    with saying_what_is_full(folder / "answers"):
        (folder / "answers").mkdir(parents=True, exist_ok=True)
    paths, pictures = [folder / OVERVIEW], []
    selections = [verdict.gaussian_ids for verdict in story.verdicts]
    views = best_views(story.gaussians, story.held_out + story.views, selections)
    for verdict, view in zip(story.verdicts, views, strict=True):
        picture = _answer_picture(story, verdict, view)
        pictures.append(titled(picture, f"“{verdict.probe.text}”", note(verdict)))
        paths.append(folder / "answers" / f"{verdict.probe.text.replace(' ', '_')}.png")
        write_picture(paths[-1], picture, overwrite)
    write_picture(paths[0], _overview(story, pictures), overwrite)
    return paths


def note(verdict: Verdict) -> str:
    """Return the result of a probe, in a few words."""
    if not verdict.found:
        manner = "rightly" if verdict.is_right else "miss:"
        return f"{manner} no match (best score {verdict.scores[1]:.2f})"
    sure = "" if verdict.count == verdict.num_matches else f", {verdict.count} sure"
    count = counted(verdict.num_matches, "match", "matches") + sure
    if verdict.iou is None:
        return f"wrong: {count}, but there is none"
    return f"{'' if verdict.is_right else 'miss: '}{count}, IoU {verdict.iou:.2f}"


def _answer_picture(story: Story, verdict: Verdict, view: View) -> OtherPixels:
    """Draw the Gaussians of an answer from the view that shows most of them, with a lens that suits their size.

    What the answer is not sure of is pale.
    """
    view = view if verdict.found else story.held_out[0]
    view = zoomed(view, visible_share(story.gaussians, view, verdict.gaussian_ids, splats=story.splats))
    chosen = np.zeros((len(story.gaussians), 1), np.float32)
    chosen[verdict.gaussian_ids], chosen[verdict.unsure_ids] = 1, UNSURE_SHARE
    drawn = render(story.gaussians, view, values=chosen, splats=story.splats)
    return highlighted(as_pixels(drawn.rgb), drawn.channels[..., 0])


def _overview(story: Story, pictures: list[OtherPixels]) -> OtherPixels:
    """Put two photos of the room above the answers in rows of four."""
    sheet = contact_sheet(pictures, columns=4)
    views = [story.held_out[0], story.held_out[-1]]
    photos = [Image.fromarray(photo_or_rendering(story.gaussians, view)) for view in views]
    width = (sheet.shape[1] - 42) // 2
    height = width * photos[0].height // photos[0].width
    frame = Image.new("RGB", (sheet.shape[1], height + 14), "white")
    for number, photo in enumerate(photos):
        frame.paste(photo.resize((width, height)), (14 + number * (width + 14), 14))
    return np.concatenate([np.asarray(frame), sheet])
