"""How well objects are the things of a room, whatever they are called, against other rules on the same masks.

    python benchmarks/study_objects.py world/scenes/room_5 ... [--masks graph true] [--wrong 0 20 40] [--kept FOLDER]

True things are the objects of truth.json that most of 60 Gaussians or more belong to, by their weights in true masks;
structures and Gaussians that no photo shows are void. Scores are of each room, then means over rooms with intervals.
--wrong: of so many percent of the masks, all weights go to another mask of the photo, drawn at random.
--kept: where the weights and the truth of rooms are kept (minutes a room), and found the next time.

Rules: connected components of what the category of each true thing selects in the field without objects (who asks knows
what is there, and a place's score is its confidence); MaskClustering's; LightSplat's; ours. The confidence of all three
is how well single masks fit a region.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.instances import LEAST, Compared, Region, compare, numbers
from benchmarks.suite.masks import MASKS, features_of
from benchmarks.suite.places import with_wrong_masks
from benchmarks.suite.rivals.things import Agreement, Alike, light_splat, mask_clustering, sureness
from benchmarks.suite.scenes import owners, read_scene
from drsplat import Gaussians, LanguageField, MiniEncoder, Scene, View, read_gaussians, read_views, register
from drsplat.evaluation import scorers
from drsplat.field.codes.code import Code
from drsplat.field.evidence.evidence import Evidence, evidence_from_tensors
from drsplat.field.forest import THING, owner_nodes
from drsplat.field.objects.borders import some_views
from drsplat.field.objects.choosing import Tree, choose
from drsplat.field.objects.finding import MIN_GAUSSIANS, grow, of_pieces
from drsplat.formats.tensors import read_tensors, write_tensors

MINI = MiniEncoder()
OURS = "objects"
BANDS = (LEAST, 200, 1000, np.inf)
# best of --choose (at 4a01ca08) on four training rooms, both kinds of masks, none wrong
AGREEMENT = Agreement(gamma=0.8)
ALIKE = Alike(iou=0.3, cosine=0.7, smallest=10)


@dataclass(frozen=True, eq=False)
class Room:
    """ids: Gaussians with evidence, the rows of it. owners: per Gaussian of the scene. categories: of true things."""

    gaussians: Gaussians
    ids: np.ndarray
    evidence: Evidence
    owners: np.ndarray
    categories: dict[int, str]
    views: list[View] = field(default_factory=list)

    @property
    def things(self) -> list[int]:
        return list(self.categories)

    @property
    def texts(self) -> list[str]:
        """Of those that are large enough."""
        large = (thing for thing in self.things if (self.owners == thing).sum() >= LEAST)
        return sorted({self.categories[thing] for thing in large})

    def compared(self, regions: list[Region]) -> Compared:
        return compare(regions, self.owners, self.things)


def room_of(folder: Path, masks: str, kept: Path) -> Room:
    path = kept / f"{folder.name}.{masks}.safetensors"
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    gaussians = read_gaussians(next(folder.glob("scene.*")))
    if not path.is_file():
        kept.mkdir(parents=True, exist_ok=True)
        scene = read_scene(folder)
        made = register(scene.gaussians, scene.views, features_of(scene, masks, MINI)).evidence
        count = len(truth["objects"]) + len(truth["structures"])
        whose = owners(folder, gaussians, read_views(folder), count)
        write_tensors(path, made.tensors() | {"owners": whose}, made.metadata())
    tensors, metadata = read_tensors(path)
    whose = tensors.pop("owners")
    evidence = evidence_from_tensors(tensors, metadata, str(path))
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    categories = {thing["id"]: thing["category"] for thing in truth["objects"]}
    return Room(gaussians, ids, evidence.rows(ids), whose, categories, read_views(folder))


def with_wrong(room: Room, percent: int) -> Room:
    """As `with_wrong_masks`."""
    return replace(room, evidence=with_wrong_masks(room.evidence, percent))


@dataclass(frozen=True, eq=False)
class Means(Code):
    """The mean embedding of each row as it is, without a code: as much of one as a query needs."""

    evidence: Evidence
    lengths: np.ndarray
    kind = "exact"

    def __len__(self) -> int:
        return len(self.evidence)

    @property
    def dim(self) -> int:
        return self.evidence.dim

    def scores(self, queries: np.ndarray, *, threads: int = 0) -> np.ndarray:
        return (self.evidence.weights @ (self.evidence.embeddings @ queries.T)).T / self.lengths

    def decode(self, rows: np.ndarray) -> np.ndarray:
        return np.asarray(self.evidence.weights[rows] @ self.evidence.embeddings) / self.lengths[rows, None]


def by_query(room: Room) -> list[Region]:
    evidence = room.evidence
    summed = (evidence.weights[at : at + 4096] @ evidence.embeddings for at in range(0, len(evidence), 4096))
    lengths = np.concatenate([np.linalg.norm(rows, axis=1) for rows in summed])
    code = Means(evidence, np.maximum(lengths, 1e-12).astype(np.float32))
    ids, scene = room.ids.astype(np.uint32), room.gaussians
    field = LanguageField(ids, code, MINI.identity, scene.fingerprint, len(scene), evidence)  # type: ignore[arg-type]
    asked = Scene(field, scene, encoder=MINI)
    return [Region(match.gaussian_ids, match.score) for text in room.texts for match in asked.locate(text, box="free")]


def pieces(room: Room) -> np.ndarray:
    return _things(_chosen(room))


def ours(room: Room) -> np.ndarray:
    return _things(of_pieces(_chosen(room), room.gaussians, room.ids.astype(np.uint32), some_views(room.views)))


def _chosen(room: Room) -> Tree:
    return choose(grow(room.evidence, room.gaussians.means[room.ids]), np.arange(len(room.ids)), MIN_GAUSSIANS)


def _things(tree: Tree) -> np.ndarray:
    thing = owner_nodes(tree.parents, tree.levels == THING)
    return np.asarray(np.append(thing, -1)[tree.node_of])


def regions_of(room: Room, labels: np.ndarray) -> list[Region]:
    """Of labels per row, as sure as single masks fit them."""
    numbers_, labels = np.unique(labels, return_inverse=True)
    labels = labels - (numbers_[0] < 0)
    sure = sureness(room.evidence, labels)
    order = np.argsort(labels, kind="stable")
    order = order[np.searchsorted(labels[order], 0) :]
    members = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if len(order) else []
    return [Region(room.ids[rows], float(sure[labels[rows[0]]])) for rows in members]


Rule = Callable[[Room], list[Region]]


def rule_of(label: Callable[[Room], np.ndarray]) -> Rule:
    return lambda room: regions_of(room, label(room))


def consensus(rule: Agreement, room: Room) -> np.ndarray:
    return mask_clustering(room.evidence, room.gaussians.means[room.ids], rule)


def alike(rule: Alike, room: Room) -> np.ndarray:
    return light_splat(room.evidence, rule)


RULES: dict[str, Rule] = {
    "query, components": by_query,
    "MaskClustering": rule_of(partial(consensus, AGREEMENT)),
    "LightSplat": rule_of(partial(alike, ALIKE)),
    "objects, pieces not joined": rule_of(pieces),
    OURS: rule_of(ours),
}


class Case(NamedTuple):
    masks: str
    percent: int
    rule: str


def study(folders: list[Path], masks: list[str], wrong: list[int], kept: Path) -> Iterator[tuple[Case, list[Compared]]]:
    """By case, the comparison of each room."""
    for kind, percent in product(masks, wrong):
        rooms = [with_wrong(room_of(folder, kind, kept), percent) for folder in folders]
        for name, rule in RULES.items():
            yield Case(kind, percent, name), [room.compared(rule(room)) for room in rooms]


def columns(rooms: list[Compared]) -> np.ndarray:
    """(numbers, rooms), percent."""
    return 100 * np.array([list(numbers(compared).values()) for compared in rooms]).T


def said(values: np.ndarray) -> str:
    low, high = scorers.mean_interval(values)
    return f"{scorers.mean(values):.0f} [{low:.0f}, {high:.0f}]"


def row(case: Case, rooms: list[Compared]) -> str:
    cells = [said(column) for column in columns(rooms)]
    best, sizes = (np.concatenate(part) for part in zip(*((c.best, c.sizes) for c in rooms), strict=True))
    for low, high in pairwise(BANDS):
        some = best[(sizes >= low) & (sizes < high)]
        cells.append(f"{(some >= 0.5).sum()} of {len(some)}, {100 * scorers.mean(some):.0f}")
    return f"| {case.masks}, {case.percent} % | {case.rule} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["graph", "true"])
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20, 40])
    parser.add_argument("--kept", type=Path, default=Path("kept"))
    arguments = parser.parse_args()
    print_table(arguments.scenes, arguments.masks, arguments.wrong, arguments.kept)


def print_table(folders: list[Path], masks: list[str], wrong: list[int], kept: Path) -> None:
    heads = ("AP", "AP50", "AP25", "PQ", "found at 0.5", "best IoU", "60 to 200", "200 to 1000", "1000 and more")
    print("| masks, wrong | rule |", " | ".join(heads), "|")
    print("|---|---" + "|--:" * len(heads) + "|")
    cases = {}
    for case, rooms in study(folders, masks, wrong, kept):
        print(row(case, rooms), flush=True)
        cases[case] = columns(rooms)
    print("\n| masks, wrong | objects minus |", " | ".join(heads[:6]), "|")
    print("|---|---" + "|--:" * 6 + "|")
    for case, values in cases.items():
        if case.rule != OURS:
            gains = cases[case._replace(rule=OURS)] - values
            print(f"| {case.masks}, {case.percent} % | {case.rule} | " + " | ".join(map(said, gains)) + " |")


if __name__ == "__main__":
    main()
