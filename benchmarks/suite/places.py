"""Places whose things are known: made rooms, and real captures in which things were outlined or labelled.

A place knows what its Gaussians belong to and which masks the photos have, and nothing of words: `trials` gives these.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int32
from PIL import Image
from scipy import ndimage
from scipy.cluster.vq import kmeans2
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from drsplat import Gaussians, View, ViewFeatures, load_image, read_gaussians, read_views, register
from drsplat.base.arrays import Doubles, Mask, MaskIds, OtherEmbeddings
from drsplat.field.evidence.evidence import Evidence, evidence_from_tensors
from drsplat.formats.tensors import hash_file, read_tensors, write_tensors
from drsplat.kernels import render_channels, splat_arrays
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.masks.masks import LEVELS
from drsplat.scene.masks.selection import mask_maps

from .masks import MASKS
from .outlines import inside, outlined_in_part, read_outlines
from .scenes import BenchScene, read_scene

SIDE = 504  # pixels of the longer side of a capture's photos
CELLS = 12  # in which what nobody outlined is masked, for want of its true things
MAJORITY = 0.5  # of a Gaussian's weight in the photos that are outlined
OFF = 3  # pixels that borders of simulated masks are off, at most
SEEN = 0.5  # opacity of a pixel that shows something
NEAREST = 8
UNKNOWN = -1


Ids = Callable[[View], MaskIds]


@dataclass(frozen=True, eq=False)
class Place:
    """evidence: of masks of no meaning, a row per Gaussian of the scene. owners: the thing that most of each mask
    shows. labels: the thing of each Gaussian, mass: its weight in photos whose truth is known, 0 where it is not.
    things: by name. nameless: cells of the rest of a capture. cameras: of all photos. views: whose truth is known, as
    their photos are stored. shown: what each pixel of one of these shows, -1 for nothing and numbers beyond those of
    `things` for the rest. inputs: name of the kept file, which says what the place was registered from.
    """

    name: str
    gaussians: Gaussians
    evidence: Evidence
    owners: Int32[np.ndarray, " m"]
    labels: Int32[np.ndarray, " n"]
    mass: Doubles
    things: Mapping[str, list[int]]
    nameless: list[int]
    cameras: list[View]
    views: list[View]
    shown: Ids
    inputs: str

    def evidence_of(self, embeddings: OtherEmbeddings) -> Evidence:
        """Return the evidence of the place's photos with embeddings that were drawn for the masks of all."""
        return replace(self.evidence, embeddings=embeddings)


def room(folder: Path, kind: str, kept: Path) -> Place:
    """One of world/scenes. kind: of MASKS."""
    scene = read_scene(folder)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    things: dict[str, list[int]] = defaultdict(list)
    for thing in (*truth["objects"], *truth["structures"]):
        things[thing["name"]].append(thing["id"])
    path = _kept(kept, folder, kind, scene.gaussians)
    if not path.is_file():
        _write(path, *_registered(scene.gaussians, scene.views, _masks_of(scene, kind), scene.ids), *true_things(scene))
    evidence, owners, labels, mass = _read(path)
    return Place(
        f"{folder.name}, {kind}", scene.gaussians, evidence, owners, labels, mass, things, [], scene.views,
        scene.views, scene.ids, path.name,
    )  # fmt: skip


def capture(folder: Path, scene: Path, outlines: Path | None, kind: str, kept: Path) -> Place:
    """A real capture with its trained scene. outlines: drawn by hand; None: the capture has labels of its own.

    kind: "graph", or "sam" for masks of whole things as a good segmenter makes them, their borders off by some pixels.
    """
    gaussians = read_gaussians(scene)
    photos = read_views(folder)
    views = [replace(view, distortion=None).limited(SIDE) for view in photos]
    names, known = _outlined(folder, outlines) if outlines else _labelled(folder)
    path = _kept(kept, folder, kind, gaussians, outlines)
    if not path.is_file():
        labels, mass = _lifted(gaussians, [view for view in views if view.name in known], known, len(names))
        ids = drawn_ids(gaussians, _with_cells(gaussians, labels, len(names)))
        maps = _found(folder) if kind == "graph" else _simulated(ids)
        _write(path, *_registered(gaussians, views, maps, ids), labels, mass)
    evidence, owners, labels, mass = _read(path)
    things = {name: [number] for number, name in enumerate(names)}
    cells = list(range(len(names), len(names) + CELLS))
    stored = [view for view in photos if view.name in known]
    return Place(
        f"{folder.name}, {kind}", gaussians, evidence, owners, labels, mass, things, cells, views, stored,
        lambda view: known[view.name], path.name,
    )  # fmt: skip


