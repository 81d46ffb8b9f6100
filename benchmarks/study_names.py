"""How many objects are named, and how many names are right: the best word of any descriptor, and words that are sure.

    python benchmarks/study_names.py PLACE... --kept FOLDER [--clip FOLDER --wrong 0 20] [--masks graph]

PLACE: a packed room of world/scenes, whose objects the built-in encoder names, or CAPTURE=SCENE with --clip: things are
then called by words whose vectors, and whose pictures' vectors, are genuine CLIP (`suite/trials.py`), and named among
all 40 words of the list; of so many percent of the masks the weights and the embedding are another's. Asked are the
objects that photos agree on and of which seven tenths are one thing. A name is right where its noun is that of the
thing; of the built-in encoder also how many of the colours that are said are right. Nameless: objects of things that
were given no word, and are called by one nevertheless; in a trial some look like one of the list all the same.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.drawn_embeddings import unit
from benchmarks.study_objects import MINI, Room, room_of
from benchmarks.suite.answers import places_of
from benchmarks.suite.places import with_wrong_masks
from benchmarks.suite.trials import Means, Trial, trial
from benchmarks.suite.vocabularies import Clip
from drsplat import LanguageField
from drsplat.field.objects.agreed import agreed
from drsplat.field.objects.finding import find_objects
from drsplat.photos.models.mini.lexicon import COLORS
from drsplat.query.naming import object_names, own_vocabulary
from drsplat.scene.encoders import Encoder

MOSTLY = 0.7  # of an object, that is one thing
NONE = -1


@dataclass
class Counts:
    """Of objects: that have a true name, of these with a name and with the right one; colours; nameless, and named."""

    known: int = 0
    named: int = 0
    right: int = 0
    colored: int = 0
    colors_right: int = 0
    nameless: int = 0
    called: int = 0

    def add(self, said: str | None, noun: str | None, color: str | None) -> None:
        """noun: the true one, None for nothing that has a name. color: the true one, None where that is not known."""
        if noun is None:
            self.nameless, self.called = self.nameless + 1, self.called + (said is not None)
            return
        painted, spoken = _parts(said)
        self.known, self.named, self.right = (
            self.known + 1, self.named + (spoken is not None), self.right + (spoken == noun),
        )  # fmt: skip
        if painted and color:
            self.colored, self.colors_right = self.colored + 1, self.colors_right + (painted == color)

    def __str__(self) -> str:
        return (
            f"{self.named} of {self.known} | {self.right} of {self.named} | {self.colors_right} of {self.colored} "
            f"| {self.called} of {self.nameless}"
        )


def _parts(said: str | None) -> tuple[str | None, str | None]:
    """Colour and noun of a name."""
    if said is None:
        return None, None
    first, _, rest = said.partition(" ")
    if first == "something":
        return rest, None
    return (first, rest) if rest and first in COLORS else (None, said)


def best_words(encoder: Encoder, field: LanguageField, nodes: list[int]) -> list[str | None]:
    """Return the best word of any descriptor above the encoder's threshold: the rule before."""
    texts, objects = own_vocabulary(encoder, field), field.objects
    assert texts
    assert objects is not None
    vectors, least = encoder.encode_texts(texts), getattr(encoder, "threshold", -1.0)
    scores = [(objects.descriptors_of(node) @ vectors.T).max(axis=0, initial=-1) for node in nodes]
    return [texts[one.argmax()] if one.max() > least else None for one in scores]


RULES = {"best word": best_words, "sure": object_names}


def counted(
    encoder: Encoder,
    field: LanguageField,
    owners: np.ndarray,
    mass: np.ndarray,
    names: list[tuple[str, str | None] | None],
) -> dict[str, Counts]:
    """owners: per row the number of its name among `names`, NONE for a row that nothing is known of. mass: of rows."""
    objects = field.objects
    assert objects is not None
    things, numbers = objects.things, objects.thing_of()
    weights = np.zeros((len(things), len(names)))
    known = (numbers >= 0) & (owners != NONE)
    np.add.at(weights, (numbers[known], owners[known]), mass[known])
    mostly = weights.max(1) >= MOSTLY * np.maximum(weights.sum(1), 1e-12)
    asked = np.flatnonzero(agreed(objects.sure[things], objects.num_views[things]) & mostly)
    found = {}
    for rule, named in RULES.items():
        found[rule] = Counts()
        for at, said in zip(asked, named(encoder, field, things[asked].tolist()), strict=True):
            noun, color = names[weights[at].argmax()] or (None, None)
            found[rule].add(said, noun, color)
    return found


def of_room(folder: Path, room: Room) -> dict[str, Counts]:
    """Score the built-in encoder's names, by truth.json."""
    evidence, truth = room.evidence, json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    rows = [unit(evidence.weights[at : at + 4096] @ evidence.embeddings) for at in range(0, len(evidence), 4096)]
    code, ids, scene = Means(np.concatenate(rows)), room.ids.astype(np.uint32), room.gaussians
    field = LanguageField(ids, code, MINI.identity, scene.fingerprint, len(scene), evidence)  # type: ignore[abstract]
    field = replace(field, objects=find_objects(field, scene, views=room.views))
    things = {one["id"]: (one["name"], one.get("color")) for one in truth["objects"]}
    things |= {one["id"]: (one["name"], None) for one in truth["structures"]}
    owners = room.owners[room.ids]
    return counted(MINI, field, owners, np.ones(len(owners)), [things.get(one) for one in range(owners.max() + 1)])


def of_trial(case: Trial) -> dict[str, Counts]:
    """Score names among all words of the list."""
    words = list(case.present)
    owners = np.full(len(case.field), len(words))
    for number, meant in enumerate(case.present.values()):
        owners[meant] = number
    return counted(case.encoder, case.field, owners, case.mass, [*((word, None) for word in words), None])


def cases(given: str, clip: Clip | None, arguments: argparse.Namespace) -> Iterator[tuple[str, dict[str, Counts]]]:
    if "=" not in given:
        for masks in arguments.masks:
            yield (
                f"{Path(given).name}, {masks} | drsplat-mini",
                of_room(Path(given), room_of(Path(given), masks, arguments.kept)),
            )
    elif clip is not None:
        for place in places_of(given, arguments.kept):
            for percent in arguments.wrong:
                wrong = replace(place, evidence=with_wrong_masks(place.evidence, percent))
                sums = {rule: Counts() for rule in RULES}
                for seed in range(arguments.seeds):
                    for rule, found in of_trial(trial(wrong, clip, "rough", percent / 100, seed)).items():
                        for key, value in vars(found).items():
                            setattr(sums[rule], key, getattr(sums[rule], key) + value)
                yield f"{place.name} | CLIP, {percent} % wrong", sums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--masks", nargs="+", default=["graph"])
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20])
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    clip = Clip(arguments.clip) if arguments.clip else None
    print("| place, masks | words | rule | named | right | colours | nameless named |\n" + "|---" * 7 + "|")
    for given in arguments.places:
        for name, found in cases(given, clip, arguments):
            for rule, counts in found.items():
                print(f"| {name} | {rule} | {counts} |", flush=True)


if __name__ == "__main__":
    main()
