"""Whether eyes that were trained on real photos answer everyday words better than the built-in pair.

    python benchmarks/study_eyes.py CAPTURE=SCENE=FIELD... ROOM=FIELD... --kept FOLDER [--outlines] [--worst FILE.jpg]

FIELD: of the built-in pair, with objects. Words of captures: suite/everyday_words.json, written down before any was
asked, and colours (suite/real_colors.py); of rooms: the names that are there, with and without their colours, and
eighteen that are not. Asked are

- the built-in pair, as it answers by default: what is found, maybe or for sure;
- real eyes (suite/real_eyes.py, which names what to install): log probabilities of ImageNet's classes, averaged over
  sixteen crops of each listed object in its four best photos; a word's share is the sum of the classes below it in
  WordNet, or, if no class is, ConSE with a sentence encoder; "red mug": both hold, colours by the built-in encoder;
- one rule: the built-in pair where its nouns are believed (`naming.knows_nouns`), else real eyes;
- with --outlines: real eyes on the true outlines and Gaussians of each thing, a bound that no masks exceed.

Numbers of real eyes (how much evidence crops are, what is refused, where names stop) are chosen on all captures but
the one that is reported, in rooms on all captures: the best mean IoU that believes at most 1 of 18 absent words; the
most names of which four in five are right or a right kind. IoU is over Gaussians whose truth is known, by weight; if
other things than those outlined may be called so, over the outlined ones. --worst draws the worst names of captures
whose photos may be shown.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.everyday import ABSENT, WORDS, Said, Word, ground_of
from benchmarks.suite.looking import BETAS, CUTS, SECONDS, Answers, Looked, look, timed
from benchmarks.suite.real_eyes import Classifier, Sentences, synsets
from benchmarks.suite.tables import markdown
from benchmarks.suite.wordnet import WordNet
from drsplat import MiniEncoder
from drsplat.drawing.cards import Card, card_sheet
from drsplat.drawing.pictures import write_picture
from drsplat.photos.models.mini.lexicon import COLORS
from drsplat.query.naming import fit_of, knows_nouns

SHOWN = ("plush", "brighton_beach")  # captures whose photos may be shown, with their licences
WORST, COLUMNS, TILE = 20, 7, (128, 128)
SURE = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)  # least probability of a name
INFORMATION = (0.4, 0.5, 0.6, 0.7)  # least, of a name
NAMINGS = tuple(product(BETAS, SURE, INFORMATION))
RIGHT_NAMES = 0.8  # least share of names that are right or a right kind
PART = 0.2  # of a thing: what is less of it is not judged by its name
RIGHT_IOU = 0.5  # of an answer that came out right
NO_NAME, RIGHT, KIND, WRONG = range(4)


class Eyes(NamedTuple):
    """What real eyes make of one place. judged: by object, WORDS' or truth's names of the thing that it is of.

    named: verdicts on the judged objects' names, by each of NAMINGS.
    """

    looked: Looked
    words: list[tuple[Word, Answers]]
    judged: dict[int, str]
    named: list[list[int]]


def answered(looked: Looked, wordnet: WordNet, sentences: Sentences) -> Eyes:
    nouns = [word for word in looked.ground.words if word.kind == "noun"]
    with timed("words of a place", 1):
        found = [(word, looked.answers(word, wordnet, sentences)) for word in nouns]
    judged = dict(_judged(looked))
    with timed("names of a place, by all cuts"):
        masses = {beta: wordnet.masses(looked.probabilities(beta)[list(judged)]) for beta in BETAS}
        named = []
        for beta, sure, least in NAMINGS:
            names = [[node] if node else [] for node in wordnet.climbed(masses[beta], sure, least)]
            named.append(verdicts(judged, names, wordnet))
    return Eyes(looked, found, judged, named)


def _judged(looked: Looked) -> Iterator[tuple[int, str]]:
    """Yield the objects that are mostly of one known thing, and enough of it, with the thing's names."""
    ground = looked.ground
    names = {number: name for name, some in ground.place.things.items() for number in some}
    masses = {number: ground.mass[ground.labels == number].sum() for number in names}
    for at, rows in enumerate(looked.rows):
        known = rows[ground.labels[rows] >= 0]
        if not len(known):
            continue
        shares = np.bincount(ground.labels[known], ground.mass[known])
        best = int(shares.argmax())
        if best in names and shares[best] > shares.sum() / 2 and shares[best] > PART * masses[best]:
            called = WORDS[ground.name]["names"] if ground.is_capture else {}
            yield at, called.get(names[best], names[best].replace(" ", "_"))


