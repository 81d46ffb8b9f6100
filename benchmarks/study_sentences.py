"""Sentences that name two things, in made rooms: what is found, against the same relation of the true things.

    python benchmarks/study_sentences.py ROOM=FIELD... [--each 8] [--seed 0]
    python benchmarks/study_sentences.py ROOM=FIELD... --by-hand CAPTURE=SCENE... --names FOLDER --kept FOLDER

ROOM: one of world/scenes. FIELD: its field of the built-in encoder, with objects. Asked are "X on Y", in, next to,
under, above, left of: of each relation as many as --each draws, half of which hold for something and half for
nothing, though X and Y are there. True are the things of which the true Gaussians lie so. Right: exactly the true ones
are found, by the thing that most of a match's weight is of. Wrong for sure: something else is, without a doubt. The
second table counts what each name of a room means: how often the sure matches, or all, are as many as there are.

--by-hand: asks the sentences of suite/sentences.json instead, which were written by hand with what they mean, of the
rooms and of captures, whose things are called by drawn pictures of genuine text vectors (`suite/trials.py::called`).
"Refused" is right for what the grammar does not know. Names of the captures' things are counted too.
FOLDER: as of study_maybe.py.
"""

import argparse
import json
import sys
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


from benchmarks.machine import describe
from benchmarks.suite.answers import place_of
from benchmarks.suite.places import true_things
from benchmarks.suite.scenes import read_scene
from benchmarks.suite.tables import markdown
from benchmarks.suite.trials import called
from benchmarks.suite.vocabularies import Names
from drsplat import Match, MiniEncoder, Scene, load_field
from drsplat.errors import DrSplatError
from drsplat.kernels.boxes import box_of
from drsplat.query.defaults import SURE
from drsplat.query.relations import is_beside, related

SAID = {"on": "on", "in": "in", "next_to": "next to", "under": "under", "above": "above", "left_of": "left of"}
CALLED = {"laptop": "laptop computer", "mat": "mousepad", "bag": "handbag", "notes": "notepad", "case": "pencil box"}
REFUSED = "refused"
LEAST = 150  # Gaussians of a thing that is asked for


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", metavar="ROOM=FIELD")
    parser.add_argument("--each", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--by-hand", nargs="*", metavar="CAPTURE=SCENE")
    parser.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path)
    arguments = parser.parse_args()
    print(describe())
    if arguments.by_hand is not None:
        by_hand(arguments.rooms, arguments.by_hand, arguments.names, arguments.kept)
        return
    rows, total, counts_of = [], np.zeros(4, int), np.zeros(3, int)
    for given in arguments.rooms:
        folder, _, path = given.partition("=")
        counts, counted = room(Path(folder), Path(path), arguments.each, np.random.default_rng(arguments.seed))
        counts_of += counted
        total += counts
        rows.append((Path(folder).name, *map(str, counts)))
    print(
        markdown(
            ("room", "sentences", "right", "maybe or nothing", "wrong for sure"), [*rows, ("all", *map(str, total))]
        )
    )
    print(markdown(("names counted", "right by sure matches", "by all"), [tuple(map(str, counts_of))]))


def by_hand(rooms: list[str], captures: list[str], names: Path, kept: Path) -> None:
    said = json.loads((Path(__file__).parent / "suite" / "sentences.json").read_text(encoding="utf-8"))
    rows, total, counts_of = [], np.zeros(4, int), np.zeros(3, int)
    for given in (*rooms, *captures):
        name = Path(given.partition("=")[0]).name
        scene, labels, numbers = _room(given) if given in rooms else _capture(given, names, kept)
        counts_of += _counted(scene, [CALLED.get(thing, thing) for thing in numbers if thing != "lid"])
        counts = np.zeros(4, int)
        for text, meant in said[name].items():
            true = meant if meant == REFUSED else {numbers.get(one, one) for one in meant}
            verdict = _verdict(scene, labels, text, true)
            counts += [1, *(verdict == one for one in ("right", "unsure", "wrong"))]
            print(f"{name}: {verdict}: {text}", flush=True)
        rows.append((name, *map(str, counts)))
        total += counts
    titles = ("place", "sentences", "right", "maybe, less or nothing", "wrong for sure")
    print(markdown(titles, [*rows, ("all", *map(str, total))]))
    print(markdown(("names of captures counted", "right by sure matches", "by all"), [tuple(map(str, counts_of))]))


