"""Questions with no, one or several targets, in made rooms: what is said of each.

    python benchmarks/study_targets.py ROOM=FIELD... --output docs/targets.json

ROOM: one of world/scenes. FIELD: its field of the built-in encoder, with objects. Asked are all nouns that the encoder
was taught. Targets of a noun are the things and structures of the room with that name or kind of at least `LEAST`
Gaussians; a noun that means smaller things as well is left out. A sure match is right where most of its weight is of a
target. Written are the numbers of answers, from which docs/evaluation.md is made.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.places import true_things
from benchmarks.suite.scenes import read_scene
from benchmarks.suite.targets import SAID, Said, targets_table
from drsplat import MiniEncoder, Scene, load_field
from drsplat.query.defaults import MAYBE, NOTHING

LEAST = 150  # Gaussians of a thing that is asked for


def said_of(given: str) -> Iterator[tuple[int, Said]]:
    """Return for each noun how many targets it has in a room, and what is said."""
    folder, _, path = given.partition("=")
    made, encoder = read_scene(Path(folder)), MiniEncoder()
    scene = Scene(load_field(path), made.gaussians, made.views, encoder)
    labels = true_things(made)[0]
    sizes = Counter(labels.tolist())
    truth = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))
    named = [(one["id"], {one["name"], one.get("category", one["name"])})
             for one in (*truth["objects"], *truth["structures"])]  # fmt: skip
    for text in encoder.nouns:
        meant = [number for number, names in named if text in names and sizes[number]]
        if all(sizes[number] >= LEAST for number in meant):
            yield len(meant), said(scene, labels, text, meant)


def said(scene: Scene, labels: np.ndarray, text: str, meant: list[int]) -> Said:
    answer = scene.ask(text)
    if answer.certainty in (NOTHING, MAYBE):
        return "nothing" if answer.certainty == NOTHING else "maybe"
    sure = [match for match in scene.locate(answer) if match.sure]
    of = [Counter(labels[match.gaussian_ids].tolist()).most_common(1)[0][0] for match in sure]
    if not set(of) & set(meant):
        return "wrong"
    if not set(of) <= set(meant) or len(of) > len(meant):
        return "more"
    return "all" if set(of) == set(meant) else "fewer"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", metavar="ROOM=FIELD")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE.json")
    arguments = parser.parse_args()
    print(describe())
    counts = {kind: dict.fromkeys(SAID, 0) for kind in ("0", "1", "N")}
    for given in arguments.rooms:
        for number, what in said_of(given):
            counts[str(number) if number < 2 else "N"][what] += 1
        print(f"{given.partition('=')[0]}: {sum(map(sum, (of.values() for of in counts.values())))} words", flush=True)
    document = {"rooms": [Path(given.partition("=")[0]).name for given in arguments.rooms], "answers": counts}
    arguments.output.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(targets_table(document))


if __name__ == "__main__":
    main()