def _kept(kept: Path, folder: Path, kind: str, gaussians: Gaussians, outlines: Path | None = None) -> Path:
    """Return the file of a registered place, named after its inputs: other photos, truth or masks are another file.

    The code that registers is not part of the name. Whoever changes it starts with an empty folder.
    """
    numbers = (SIDE, CELLS, MAJORITY, OFF, SEEN, NEAREST)
    segmenter = sorted(GraphSegmenter().identity.items()) if kind == "graph" else None
    digest = hashlib.blake2b(f"{gaussians.fingerprint} {segmenter} {numbers}".encode(), digest_size=6)
    files = [path for path in folder.rglob("*") if path.is_file()] + ([outlines] if outlines else [])
    for file in sorted(files):
        digest.update(f"{file.name} {hash_file(file)}".encode())
    return kept / f"{folder.name}.{kind}.{digest.hexdigest()}.place.safetensors"


def with_wrong_masks(evidence: Evidence, percent: int) -> Evidence:
    """The weights of some masks, drawn at random, are given to other masks of their photos."""
    views, rng = evidence.masks.views, np.random.default_rng(0)
    target = np.arange(len(views))
    for mask in np.flatnonzero(rng.random(len(views)) < percent / 100):
        others = np.flatnonzero(views == views[mask])
        target[mask] = rng.choice(others[others != mask]) if len(others) > 1 else mask
    moved = csr_array((np.ones(len(views), np.float32), (np.arange(len(views)), target)), shape=(len(views),) * 2)
    weights = csr_array(evidence.weights @ moved)
    weights.sort_indices()
    return replace(evidence, weights=weights)


def _masks_of(scene: BenchScene, kind: str) -> Ids:
    def maps(view: View) -> np.ndarray:
        return mask_maps(MASKS[kind](scene, view, load_image(view))).mask_ids[LEVELS.index("large")]

    return maps


def _registered(gaussians: Gaussians, views: list[View], maps: Ids, ids: Ids) -> tuple[Evidence, np.ndarray]:
    """W of masks of no meaning, and the thing that each shows most of."""
    features, owners = {}, []
    for view in sorted(views, key=lambda view: view.name):
        masks, shown = maps(view), ids(view)
        count = int(masks.max(initial=-1)) + 1
        features[view.name] = ViewFeatures(masks, np.eye(1, 4, dtype=np.float32).repeat(count, 0))
        for number in range(count):
            seen = np.bincount(shown[masks == number] + 1, minlength=1)
            owners.append(int(seen.argmax()) - 1)
    evidence = register(gaussians, views, features).evidence
    assert evidence is not None
    return evidence, np.array(owners, np.int32)


def _votes(gaussians: Gaussians, views: list[View], ids: Ids, count: int) -> Float64[np.ndarray, "n t"]:
    """The weight of each Gaussian in each thing."""
    exact, own = _registered(gaussians, views, lambda view: _compact(ids(view))[0], ids)
    known = np.flatnonzero(own >= 0)
    of_thing = csr_array((np.ones(len(known)), (known, own[known])), shape=(len(own), count))
    return np.asarray((exact.weights @ of_thing).toarray())


def _compact(ids: MaskIds) -> tuple[MaskIds, Int32[np.ndarray, " t"]]:
    """Numbers of what is there, from 0 on, and what they are."""
    there, numbers = np.unique(ids, return_inverse=True)
    return (numbers.reshape(ids.shape) - int(there[0] < 0)).astype(np.int32), there[there >= 0]


def true_things(scene: BenchScene) -> tuple[np.ndarray, np.ndarray]:
    """Per Gaussian the number of its thing, -1 for none, and the weight that photos give it."""
    count = 1 + max(int(scene.ids(view).max()) for view in scene.views)
    votes = _votes(scene.gaussians, scene.views, scene.ids, count)
    return np.where(votes.any(1), votes.argmax(1), UNKNOWN), votes.sum(1)


