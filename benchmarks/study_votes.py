"""What the votes of photos are worth: lists, clicks and answers before and after pieces are joined that photos outline.

    python benchmarks/study_votes.py ROOM... CAPTURE=SCENE... --kept FOLDER [--masks whole] [--clip FOLDER]
        [--pictures FOLDER]

ROOM: one of world/scenes. CAPTURE: a real capture with outlines (`tests/support/*_outlines.json`) or labels, and the
scene that was trained on it. --masks whole: true masks of rooms, and simulated ones of whole things for captures,
without features; else masks and features are the built-in ones.

P: share of the listed objects that are a thing (IoU above 0.5, each thing once); of captures only few things are
outlined, so that P of two rows may be compared, and says little by itself. R: share of the things that are listed.
IoU: mean over things of that with the best object, listed or not. Click: mean over things of the IoU in other photos of
what a click into the middle of the thing finds, in up to CLICKED photos. Select: mean IoU of words by genuine vectors,
--clip as in `study_answers.py`, a fifth of the masks showing something else. FOLDER keeps what is registered; pictures
show the joined things, their pieces in colours.
"""

import argparse
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe as describe_machine
from benchmarks.suite import trials
from benchmarks.suite.answers import MASKS, answered, kind_of, place_of
from benchmarks.suite.outlines import iou
from benchmarks.suite.outlines import middle as middle_of
from benchmarks.suite.places import SIDE, Place
from benchmarks.suite.trials import Means
from benchmarks.suite.vocabularies import KINDS, Clip
from drsplat import EncoderIdentity, LanguageField, MiniEncoder, Query, Scene, View, load_image, read_views
from drsplat.base.system import peak_memory_bytes
from drsplat.drawing.pictures import contact_sheet, visible_share, write_picture
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.forest import THING, owner_nodes
from drsplat.field.objects.agreed import agreed
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import MIN_SHOWN_SHARE, describe, node_weights
from drsplat.field.objects.finding import find_tree
from drsplat.field.objects.voting import Vote, with_voted
from drsplat.kernels import render_channels, splat_arrays
from drsplat.photos.embedding.keeping import mask_rows
from drsplat.photos.embedding.voting import _Electorate
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.masks.selection import mask_maps

LEVEL = 0.5  # of IoU, from which on an object is a thing
VOTES_HEAD = "| today/voted | P | R | listed | IoU | click | select |\n|---|--:|--:|--:|--:|--:|--:|"
CLICKED, MIN_PIXELS = 4, 100  # photos of a thing that are clicked into; pixels that show it there
WRONG = 0.2  # of the masks, which show something else than their thing
VOID = 0.5  # of an object's Gaussians: with fewer in known photos it counts neither way
COLORS = np.random.default_rng(7).integers(40, 256, (64, 3))


class Found(NamedTuple):
    precision: float
    recall: float
    listed: int
    best: float


class Listing(NamedTuple):
    """ids: Gaussians of each object. listed: those that people are shown."""

    ids: list[np.ndarray]
    listed: np.ndarray


class Rows:
    """As much of a field as photos need to vote. ids: ascending Gaussians of its rows."""

    aggregator = SimpleNamespace(sampling=None)

    def __init__(self, ids: np.ndarray, evidence: Evidence, scene: str) -> None:
        self.ids, self.evidence, self.scene = ids, evidence, scene

    def __len__(self) -> int:
        return len(self.ids)

    def rows_of(self, some: np.ndarray) -> np.ndarray:
        rows = np.minimum(np.searchsorted(self.ids, some), len(self.ids) - 1)
        return np.where(self.ids[rows] == some, rows, -1)


def listing(tree: Tree, evidence: Evidence, ids: np.ndarray) -> Listing:
    things = np.flatnonzero(tree.levels == THING)
    owner = np.append(owner_nodes(tree.parents, tree.levels == THING), -1)[tree.node_of]
    weights, views = node_weights(evidence, tree)[things], evidence.masks.views
    shown = np.stack([weights[:, views == view].sum(axis=1) for view in range(len(evidence.masks.view_names))], 1)
    photos = (shown > MIN_SHOWN_SHARE * shown.max(1, keepdims=True)).sum(1)
    return Listing([ids[owner == thing] for thing in things], agreed(tree.sure[things], photos))


