"""Kinds: whether a word finds what stands under it, as "boat" a canoe, with real word vectors.

    python benchmarks/study_kinds.py ROOM... --names FOLDER --kept FOLDER [--trials 12]

ROOM: one of world/scenes, masks of graph. Each thing shows a drawn picture of a name of LVIS (`suite/vocabularies.py`),
four of them names below a kind that is asked for; with the kind's own names taken as rivals, as before, and as its own.
Absent: kinds of which nothing is shown. The first table has IoU and certainty of the present, the second of the absent.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.drawn_embeddings import unit
from benchmarks.machine import describe
from benchmarks.suite.places import Place, room
from benchmarks.suite.tables import markdown
from benchmarks.suite.trials import field_of
from benchmarks.suite.vocabularies import OF_MASKS, Names
from drsplat import Scene
from drsplat.photos.models.word_list import names_under
from drsplat.query.defaults import MAYBE, MIN_GAUSSIANS, NOTHING, SURE

PRESENT, ABSENT = 4, 6


def asked(
    place: Place, words: Names, kinds: list[str], rng: np.random.Generator
) -> list[tuple[bool, str, float, str, float]]:
    """Whether a kind is there, then certainty and IoU before and after, of each that is asked for in a trial."""
    below = {kind: sorted(names_under(kind) & {*words.words} - {kind}) for kind in kinds}
    chosen = rng.choice(kinds, PRESENT, replace=False).tolist()
    shown: dict[int, str] = {}
    for place_in_order, name in enumerate(rng.permutation(sorted(place.things))):
        some = below[chosen[place_in_order]] if place_in_order < PRESENT else words.words
        for thing in place.things[name]:
            shown[thing] = str(rng.choice(some))
    nothing = words.drawn(np.array([-1]), rng)[0]
    pictures = {name: words.drawn(np.array([words.words.index(name)]), rng)[0] for name in sorted({*shown.values()})}
    masks = np.stack([pictures[shown[owner]] if owner in shown else nothing for owner in place.owners.tolist()])
    embeddings = unit(masks + words._noise(rng, len(masks), OF_MASKS)).astype(np.float32)
    field = field_of(replace(place, evidence=replace(place.evidence, embeddings=embeddings)), words.encoder.identity)
    scene = Scene(field, place.gaussians, encoder=words.encoder)
    labels, mass = place.labels[field.gaussian_ids], place.mass[field.gaussian_ids]
    absent = [kind for kind in rng.permutation(kinds) if not names_under(kind) & {*shown.values()}][:ABSENT]
    found = []
    for kind in (*chosen, *absent):
        meant = np.isin(labels, [thing for thing, name in shown.items() if name in names_under(kind)])
        row: list = [kind in chosen]
        for under in (lambda _: frozenset(), names_under):
            with patch("drsplat.query.measuring.names_under", under):
                answer = scene.ask(kind)
            selected = answer.values > answer.threshold
            either = mass[selected | meant].sum()
            enough = selected.sum() >= MIN_GAUSSIANS and either > 0
            row += [answer.certainty, float(mass[selected & meant].sum() / either) if enough else 0.0]
        found.append(tuple(row))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", type=Path)
    parser.add_argument("--names", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=12)
    arguments = parser.parse_args()
    print(describe())
    words, rng = Names(arguments.names), np.random.default_rng(0)
    listed = {*words.words}
    kinds = [word for word in words.words if len(names_under(word) & listed - {word}) >= 2]
    found = []
    for folder in arguments.rooms:
        place = room(folder, "graph", arguments.kept)
        for _ in range(arguments.trials):
            found += asked(place, words, kinds, rng)
    rows = []
    for there, title in ((True, "there"), (False, "absent")):
        some = [row for row in found if row[0] is there]
        for at, rule in ((1, "names of the kind are rivals"), (3, "names of the kind are its own")):
            shares = (f"{np.mean([row[at] == said for row in some]):.1%}" for said in (SURE, MAYBE, NOTHING))
            iou = f"{np.mean([row[at + 1] for row in some]):.3f}" if there else ""
            rows.append((f"{title} ({len(some)}), {rule}", ", ".join(shares), iou))
    print(markdown((f"of {len(kinds)} kinds", "sure, maybe, nothing", "IoU"), rows))


if __name__ == "__main__":
    main()