def _outlined(folder: Path, outlines: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """Names of the things, and per outlined photo what each pixel shows; the rest counts one more.

    What photos show outside of their outlines is not known where some things in sight were not outlined.
    """
    drawn, views = read_outlines(outlines), {view.name: view for view in read_views(folder)}
    in_part = outlined_in_part(outlines)
    names = sorted({thing for things in drawn.values() for thing in things})
    known = {}
    for photo, things in drawn.items():
        rest = UNKNOWN if photo in in_part else len(names)
        ids = np.full((views[photo].height, views[photo].width), rest, np.int32)
        pixels = {thing: inside(views[photo], corners) for thing, corners in things.items()}
        for thing in sorted(pixels, key=lambda thing: -np.count_nonzero(pixels[thing])):  # small ones lie on large ones
            ids[pixels[thing]] = names.index(thing)
        known[photo] = ids
    return names, known


def _labelled(folder: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """The same of a capture that comes with labels of every second photo."""
    values = json.loads((folder / "labels.json").read_text(encoding="utf-8"))
    names = [name for value, name in values.items() if value != "0"]
    number_of = np.full(256, len(names), np.int32)
    number_of[[int(value) for value in values if value != "0"]] = range(len(names))
    labels = {path.stem: number_of[np.asarray(Image.open(path))] for path in (folder / "labels").glob("*.png")}
    return names, {
        view.name: labels[Path(view.name).stem] for view in read_views(folder) if Path(view.name).stem in labels
    }


def _lifted(
    gaussians: Gaussians, views: list[View], known: Mapping[str, np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The thing that has most of a Gaussian's weight in the photos that are known; `count` for the rest."""

    def shown(view: View) -> np.ndarray:
        picture = Image.fromarray(known[view.name]).resize((view.width, view.height), Image.Resampling.NEAREST)
        return np.asarray(picture, np.int32)

    votes = _votes(gaussians, views, shown, count + 1)
    mass = votes.sum(1)
    clear = votes.max(1) > MAJORITY * mass
    return np.where(clear, votes.argmax(1), UNKNOWN).astype(np.int32), np.where(clear, mass, 0)


def _with_cells(gaussians: Gaussians, labels: np.ndarray, count: int) -> Int32[np.ndarray, " n"]:
    """A label for all: that of most of the nearest known ones; the rest of the room in cells."""
    places = gaussians.means.astype(np.float64)
    known, unknown = np.flatnonzero(labels != UNKNOWN), np.flatnonzero(labels == UNKNOWN)
    everywhere = labels.copy()
    near = labels[known][cKDTree(places[known]).query(places[unknown], NEAREST)[1]]
    everywhere[unknown] = (near[:, :, None] == np.arange(count + 1)).sum(1).argmax(1)
    (rest,) = np.nonzero(everywhere == count)
    low, high = np.quantile(places[rest], (0.02, 0.98), axis=0)
    _, cells = kmeans2(np.clip(places[rest], low, high), CELLS, minit="++", seed=0)
    everywhere[rest] = count + cells
    return everywhere


def drawn_ids(gaussians: Gaussians, labels: Int32[np.ndarray, " n"]) -> Ids:
    """What each pixel shows most of."""
    splats, one_hot = splat_arrays(gaussians), np.eye(int(labels.max()) + 1, dtype=np.float32)[labels]

    def ids(view: View) -> np.ndarray:
        shares = render_channels(splats, view, one_hot).channels
        return np.where(shares.sum(-1) > SEEN, shares.argmax(-1), UNKNOWN).astype(np.int32)

    return ids


def _simulated(ids: Ids) -> Ids:
    """A mask for each thing in a photo, its border up to OFF pixels off, small ones over large ones."""

    def maps(view: View) -> np.ndarray:
        shown, rng = ids(view), np.random.default_rng(sum(view.name.encode()))
        masks = [_moved(shown == thing, int(rng.integers(-OFF, OFF + 1))) for thing in np.unique(shown[shown >= 0])]
        result = np.full(shown.shape, -1, np.int32)
        for mask in sorted(masks, key=lambda mask: -np.count_nonzero(mask)):
            if mask.any():
                result[mask] = result.max() + 1
        return _compact(result)[0]

    return maps


def _moved(mask: Mask, pixels: int) -> Mask:
    """Grown or, below 0, shrunk."""
    if not pixels:
        return mask
    change = ndimage.binary_dilation if pixels > 0 else ndimage.binary_erosion
    return np.asarray(change(mask, iterations=abs(pixels)))


def _found(folder: Path) -> Ids:
    """Masks of the built-in segmenter, in the photo of the size that it is looked at in."""
    full = {view.name: view for view in read_views(folder)}
    segmenter = GraphSegmenter()

    def maps(view: View) -> np.ndarray:
        photo = Image.fromarray(load_image(full[view.name])).resize((view.width, view.height), Image.Resampling.LANCZOS)
        return mask_maps(segmenter.segment(np.asarray(photo))).mask_ids[LEVELS.index("large")]

    return maps


def _write(path: Path, evidence: Evidence, owners: np.ndarray, labels: np.ndarray, mass: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    known = {"owners": owners, "labels": labels.astype(np.int32), "mass": mass.astype(np.float64)}
    write_tensors(path, evidence.tensors() | known, evidence.metadata())


def _read(path: Path) -> Iterator[object]:
    tensors, metadata = read_tensors(path)
    owners, labels, mass = (tensors.pop(name) for name in ("owners", "labels", "mass"))
    return evidence_from_tensors(tensors, metadata, str(path)), owners, labels, mass
