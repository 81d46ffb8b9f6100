"""Crops of the objects of a place in their best photos, and what real eyes say of them, by what each word is cut at."""

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from drsplat import load_image, read_views
from drsplat.kernels import render_channels
from drsplat.photos.models.mini.lexicon import COLORS

from .everyday import Ground, Word
from .places import SIDE
from .real_eyes import CROPS_OF_PHOTO, Classifier, Sentences, crops
from .trials import LEAST
from .wordnet import WordNet

PHOTOS, HALF = 4, 0.5
BETAS = (1.0, 1.5, 2.0, 3.0)  # how much evidence the crops of a thing are, in means of log probabilities
SHARES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)  # least probability of a word's classes
RATIOS = (1.0, 3.0, 10.0, 30.0)  # least, to the mean of all objects
COSINES = (0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 2.0)  # least, of ConSE; the last refuses all
MARGINS = (0.0, 0.05, 0.1, 0.15)  # least, above the mean of all objects
CUTS = tuple(product(BETAS, SHARES, RATIOS, COSINES, MARGINS))
SECONDS: dict[str, list[float]] = defaultdict(list)


@contextmanager
def timed(step: str, count: float = 1) -> Iterator[None]:
    """Note the CPU seconds of a step, for each of `count`."""
    start = time.process_time()
    yield
    SECONDS[step].append((time.process_time() - start) / max(count, 1e-9))


class Answers(NamedTuple):
    """Of a word, by each of CUTS. ious: 0 where nothing is found."""

    ious: np.ndarray
    is_found: np.ndarray


@dataclass(frozen=True, eq=False)
class Looked:
    """What real eyes saw of the objects of a place, those that photos show well enough.

    numbers: of the objects. rows: of the field, of each. log_probabilities: means over its crops. pictures: one each.
    """

    ground: Ground
    numbers: list[int]
    rows: list[np.ndarray]
    log_probabilities: np.ndarray
    pictures: list[Image.Image]

    def probabilities(self, beta: float) -> np.ndarray:
        """(objects, 1000): independent crops are evidence and not votes, so that logarithms are averaged."""
        shares = np.exp(beta * (self.log_probabilities - self.log_probabilities.max(1, keepdims=True)))
        return np.asarray(shares / shares.sum(1, keepdims=True))

    @cached_property
    def colors(self) -> Mapping[str, np.ndarray]:
        """By colour, the objects of which the built-in encoder finds most."""
        found = {color: self.ground.built_in(f"something {color}")[0] for color in COLORS}
        return {color: np.array([some[rows].mean() > HALF for rows in self.rows]) for color, some in found.items()}

    def answers(self, word: Word, wordnet: WordNet, sentences: Sentences) -> Answers:
        """Answer a noun, or a colour and a noun, of which both have to hold."""
        color, _, rest = word.text.partition(" ")
        is_pair = color in COLORS and bool(rest)
        noun, allowed = (rest, self.colors[color]) if is_pair else (word.text, np.ones(len(self.rows), np.bool_))
        classes, vector = wordnet.classes(noun), sentences.encode([noun])[0]
        parts = []
        for beta in BETAS:
            probabilities = self.probabilities(beta)
            if classes.any():
                fits = probabilities[:, classes].sum(1)
                cuts = [(fits >= least) & (fits >= ratio * fits.mean()) for least, ratio in product(SHARES, RATIOS)]
                parts.append(self._said(word, np.array(cuts) & allowed).repeat(len(COSINES) * len(MARGINS), 1))
            else:
                fits = sentences.cosines(vector, probabilities)
                cuts = [(fits >= least) & (fits - fits.mean() >= more) for least, more in product(COSINES, MARGINS)]
                parts.append(np.tile(self._said(word, np.array(cuts) & allowed), len(SHARES) * len(RATIOS)))
        ious, is_found = np.concatenate(parts, 1)
        return Answers(ious, is_found > 0)

    def _said(self, word: Word, cuts: np.ndarray) -> np.ndarray:
        """(2, cuts): IoU of the objects that each cut leaves, and whether it leaves any."""
        hits = np.array([word.counted[rows][word.meant[rows]].sum() for rows in self.rows])
        totals = np.array([word.counted[rows].sum() for rows in self.rows])
        both = cuts @ hits
        either = cuts @ totals + word.counted[word.meant].sum() - both
        return np.stack([both / np.maximum(either, 1e-9), cuts.any(1)])