def compared(place: Place, found: Listing) -> Found:
    """By the weight of Gaussians in the photos whose truth is known."""
    known = (place.labels >= 0) & (place.mass > 0)
    mass, numbers = place.mass * known, sorted(number for some in place.things.values() for number in some)
    sizes = np.bincount(place.labels[known], mass[known], minlength=max(numbers) + 1)[numbers]
    ious = np.zeros((len(found.ids), len(numbers)))
    void = np.zeros(len(found.ids), bool)
    for number, ids in enumerate(found.ids):
        own = ids[known[ids]]
        void[number] = len(own) < VOID * len(ids)
        shared = np.bincount(place.labels[own], mass[own], minlength=max(numbers) + 1)[numbers]
        ious[number] = shared / np.maximum(mass[ids].sum() + sizes - shared, 1e-9)
    counted = found.listed & ~void
    right = len(set(ious[counted].argmax(1)[ious[counted].max(1) >= LEVEL]))
    return Found(right / max(counted.sum(), 1), right / len(numbers), int(found.listed.sum()), ious.max(0).mean())


def features_of(place: Place, folder: Path, kept: Path) -> np.ndarray:
    """Embeddings by the built-in encoder of the masks that a place was registered with."""
    path = kept / f"{place.inputs}.features.npy"
    if path.exists():
        return np.load(path)
    photos, encoder, rows = {view.name: view for view in read_views(folder)}, MiniEncoder(), []
    for number, name in enumerate(place.evidence.masks.view_names):
        (view,) = (view for view in place.cameras if view.name == name)
        photo = Image.fromarray(load_image(photos[name]))
        photo = photo.resize((view.width, view.height), Image.Resampling.LANCZOS) if photo.size != view.size else photo
        masks = mask_maps(GraphSegmenter().segment(np.asarray(photo))).masks
        own = mask_rows(np.asarray(photo), masks, encoder)
        rows.append(own[: np.count_nonzero(place.evidence.masks.views == number)])
    np.save(path, np.concatenate(rows))
    return np.concatenate(rows)


