"""Whether renderings can stand in for photos: the same words asked of the same scene, registered from either.

    python benchmarks/study_photograph.py --work FOLDER --clip FOLDER --places PLACE... [--wrong 20] [--seeds 1]
        [--number N] [--demo]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. `drsplat
photograph` takes as many pictures as there are photos, or --number, of their size, the same way up. Both are cut by the
built-in segmenter and asked the words of `suite/trials.py` (--clip: `suite/vocabularies.py`); the truth is that of the
photos, over Gaussians. What a mask of a rendering shows is drawn from the Gaussians' true labels. IoU of the plain
field, of objects, and of the plain field's best threshold; how often most of the best match is what was meant; how many
words find nothing, and how many absent ones find something. --demo: the demo's sixteen questions, with the built-in
encoder.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import arguments
from benchmarks.suite.answers import COLUMNS, Draws, answered, found_absent, kind_of, place_of
from benchmarks.suite.places import UNKNOWN, Place, _found, _registered, drawn_ids
from benchmarks.suite.trials import Trial
from benchmarks.suite.vocabularies import Clip
from drsplat import MiniEncoder, Scene, embed, read_features, read_gaussians, read_views, register
from drsplat.authoring.photographing.settings import PhotographSettings
from drsplat.authoring.photographing.taking import photograph
from drsplat.evaluation.demo import story
from drsplat.evaluation.demo.story import PROBES, unpack_household
from drsplat.field.objects.finding import find_objects
from drsplat.kernels import splat_arrays
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.scene.boxes import up_of

RIGHT = 0.5  # of the weight of the best match


class Numbers(NamedTuple):
    """Of all words of a place's trials: IoUs by column, and shares for the plain field and with objects."""

    ious: dict[str, list[float]]
    located: np.ndarray
    missed: np.ndarray
    absent: np.ndarray


def rendered(place: Place, folder: Path, number: int) -> Place:
    """Return a place whose masks are of renderings of its scene; what is true of its Gaussians stays.

    number: pictures; 0 for as many as there are photos.
    """
    first = place.cameras[0]
    up = up_of(place.cameras)
    settings = PhotographSettings(
        number or len(place.cameras), (first.width, first.height), up=None if up is None else tuple(up.tolist())
    )  # fmt: skip
    record = photograph(place.gaussians, folder, settings, name=place.name, overwrite=True)
    coverage = record["coverage"]
    print(f"{place.name}: {record['kind']}, {record['num_pictures']} pictures, {coverage['often']:.1%} in three")
    views = read_views(folder)
    evidence, owners = _registered(place.gaussians, views, _found(folder), drawn_ids(place.gaussians, labels(place)))
    return replace(place, evidence=evidence, owners=owners, cameras=views)


def labels(place: Place) -> np.ndarray:
    """Return the thing of each Gaussian; where nobody knows, that of the nearest one whose thing is known."""
    known, unknown = np.flatnonzero(place.labels != UNKNOWN), np.flatnonzero(place.labels == UNKNOWN)
    everywhere = place.labels.copy()
    points = place.gaussians.positions
    everywhere[unknown] = place.labels[known][cKDTree(points[known]).query(points[unknown])[1]]
    return everywhere


def numbers(trials: Iterator[Trial]) -> Numbers:
    """Ask all words of some trials."""
    asked, located, absent = [], [], []
    for case in trials:
        asked += list(answered(case))
        located += [[is_right(case, objects, text) for objects in (False, True)] for text in case.present]
        absent += found_absent(case)
    ious = {column: [getattr(one, column) for one in asked] for column in COLUMNS}
    missed = np.array([(one.missed_plain, one.missed_objects) for one in asked])
    return Numbers(ious, np.array(located), missed, np.array(absent))


def is_right(case: Trial, objects: bool, text: str) -> bool:
    """Return whether most of the best match of a word is what the word means."""
    matches = case.scene(objects).locate(text)
    if not matches:
        return False
    rows = case.field.rows_of(matches[0].gaussian_ids)
    mass = case.mass[rows]
    return bool((mass * case.present[text][rows]).sum() > RIGHT * mass.sum())


def row(name: str, pictures: str, found: Numbers) -> str:
    ious = " | ".join(f"{np.mean(found.ious[column]):.3f}" for column in COLUMNS)
    shares = " | ".join(
        f"{part[:, 0].mean():.0%}, {part[:, 1].mean():.0%}" for part in (found.located, found.missed, found.absent)
    )
    return f"| {name} | {pictures} | {len(found.located)} | {ious} | {shares} |"


def demo_rows(folder: Path) -> Iterator[str]:
    """Yield how many of the demo's questions are answered rightly from its photos, and from renderings."""
    told = story.tell(folder / "demo", overwrite=True)
    yield demo_row("photos", told.verdicts)
    household = unpack_household(folder / "demo", overwrite=True)
    gaussians = read_gaussians(household.folder / story.SCENE)
    first = told.views[0]
    settings = PhotographSettings(len(told.views), (first.width, first.height))
    photograph(gaussians, folder / "demo_pictures", settings, name=story.SCENE, overwrite=True)
    views, encoder = read_views(folder / "demo_pictures"), MiniEncoder()
    features = folder / "demo_pictures" / story.FEATURES
    embed(views, features, GraphSegmenter(), encoder)
    field = register(gaussians, views, read_features(features, level="large", encoder=encoder.identity)).to_field()
    field = field.with_objects(find_objects(field, gaussians))
    judge = story._Judge(Scene(field, gaussians), splat_arrays(gaussians), household, told.held_out)
    yield demo_row("renderings", judge.verdicts([judge.asked(probe) for probe in PROBES]))


def demo_row(pictures: str, verdicts: list[story.Verdict]) -> str:
    ious = [one.iou for one in verdicts if one.iou is not None]
    wrong = ", ".join(one.probe.text for one in verdicts if not one.is_right)
    return (
        f"demo, {pictures}: {sum(one.is_right for one in verdicts)} of {len(verdicts)} right, mean IoU "
        f"{np.mean(ious):.3f}; wrong: {wrong or 'none'}"
    )


def main() -> None:
    given = arguments(__doc__, work=Path, clip=Path, wrong=[20], seeds=1, number=0, demo=False, places=[""])
    given.work.mkdir(parents=True, exist_ok=True)
    if given.demo:
        for line in demo_rows(given.work):
            print(line, flush=True)
    words, draws = Clip(given.clip), Draws(tuple(given.wrong), given.seeds)
    print("| place | pictures | words | plain | objects | best threshold | located | missed | absent found |")
    print("|---" * 9 + "|", flush=True)
    for one in filter(None, given.places):
        place = place_of(one, "graph", given.work)
        name = Path(one.partition("=")[0]).resolve().name
        for pictures in ("photos", "renderings"):
            folder = given.work / f"{name}_pictures"
            here = place if pictures == "photos" else rendered(place, folder, given.number)
            print(row(f"{name} ({kind_of(one)})", pictures, numbers(draws.of(here, words))), flush=True)


if __name__ == "__main__":
    main()
