"""How much of the list of objects is things, and how many things are on it: all objects, and what photos agree on.

    python benchmarks/study_list.py PLACE... --clip FOLDER --kept FOLDER [--wrong 0 20]

PLACE: a packed room of world/scenes, CAPTURE=SCENE, a capture with the scene that was trained on it, or
CAPTURE=SCENE=FIELD with a field of it, whose objects are then scored as they are. Things are known by
`suite/places.py`; embeddings are drawn by `suite/trials.py`. --wrong: of so many percent of the masks the weights go to
another mask of their photo, and of as many the embedding is another's.

An object is judged where half of its opacity is of Gaussians whose truth is known, and half of its weight there lies in
things: of a capture, most of which nobody outlined, the others are left out, and only counted. It is right where it is
a thing (IoU 0.5 by weight), or a part of one: nine tenths of it in the thing, and a fiftieth of the thing in it.
"pieces" has the precision with smaller parts right as well, which may be a shoe of a doll or a patch of shadow. Recall:
things of 60 Gaussians and more that an object of the list is, at IoU 0.5.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import places_of
from benchmarks.suite.instances import LEAST
from benchmarks.suite.places import Place, with_wrong_masks
from benchmarks.suite.trials import trial
from benchmarks.suite.vocabularies import Clip
from drsplat import LanguageField, load_field
from drsplat.field.objects.agreed import agreed, agreement

KNOWN, IN_THINGS = 0.5, 0.5
IOU, PURE, SHARE = 0.5, 0.9, 0.02
BANDS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 1.01)


class Scored(NamedTuple):
    """Objects of a list. agreement: how far photos agree. right: a thing or a fair part; piece: pure, however small.

    found: whether it is each of the things.
    """

    agreement: Float64[np.ndarray, " o"]
    agreed: Bool[np.ndarray, " o"]
    judged: Bool[np.ndarray, " o"]
    right: Bool[np.ndarray, " o"]
    piece: Bool[np.ndarray, " o"]
    found: Bool[np.ndarray, "o t"]


def scored(field: LanguageField, place: Place) -> Scored:
    """Score the objects of a field of a place's scene."""
    objects = field.objects
    assert objects is not None
    numbers, labels, mass = objects.thing_of(), place.labels[field.gaussian_ids], place.mass[field.gaussian_ids]
    sizes = np.bincount(place.labels[place.labels >= 0])
    things = [one for some in place.things.values() for one in some if one < len(sizes) and sizes[one] >= LEAST]
    opacity = place.gaussians.opacities[field.gaussian_ids].astype(np.float64)
    inside = np.zeros((len(objects), len(sizes)))
    rows = (numbers >= 0) & (labels >= 0)
    np.add.at(inside, (numbers[rows], labels[rows]), mass[rows])
    known = np.bincount(numbers[rows], opacity[rows], len(objects))
    whole = np.bincount(numbers[numbers >= 0], opacity[numbers >= 0], len(objects))
    own, total = inside.sum(1), np.bincount(labels[labels >= 0], mass[labels >= 0], len(sizes))[things]
    shared = inside[:, things]
    ious = shared / np.maximum(own[:, None] + total - shared, 1e-12)
    pure = shared >= PURE * np.maximum(own, 1e-12)[:, None]
    found = ious >= IOU
    judged = (known >= KNOWN * whole) & (own > 0) & (shared.sum(1) >= IN_THINGS * own)
    fair = pure & (shared >= SHARE * total)
    sure, views = objects.sure[objects.things], objects.num_views[objects.things]
    right = (found | fair).any(1)
    return Scored(agreement(sure, views), agreed(sure, views), judged, right, right | pure.any(1), found)


def cases(given: str, clip: Clip, wrong: list[int], kept: Path) -> Iterator[tuple[str, Scored]]:
    """Kind of place and masks, with the scores of the objects that are found there; last the field's own."""
    capture, scene, own = (*given.split("="), "", "")[:3]
    kind = "capture" if scene else "room"
    for place in places_of(f"{capture}={scene}" if scene else capture, kept):
        for percent in wrong:
            evidence = with_wrong_masks(place.evidence, percent)
            case = trial(replace(place, evidence=evidence), clip, "rough", percent / 100, 0)
            yield f"{kind}, {place.name.split(', ')[1]}| {place.name} | {percent} %", scored(case.field, place)
        if own and place.name.endswith("graph"):
            yield f"{kind}, field| {place.name.split(',')[0]}, field | as it is", scored(load_field(own), place)


def row(one: Scored) -> str:
    """Return precision, with pieces, recall and numbers: judged of listed; of all objects and of those agreed on."""
    cells = []
    for listed in (np.ones(len(one.agreed), bool), one.agreed):
        judged = listed & one.judged
        precision, pieces = (f"{some[judged].mean():.2f}" if judged.any() else "-" for some in (one.right, one.piece))
        recall = one.found[listed].any(0).mean() if one.found.size else np.nan
        cells += [precision, pieces, f"{recall:.2f}", f"{np.count_nonzero(judged)} of {np.count_nonzero(listed)}"]
    return " | ".join(cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20])
    arguments = parser.parse_args()
    clip = Clip(arguments.clip)
    columns = "precision | pieces | recall | judged"
    print(f"| place, masks | wrong | all: {columns} | agreed on: {columns} |\n|---|---" + "|--:" * 8 + "|")
    groups: dict[str, list[Scored]] = {}
    for given in arguments.places:
        for name, one in cases(given, clip, arguments.wrong, arguments.kept):
            group, said = name.split("|", 1)
            groups.setdefault(group, []).append(one)
            print(f"|{said} | {row(one)} |", flush=True)
    print_bands(groups)


def print_bands(groups: dict[str, list[Scored]]) -> None:
    """Print the share that is right of the judged objects of each band of agreement, and their number."""
    bands = list(pairwise(BANDS))
    print(
        "\n| right, of judged, by agreement |" + "|".join(f" {low:g} to {min(high, 1):g} " for low, high in bands) + "|"
    )
    print("|---" + "|--:" * len(bands) + "|")
    for group, some in groups.items():
        agreement_, right = (
            np.concatenate([getattr(one, name)[one.judged] for one in some]) for name in ("agreement", "right")
        )
        inside = [right[(agreement_ >= low) & (agreement_ < high)] for low, high in bands]
        cells = (f"{part.mean():.2f} of {len(part)}" if len(part) else "-" for part in inside)
        print(f"| {group} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