class Study(NamedTuple):
    """A place with its photos' votes. evidence: of `ids`, with features where there are any."""

    place: Place
    ids: np.ndarray
    evidence: Evidence
    votes: list[Vote]

    @classmethod
    def of(cls, place: Place, folder: Path, kept: Path, features: bool) -> "Study":
        ids = np.flatnonzero(np.diff(place.evidence.weights.indptr))
        plain = place.evidence.rows(ids)
        by_name = {view.name: view for view in read_views(folder)}
        own = replace(plain, embeddings=features_of(place, folder, kept)) if features else plain
        given = [by_name[name] for name in plain.masks.view_names]
        rows = Rows(ids, plain, place.gaussians.fingerprint)
        electorate = _Electorate(rows, place.gaussians, kept / f"{folder.name}.votes", 0)
        electorate.look(given, lambda some, _: some)
        return cls(place, ids, own, list(electorate.votes()))

    def tree(self, evidence: Evidence) -> Tree:
        return find_tree(evidence, self.place.gaussians, self.ids.astype(np.uint32), self.place.cameras)

    def found(self, tree: Tree) -> Found:
        return compared(self.place, listing(tree, self.evidence, self.ids))

    def field(self, evidence: Evidence, tree: Tree) -> LanguageField:
        """A field with these objects, its features without meaning."""
        gaussians, rows = self.place.gaussians, Means(np.ones((len(self.ids), evidence.dim), np.float32))
        identity = EncoderIdentity("none", evidence.dim)
        field = LanguageField(
            self.ids.astype(np.uint32), rows, identity, gaussians.fingerprint, len(gaussians), evidence
        )
        return replace(field, objects=describe(field, gaussians, tree))

    def clicks(self, tree: Tree) -> float:
        place = self.place
        views = [replace(view, distortion=None).limited(SIDE) for view in place.views]
        scene, splats = Scene(self.field(self.evidence, tree), place.gaussians, views), splat_arrays(place.gaussians)
        shown = {view.name: resized(place.shown(stored), view) for stored, view in zip(place.views, views, strict=True)}

        @cache
        def drawn(ids: bytes, name: str) -> np.ndarray:
            some = np.frombuffer(ids, np.int64)
            return visible_share(place.gaussians, scene.view(name), some, splats=splats) > 0.5

        means = []
        for number in sorted(number for some in place.things.values() for number in some):
            photos = [name for name, ids in shown.items() if np.count_nonzero(ids == number) >= MIN_PIXELS]
            photos = [photos[at * len(photos) // CLICKED] for at in range(CLICKED)] if len(photos) > CLICKED else photos
            fits = []
            for photo in photos:
                click = (photo, *middle_of(shown[photo] == number))
                ids = scene.ask(Query(click=click)).gaussian_ids.astype(np.int64).tobytes()
                fits += [iou(drawn(ids, other), shown[other] == number) for other in photos if other != photo]
            means += [np.mean(fits)] if fits else []
        return float(np.mean(means))

    def selected(self, words: Clip, votes: list[Vote] | None) -> float:
        """Mean IoU of words that something is called by."""

        def field_of(place: Place, identity: EncoderIdentity) -> LanguageField:
            field = trials.field_of(place, identity)
            if votes is None or field.evidence is None:
                return field
            tree = with_voted(self.tree(field.evidence), lambda: votes)
            return replace(field, objects=describe(field, place.gaussians, tree))

        cases = [trials.trial(self.place, words, kind, WRONG, 0, field_of) for kind in KINDS]
        return float(np.mean([one.objects for case in cases for one in answered(case)]))


def resized(ids: np.ndarray, view: View) -> np.ndarray:
    return np.asarray(Image.fromarray(ids.astype(np.int32)).resize(view.size, Image.Resampling.NEAREST))


def said_of(found: Found) -> tuple[str, ...]:
    return f"{found.precision:.2f}", f"{found.recall:.2f}", str(found.listed), f"{found.best:.3f}"


def side_by_side(study: Study, words: Clip | None, pictures: Path | None) -> tuple[str, ...]:
    """Today's objects and voted ones, with a slash between them: list, best object, click, select."""
    trees = [study.tree(study.evidence)]
    trees.append(with_voted(trees[0], lambda: study.votes))
    if pictures:
        draw(study.place, study.ids, *trees, pictures / f"{study.place.name.replace(', ', '_')}.jpg")
    columns = list(zip(*(said_of(study.found(tree)) for tree in trees), strict=True))
    columns.append(tuple(f"{study.clicks(tree):.3f}" for tree in trees))
    selected = [f"{study.selected(words, votes):.3f}" for votes in (None, study.votes)] if words else ["-"]
    return study.place.name, *map("/".join, [*columns, selected])


def draw(place: Place, ids: np.ndarray, before: Tree, after: Tree, path: Path) -> None:
    """Each joined thing in the photo that shows most of it, its pieces in colours."""
    number = np.append(owner_nodes(before.parents, before.levels == THING), -1)[before.node_of]
    whole = np.append(owner_nodes(after.parents, after.levels == THING), -1)[after.node_of]
    joined = [thing for thing in np.unique(whole[whole >= 0]) if len(np.unique(number[whole == thing])) > 1]
    splats, tiles = splat_arrays(place.gaussians), []
    for thing in joined:
        pieces = np.zeros(len(place.gaussians), np.int32)
        _, pieces[ids[whole == thing]] = np.unique(number[whole == thing], return_inverse=True)
        pieces[ids[whole == thing]] += 1
        colors = np.where(pieces[:, None] > 0, COLORS[pieces % len(COLORS)] / 255, 0.15).astype(np.float32)
        values = np.concatenate([colors, (pieces > 0)[:, None]], 1).astype(np.float32)
        shown = [render_channels(splats, replace(view, distortion=None), values) for view in place.cameras]
        best = max(shown, key=lambda one: float(one.channels[..., 3].sum()))
        tiles.append(np.uint8(255 * np.clip(best.channels[..., :3], 0, 1)))
    if tiles:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_picture(path, contact_sheet(tiles, 4), overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+", metavar="ROOM or CAPTURE=SCENE")
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--masks", choices=("graph", "whole"), default="graph")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--clip", type=Path)
    arguments = parser.parse_args()
    print(describe_machine())
    words = Clip(arguments.clip) if arguments.clip else None
    print(VOTES_HEAD)
    for given in arguments.places:
        kind = MASKS[kind_of(given)][arguments.masks == "whole"]
        place = place_of(given, kind, arguments.kept)
        path = Path(given.partition("=")[0]).resolve()
        study = Study.of(place, path, arguments.kept, arguments.masks == "graph")
        print(f"| {' | '.join(side_by_side(study, words, arguments.pictures))} |", flush=True)
    print(f"\npeak memory {peak_memory_bytes() / 2**20:.0f} MiB")


if __name__ == "__main__":
    main()