def look(ground: Ground, classifier: Classifier, outlines: bool, kept: Path) -> Looked:
    """Look at the listed objects of a place. outlines: at its true things as they are outlined, instead.

    kept: folder in which what was seen is found the next time, by the place's inputs and the field.
    """
    kind = "outlines" if outlines else "objects"
    path = (
        kept
        / f"{ground.place.inputs.removesuffix('.place.safetensors')}.{ground.scene.field.fingerprint[:12]}.{kind}.npz"
    )
    if not path.is_file():
        _write(path, _looked(ground, classifier, outlines))
    with np.load(path) as known:
        rows = np.split(known["rows"], np.cumsum(known["lengths"])[:-1])
        pictures = [Image.fromarray(picture) for picture in known["pictures"]]
        return Looked(ground, known["numbers"].tolist(), rows, known["log_probabilities"], pictures)


def _write(path: Path, looked: Looked) -> None:
    pictures = np.array([np.asarray(picture) for picture in looked.pictures])
    lengths = [len(rows) for rows in looked.rows]
    np.savez(path, numbers=looked.numbers, rows=np.concatenate(looked.rows), lengths=lengths,
             log_probabilities=looked.log_probabilities, pictures=pictures)  # fmt: skip


def _looked(ground: Ground, classifier: Classifier, outlines: bool) -> Looked:
    with timed("masks of a place, and the best photos of its objects"):
        numbers, rows, maps = (_true_things if outlines else _listed_objects)(ground)
        chosen = _best_photos(maps, len(rows))
    cut: list[list[Image.Image]] = [[] for _ in rows]
    views = {view.name: view for view in (read_views(ground.folder) if ground.is_capture else ground.place.views)}
    with timed("100 crops cut", sum(map(len, chosen)) * CROPS_OF_PHOTO / 100):
        for name in sorted({name for some in chosen for name in some}):
            photo = load_image(views[name])
            map_image = Image.fromarray(maps[name].astype(np.int32))
            shown = np.asarray(map_image.resize(photo.shape[1::-1], Image.Resampling.NEAREST))
            for number, some in enumerate(chosen):
                if name in some:
                    cut[number] += crops(photo, shown == number)
    pictures = [picture for some in cut for picture in some]
    with timed("100 crops classified", len(pictures) / 100):
        found = classifier.log_probabilities(pictures)
    parts = np.split(found, np.cumsum([len(some) for some in cut])[:-1])
    seen = [at for at, some in enumerate(cut) if some]
    means = np.array([parts[at].mean(0, dtype=np.float64) for at in seen])
    return Looked(ground, [numbers[at] for at in seen], [rows[at] for at in seen], means, [cut[at][1] for at in seen])


Shown = tuple[list[int], list[np.ndarray], dict[str, np.ndarray]]
"""Numbers of objects, rows of each, and by photo which of them each pixel shows, -1 for none."""


def _listed_objects(ground: Ground) -> Shown:
    scene = ground.scene
    listed = np.flatnonzero(scene.agreed).tolist()
    owner = scene.object_ids()
    channels = np.ascontiguousarray(owner[:, None] == np.array(listed), np.float32)
    maps = {}
    for view in scene.views:
        shares = render_channels(scene.splats, view.limited(SIDE), channels).channels
        maps[view.name] = np.where(shares.max(2) > HALF, shares.argmax(2), -1)
    return listed, [np.flatnonzero(owner[scene.field.gaussian_ids] == number) for number in listed], maps


def _true_things(ground: Ground) -> Shown:
    place = ground.place
    ids = [number for some in place.things.values() for number in some]
    ids = [number for number in ids if np.count_nonzero(ground.labels == number) >= LEAST]
    maps = {}
    for view in place.views:
        shown = place.shown(view)
        maps[view.name] = np.select([shown == number for number in ids], range(len(ids)), -1)
    return ids, [np.flatnonzero(ground.labels == number) for number in ids], maps


def _best_photos(maps: Mapping[str, np.ndarray], count: int) -> list[list[str]]:
    """Return for each object the photos that show most of it; one that cuts it off counts half."""
    names, areas = list(maps), []
    for shown in maps.values():
        border = np.concatenate([shown[0], shown[-1], shown[:, 0], shown[:, -1]])
        whole, cut = (np.bincount(some[some >= 0].ravel(), minlength=count) for some in (shown, border))
        areas.append(np.where(cut > 0, HALF, 1.0) * whole / shown.size)
    order = np.argsort(-np.array(areas), axis=0, kind="stable")[:PHOTOS].T
    return [[names[at] for at in row if areas[at][number] > 0] for number, row in enumerate(order)]