def chosen_cut(eyes: Sequence[Eyes]) -> int:
    """Return the number of the cut with the best mean IoU that believes at most one of 18 absent words."""
    every = [one for some in eyes for one in some.words]
    ious = np.mean([answers.ious for word, answers in every if word.is_present], 0)
    absent = np.mean([answers.is_found for word, answers in every if not word.is_present], 0)
    return int(np.where(absent <= 1 / ABSENT, ious, -absent).argmax())


def verdicts(judged: Mapping[int, str], names: Sequence[list[str]], wordnet: WordNet) -> list[int]:
    """Judge the nodes that each judged object is called by: [] for no name."""
    found = []
    for called, nodes in zip(judged.values(), names, strict=True):
        true = {node for name in called.split() for node in wordnet.nodes(name.replace("_", " "))}
        kinds = set().union(*(wordnet.above(node) for node in true))
        given = {*nodes}
        verdict = NO_NAME if not given else RIGHT if given & true else KIND if given & kinds else WRONG
        found.append(verdict)
    return found


def built_in_names(eyes: Eyes, wordnet: WordNet) -> list[list[str]]:
    """Return the nodes of the nouns that the built-in encoder gives; a colour alone is no name."""
    every = eyes.looked.ground.scene.object_names()
    nouns = []
    for at in eyes.judged:
        number = eyes.looked.numbers[at]
        color, _, rest = (every[number] or "").partition(" ")
        nouns.append(rest if color in COLORS and rest else every[number] or "")
    return [wordnet.nodes(noun) if noun and not noun.startswith("something ") else [] for noun in nouns]


def chosen_naming(eyes: Sequence[Eyes]) -> int:
    """Return the number of what gives the most right names and kinds, of which four in five are."""
    best, most = len(NAMINGS) - 1, 0
    for number in range(len(NAMINGS)):
        found = [verdict for some in eyes for verdict in some.named[number]]
        good, wrong = found.count(RIGHT) + found.count(KIND), found.count(WRONG)
        if good > most and good >= RIGHT_NAMES * (good + wrong):
            best, most = number, good
    return best


def said_by(eyes: Eyes, cut: int) -> list[Said]:
    """Return the answers to all words of a place: nouns by real eyes, colours by the built-in encoder."""
    nouns = {word.text: answers for word, answers in eyes.words}
    said = []
    for word, own in zip(eyes.looked.ground.words, eyes.looked.ground.by_built_in, strict=True):
        if word.text in nouns:
            iou, is_found = (some[cut].item() for some in nouns[word.text])
            own = Said(iou, is_found, is_found)
        said.append(own)
    return said


def row_of(name: str, words: Sequence[Word], said: Sequence[Said]) -> tuple[str, ...]:
    """Return mean IoU of all, nouns and colours, how many are answered nothing, and absent ones that are believed."""
    there = [(word, one) for word, one in zip(words, said, strict=True) if word.is_present]
    absent = [one for word, one in zip(words, said, strict=True) if not word.is_present]
    means = []
    for kinds in (("noun", "colour"), ("noun",), ("colour",)):
        some = [one.iou for word, one in there if word.kind in kinds]
        means.append(f"{np.mean(some):.3f} ({len(some)})" if some else "-")
    nothing = f"{sum(not one.is_found for _, one in there)} of {len(there)}"
    return (
        name,
        *means,
        nothing,
        f"{sum(one.is_found for one in absent)}, {sum(one.is_sure for one in absent)} of {len(absent)}",
    )


def eight_of(name: str, words: Sequence[Word], said: Sequence[Said]) -> str:
    """Say which of a capture's eight everyday questions come out right: IoU of 0.5, and nothing for what is absent."""
    asked = {word.text: (word, one) for word, one in zip(words, said, strict=True)}
    right = [
        text
        for text in WORDS[name]["eight"]
        if (asked[text][1].iou >= RIGHT_IOU if asked[text][0].is_present else not asked[text][1].is_found)
    ]
    return f"{len(right)} of {len(WORDS[name]['eight'])} ({', '.join(right)})"


