"""Answers that are sure, maybe or nothing: how often each is given, of words that are there and of words that are not.

    python benchmarks/study_maybe.py PLACE... --kept FOLDER [--clip FOLDER] [--names FOLDER] [--masks whole]
    python benchmarks/study_maybe.py --built-in ROOM=FIELD... CAPTURE=SCENE=FIELD... [--kept FOLDER]

PLACE: as of study_answers.py. Words and embeddings are drawn as there, a fifth of the masks with a wrong embedding in
every second trial; 20 absent words a trial. `clean`: masks show the best picture of a word, `rough`: one of three, of
which another word may fit some a little better. First table: what is answered, and mean IoU of present words as it was
when a maybe was refused, as answered, and when nothing is refused (`present`). Second: shares by how many spreads a
peak may miss the clear margin (`MAYBE_SPREADS`), which was chosen on table_1, table_3 and the four captures.

--built-in: asks the fields of the built-in encoder for its own nouns, each with and without the colours of the things
that are there; its maybe (`MAYBE_LEAST_SHARE`) was chosen on table_1, table_3 and three rooms that were made for it.
Of captures it asks "something COLOUR" of each colour that an outlined thing has, and of those that nothing there has.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.answers import kind_of, place_of
from benchmarks.suite.places import Place, true_things
from benchmarks.suite.real_colors import NOT_THERE, TRUTH
from benchmarks.suite.scenes import read_scene
from benchmarks.suite.tables import markdown
from benchmarks.suite.trials import LEAST, Trial, trial
from benchmarks.suite.vocabularies import KINDS, Clip, Names
from drsplat import MiniEncoder, Query, Scene, load_field
from drsplat.photos.models.mini.lexicon import COLORS, NAMES
from drsplat.photos.models.word_list import list_vectors
from drsplat.query.contrast import _margin, contrast, least_clear
from drsplat.query.defaults import MAYBE, NOTHING, SURE
from drsplat.query.thresholds import peak_score

WRONG, SEEDS, ABSENT = (0.0, 0.2), 2, 20
SPREADS = (0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0)


class Asked(NamedTuple):
    """certainty: of the answer. missed: spreads by which its peak misses the clear margin, below 0 if it does not.
    refused, answered, forced: IoU without a maybe, with it, and where nothing is refused; of present words."""

    present: bool
    certainty: str
    missed: float
    refused: float = 0.0
    answered: float = 0.0
    forced: float = 0.0


def asked(case: Trial) -> Iterator[Asked]:
    scene = case.scene(objects=True)
    known = contrast(scene.field.with_objects(None), list_vectors(case.encoder))
    margin = float(_margin(np.array(least_clear(known.num_rows, known.clear_margin))))
    for text in [*case.present, *case.absent[:ABSENT]]:
        answer = scene.ask(text)
        assert answer.vector is not None
        values = known.relevancy(answer.vector, scene.field.scores(answer.vector))
        if values is None:
            continue
        missed = margin - float(_margin(np.array(peak_score(values, known.peak))))
        if text not in case.present:
            yield Asked(False, answer.certainty, missed)
            continue
        selected = [answer.values > cut for cut in (answer.without_maybe().threshold, answer.threshold)]
        free = scene.ask(Query(text, present=True))
        selected.append(free.values > free.threshold)
        yield Asked(True, answer.certainty, missed, *(case.iou(rows, case.present[text]) for rows in selected))


def shares(some: list[Asked]) -> str:
    if not some:
        return "-"
    return ", ".join(f"{np.mean([one.certainty == said for one in some]):.1%}" for said in (SURE, MAYBE, NOTHING))


def built_in(given: str, kept: Path | None) -> Iterator[Asked]:
    """Ask a field of the built-in encoder for what it knows of a room, or for the colours of a capture."""
    *place, path = given.split("=")
    if len(place) == 1:
        yield from _of_room(place[0], path)
    elif kept is not None:
        yield from _of_capture(place_of("=".join(place), "graph", kept), Path(place[0]).name, path)


def _of_capture(place: Place, name: str, path: str) -> Iterator[Asked]:
    """IoU is over Gaussians of outlined things, without those that have the colour in part."""
    field, things = load_field(path), list(place.things)
    labels, mass = place.labels[field.gaussian_ids], place.mass[field.gaussian_ids]
    scene = Scene(field, place.gaussians, place.cameras, MiniEncoder())
    for color in COLORS:
        right, partly = (
            [things.index(thing) for thing, said in TRUTH[name].items() if color in said[part].split()]
            for part in (0, 1)
        )
        if not right and color not in NOT_THERE.get(name, "").split():
            continue
        text = f"something {color}"
        counted, meant = mass * ((labels < len(things)) & ~np.isin(labels, partly)), np.isin(labels, right)
        answer, free = scene.ask(text), scene.ask(Query(text, present=True))
        selected = [one.values > one.threshold for one in (answer.without_maybe(), answer, free)]
        ious = [float(counted[rows & meant].sum() / max(counted[rows | meant].sum(), 1e-9)) for rows in selected]
        yield Asked(bool(right), answer.certainty, 0.0, *ious)


def _of_room(folder: str, path: str) -> Iterator[Asked]:
    """Ask a room for what the built-in encoder was taught, things of a few Gaussians left out."""
    made, encoder = read_scene(Path(folder)), MiniEncoder()
    scene = Scene(load_field(path), made.gaussians, made.views, encoder)
    labels = true_things(made)[0][scene.field.gaussian_ids]
    truth = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))
    called = [(one["id"], {one["name"], one.get("category", one["name"])})
              for one in (*truth["objects"], *truth["structures"])]  # fmt: skip
    colors = {one["color"] for one in truth["objects"]} & {*COLORS}
    for text in (*encoder.nouns, *(f"{color} {name}" for color in sorted(colors) for name in NAMES)):
        meant = np.isin(labels, [number for number, names in called if text in names])
        if 0 < meant.sum() < LEAST:
            continue
        answer, free = scene.ask(text), scene.ask(Query(text, present=True))
        selected = [one.values > one.threshold for one in (answer.without_maybe(), answer, free)]
        ious = [float((rows & meant).sum() / max((rows | meant).sum(), 1)) for rows in selected]
        yield Asked(bool(meant.any()), answer.certainty, 0.0, *ious)


def table(found: Mapping[str, list[Asked]]) -> str:
    rows = []
    for name, every in found.items():
        there, absent = ([one for one in every if one.present is present] for present in (True, False))
        ious = (
            "-" if not there else f"{np.mean([getattr(one, rule) for one in there]):.3f}"
            for rule in ("refused", "answered", "forced")
        )
        rows.append((f"{name} ({len(there)}, {len(absent)})", shares(there), shares(absent), *ious))
    titles = ("words there, absent", "there: sure, maybe, nothing", "absent: sure, maybe, nothing")
    return markdown((*titles, "IoU, maybe refused", "answered", "nothing refused"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="*")
    parser.add_argument("--built-in", nargs="+", default=[], metavar="PLACE=FIELD")
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--masks", choices=("graph", "whole"), default="graph")
    arguments = parser.parse_args()
    print(describe())
    if arguments.built_in:
        rooms = {
            f"{Path(given.partition('=')[0]).name}, {Path(given).stem}": list(built_in(given, arguments.kept))
            for given in arguments.built_in
        }
        print(table(rooms | {"all": [one for some in rooms.values() for one in some]}))
        return
    found: dict[str, list[Asked]] = defaultdict(list)
    for given in arguments.places:
        whole = "true" if kind_of(given) == "room" else "sam"
        place = place_of(given, whole if arguments.masks == "whole" else "graph", arguments.kept)
        for make, folder in ((Clip, arguments.clip), (Names, arguments.names)):
            if folder is None:
                continue
            words = make(folder)
            for kind, wrong, seed in product(KINDS, WRONG, range(SEEDS)):
                own = list(asked(trial(place, words, kind, wrong, seed)))
                for part in (place.name, f"{make.__name__}, {kind}", "all"):
                    found[part] += own
        print(f"{place.name}: {len(found[place.name])} words", flush=True)
    curve = []
    for spreads in SPREADS:
        given = [
            np.mean([one.missed < spreads for one in found["all"] if one.present is there]) for there in (True, False)
        ]
        curve.append((f"{spreads:.1f}", *(f"{share:.1%}" for share in given)))
    print(f"\n{table(found)}\n")
    print(markdown(("spreads missed, at most", "answered of those there", "of the absent"), curve))


if __name__ == "__main__":
    main()