def _room(given: str) -> tuple[Scene, np.ndarray, dict[str, int]]:
    folder, _, path = given.partition("=")
    made = read_scene(Path(folder))
    return Scene(load_field(path), made.gaussians, made.views, MiniEncoder()), true_things(made)[0], {}


def _capture(given: str, folder: Path, kept: Path) -> tuple[Scene, np.ndarray, dict[str, int]]:
    """Return a capture with its things called by CALLED, and the number of each thing."""
    words = Names(folder)
    words.words = [word.partition(" (")[0] for word in words.words]  # "mouse (computer equipment)" is said "mouse"
    place = place_of(given, "graph", kept)
    field = called(place, words, {thing: CALLED.get(thing, thing) for thing in place.things if thing != "lid"})
    numbers = {thing: of[0] for thing, of in place.things.items()}
    return Scene(field, place.gaussians, place.cameras, words.encoder), place.labels, numbers


def room(folder: Path, path: Path, each: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    made = read_scene(folder)
    scene = Scene(load_field(path), made.gaussians, made.views, MiniEncoder())
    labels, _ = true_things(made)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    names = {one["id"]: one["name"] for one in truth["objects"]}
    things: dict[int, Match] = {}
    for number in names:
        ids = np.flatnonzero(labels == number)
        if len(ids) >= LEAST:
            things[number] = Match(*box_of(made.gaussians, ids, scene.up), 1.0, ids, object_id=number)
    asked = defaultdict(list)
    kinds = sorted({names[number] for number in things})
    for relation in SAID:
        for one in kinds:
            for other in kinds:
                if one != other:
                    true = {
                        n for n in things if names[n] == one and _true(scene, relation, things[n], things, names, other)
                    }
                    asked[relation, bool(true)].append((f"{one} {SAID[relation]} {other}", true))
    counts = np.zeros(4, int)
    for some in asked.values():
        for at in rng.permutation(len(some))[: each // 2]:
            text, true = some[at]
            verdict = _verdict(scene, labels, text, true)
            counts += [1, *(verdict == one for one in ("right", "unsure", "wrong"))]
            if verdict != "right":
                print(f"{folder.name}: {verdict}: {text}: true {sorted(names[n] for n in true)}")
    return counts, _counted(scene, [names[number] for number in things])


def _counted(scene: Scene, names: list[str]) -> np.ndarray:
    counts = np.zeros(3, int)
    for name, there in Counter(names).items():
        matches = scene.locate(name)
        counts += [1, sum(match.sure for match in matches) == there, len(matches) == there]
    return counts


def _true(scene: Scene, relation: str, one: Match, things: dict[int, Match], names: dict[int, str], other: str) -> bool:
    ends = [end for number, end in things.items() if names[number] == other]
    if relation == "left_of":
        best = max(ends, key=len)
        return is_beside(scene.best_view(best.gaussian_ids), "left_of", one, best)
    return any(related(scene.rows, relation, [one], end, None, scene.up) for end in ends)


def _verdict(scene: Scene, labels: np.ndarray, text: str, true: set[int] | str) -> str:
    try:
        answer = scene.ask(text)
        matches = [match for match in scene.locate(answer) if match.sure]
    except DrSplatError:
        return "right" if true == REFUSED else "unsure"
    if isinstance(true, str):
        return "wrong"
    found = set()
    for match in matches:
        own = labels[match.gaussian_ids]
        found.add(int(np.bincount(own[own >= 0], minlength=1).argmax()) if (own >= 0).any() else -1)
    if found == true:
        return "right"
    return "wrong" if answer.certainty == SURE and found - true else "unsure"


if __name__ == "__main__":
    main()