def tables(places: Mapping[str, Eyes], bounds: Mapping[str, Eyes], wordnet: WordNet) -> Iterator[str]:
    """Yield the table of words, the table of names, and what was chosen for each place."""
    captures = [name for name in places if places[name].looked.ground.is_capture]
    words, names, chosen = [], [], []
    for name, eyes in places.items():
        ground, others = eyes.looked.ground, [places[one] for one in captures if one != name]
        cut, naming = chosen_cut(others), chosen_naming(others)
        real, field, encoder = said_by(eyes, cut), ground.scene.field, MiniEncoder()
        believed = knows_nouns(encoder, field)
        words.append(row_of(f"{name}: built-in", ground.words, ground.by_built_in))
        words.append(row_of("real eyes", ground.words, real))
        words.append(row_of("chosen by the fit", ground.words, ground.by_built_in if believed else real))
        if "eight" in WORDS.get(name, ()):
            answers = (eight_of(name, ground.words, one) for one in (ground.by_built_in, real))
            yield f"{name}, everyday questions that come out right: built-in {', real eyes '.join(answers)}"
        if name in bounds:
            bound = chosen_cut([bounds[one] for one in captures if one != name])
            words.append(row_of("real eyes, true outlines", ground.words, said_by(bounds[name], bound)))
        counts = verdicts(eyes.judged, built_in_names(eyes, wordnet), wordnet), eyes.named[naming]
        names.append(
            (
                name,
                str(len(eyes.judged)),
                *(f"{some.count(RIGHT)}, {some.count(KIND)}, {some.count(WRONG)}" for some in counts),
            )
        )
        chosen.append(
            (name, f"{fit_of(encoder, field):.3f}", *(f"{number:g}" for number in (*CUTS[cut], *NAMINGS[naming])))
        )
    yield markdown(
        ("place", "IoU of present words", "nouns", "colours", "answered nothing", "absent found, for sure"), words
    )
    yield markdown(("place", "objects judged", "built-in: right, kind, wrong", "real eyes"), names)
    titles = ("beta", "share", "ratio", "cosine", "margin", "names: beta", "sure", "information")
    yield markdown(("chosen on the other captures", "fit", *titles), chosen)


def draw_worst(places: Mapping[str, Eyes], wordnet: WordNet, path: Path) -> None:
    """Draw listed objects by their likeliest class, the likeliest first, without those of which it is known to be true.

    Who looks at the picture says what the others are.
    """
    found = []
    for name in SHOWN:
        eyes = places[name]
        probabilities = eyes.looked.probabilities(1.0)
        best = [wordnet.leaves[number] for number in probabilities.argmax(1)]
        verdict = dict(
            zip(eyes.judged, verdicts(eyes.judged, [[best[at]] for at in eyes.judged], wordnet), strict=True)
        )
        for at, node in enumerate(best):
            if verdict.get(at, WRONG) == WRONG:
                found.append((-float(probabilities[at].max()), name, at, wordnet.lemmas[node][0]))
    cards = []
    for number, (likely, name, at, called) in enumerate(sorted(found)[:WORST], start=1):
        picture = places[name].looked.pictures[at].resize(TILE)
        cards.append(Card(np.asarray(picture), f"{number}. {called}", [f"{-likely:.2f}, {name}"]))
    sheet = card_sheet(cards, COLUMNS, "Names by ImageNet's classes", "The likeliest class of an object")
    write_picture(path, sheet, overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+", metavar="PLACE=FIELD")
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--wordnet", type=Path, default=Path("/usr/share/wordnet"))
    parser.add_argument("--outlines", action="store_true")
    parser.add_argument("--worst", type=Path, metavar="FILE.jpg")
    arguments = parser.parse_args()
    print(describe(), flush=True)
    with timed("weights read"):
        classifier, wordnet = Classifier(), WordNet(arguments.wordnet, synsets())
    with timed("vectors of the classes' names"):
        sentences = Sentences([wordnet.lemmas[leaf] for leaf in wordnet.leaves], arguments.kept)
    places, bounds = {}, {}
    for given in arguments.places:
        ground = ground_of(given, arguments.kept)
        places[ground.name] = answered(look(ground, classifier, False, arguments.kept), wordnet, sentences)
        if arguments.outlines:
            bounds[ground.name] = answered(look(ground, classifier, True, arguments.kept), wordnet, sentences)
        print(f"{ground.name}: {len(places[ground.name].looked.rows)} objects", flush=True)
    for table in tables(places, bounds, wordnet):
        print(f"\n{table}")
    print()
    print(markdown(("CPU seconds", "mean"), [(step, f"{np.mean(some):.2f}") for step, some in SECONDS.items()]))
    if arguments.worst:
        draw_worst(places, wordnet, arguments.worst)


if __name__ == "__main__":
    main()
