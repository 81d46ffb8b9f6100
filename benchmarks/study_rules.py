"""All rules for one word on the same features: ours with and without objects and refusal, and those of others.

    python benchmarks/study_rules.py PLACE... --kept FOLDER --records FILE.jsonl [--clip FOLDER] [--names FOLDER]
        [--choosing PLACE...] [--wrong 0 20] [--seeds 2] [--curve FILE.svg]

PLACE: as of study_answers.py, masks of `graph`; words and embeddings are drawn as there, 20 absent words a trial. The
rules are those of `suite/rules.py`. Clear words stand a spread or more above the best other word for the picture of
their things, vague ones less. A fixed cosine is the best for the places of --choosing, which no table counts. Intervals
are 95 %, over words (`numbers.over_places`). --records: answers of the trials that are finished; a run that was stopped
goes on. --curve: by the level above which a word is answered, the share of absent and of present words that are.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.answers import CAPTURE, ROOM, best_cut, kind_of, place_of
from benchmarks.suite.chart import Line, Mark, curves
from benchmarks.suite.numbers import over_places, within
from benchmarks.suite.places import Place
from benchmarks.suite.rules import COSINES, PRESENT, Rules
from benchmarks.suite.tables import markdown
from benchmarks.suite.trials import Trial, trial
from benchmarks.suite.vocabularies import KINDS, Clip, Names, Vocabulary
from drsplat.query.defaults import MAYBE, MIN_GAUSSIANS, NOTHING, SURE
from drsplat.query.thresholds import peak_score

Record = dict[str, Any]
ABSENT = 20
CLEAR = 1.0  # spreads above the best other word
SURE_ALONE = "objects, no maybe"
RULES = (
    SURE_ALONE,
    "objects",
    "plain",
    "objects" + PRESENT,
    "plain" + PRESENT,
    "best of the list",
    "component",
    "one object",
    "best word of objects",
)
LERF_RULES = ("LERF", "LangSplat")
LEVELS: dict[str, Callable[[Record], float]] = {
    "margin above the list (ours)": lambda one: -one["missed"], "cosine of the peak": lambda one: one["cosine"],
}  # fmt: skip


def asked(case: Trial, place: Place, words: Vocabulary) -> Iterator[Record]:
    rules = Rules(case, getattr(words, "negatives", None))
    labels, evidence = place.labels[case.field.gaussian_ids], case.field.evidence
    assert evidence is not None
    for text in [*case.present, *case.absent[:ABSENT]]:
        one, meant = rules.asked(text), case.present.get(text)
        record: Record = {"text": text, "certainty": one.plain.certainty, "missed": one.missed}
        record["cosine"] = peak_score(one.plain.scores)
        if meant is None:
            record["found"] = {name: bool(rows.sum() >= MIN_GAUSSIANS) for name, rows in one.selections()}
        else:
            owned = np.isin(place.owners, np.unique(labels[meant]))
            record["clear"] = one.clearness(evidence.embeddings[owned])
            record["iou"] = {name: round(case.iou(rows, meant), 4) for name, rows in one.selections()}
            record["iou"]["best threshold"] = round(best_cut(one.plain.values, meant, case.mass)[1], 4)
        yield record


def run(given: Sequence[str], words: Vocabulary, kept: Path, file: Path, wrong: Sequence[int], seeds: int) -> None:
    """Append a line to the file for each trial that it does not have yet."""
    finished = {json.dumps(one["trial"]) for one in read(file)}
    for one in given:
        place = place_of(one, "graph", kept)
        for kind in KINDS:
            for percent in wrong:
                for seed in range(seeds):
                    key = [place.name, type(words).__name__, kind, percent, seed]
                    if json.dumps(key) in finished:
                        continue
                    case = trial(place, words, kind, percent / 100, seed)
                    known = {"trial": key, "place": place.name, "kind": kind_of(one), "wrong": percent}
                    with file.open("a") as out:
                        out.write(json.dumps(known | {"asked": list(asked(case, place, words))}) + "\n")


def read(file: Path) -> list[Record]:
    """Return finished trials, with what a rule that refuses every maybe would have said."""
    trials = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    for one in (one for done in trials for one in done["asked"]):
        said = one.get("iou", one.get("found"))
        said[SURE_ALONE] = said["objects"] * (one["certainty"] == SURE)
    return trials


class Answers:
    """What was asked, pooled by place."""

    def __init__(self, trials: Sequence[Record]) -> None:
        self.by_place: dict[str, list[Record]] = {}
        for one in trials:
            self.by_place.setdefault(one["place"], []).extend(one["asked"])

    def iou(self, rule: str, which: Callable[[Record], bool], base: str = "") -> str:
        """Say the mean over places of the IoU of present words, in percent, or what it has more than another's."""
        some = [[one for one in own if "iou" in one and rule in one["iou"] and which(one)]
                for own in self.by_place.values()]  # fmt: skip
        some = [own for own in some if own]
        if not some:
            return "-"
        values = [[100 * (one["iou"][rule] - one["iou"].get(base, 0)) for one in own] for own in some]
        mean, _, high = over_places(values, [[one["text"] for one in own] for own in some])
        return f"{mean:{'+.1f' if base else '.1f'}}±{high - mean:.1f}"

    def share(self, what: Callable[[Record], bool], there: bool) -> str:
        """Say the mean over places of a share of present or absent words, in percent."""
        some = [[one for one in own if ("iou" in one) == there] for own in self.by_place.values()]
        some = [own for own in some if own]
        values = [[100.0 * what(one) for one in own] for own in some]
        mean, low, high = over_places(values, [[one["text"] for one in own] for own in some])
        return within(mean, max(low, 0.0), min(high, 100.0))

    def each(self, there: bool) -> list[Record]:
        return [one for own in self.by_place.values() for one in own if ("iou" in one) == there]


def is_present(one: Record) -> bool:
    return "iou" in one


def is_absent(one: Record) -> bool:
    return "iou" not in one


def is_clear(one: Record) -> bool:
    return is_present(one) and bool(one["clear"] >= CLEAR)


def is_vague(one: Record) -> bool:
    return is_present(one) and not is_clear(one)


def best_cosine(trials: Sequence[Record]) -> str:
    """Return the name of the fixed cosine that has the highest mean IoU."""
    there = [one["iou"] for done in trials for one in done["asked"] if "iou" in one]
    names = [f"cosine {level:.2f}" for level in COSINES]
    return max(names, key=lambda name: float(np.mean([one[name] for one in there])))


def table(trials: Sequence[Record], choosing: Sequence[Record]) -> str:
    rows = []
    for words in dict.fromkeys(one["trial"][1] for one in trials):
        own = Answers([one for one in trials if one["trial"][1] == words])
        fixed = best_cosine([one for one in (choosing or trials) if one["trial"][1] == words])
        lerf = LERF_RULES if words == Clip.__name__ else ()
        for rule in (*RULES, *lerf, fixed, "best threshold"):
            found = "-" if rule == "best threshold" else own.share(lambda one, r=rule: one["found"][r], False)
            ious = (own.iou(rule, which) for which in (is_present, is_clear, is_vague))
            rows.append((f"{words}: {rule}", *ious, found))
    counts = [sum(map(which, Answers(trials).each(True))) for which in (is_clear, is_vague)]
    titles = ("rule", "IoU, all words", f"clear ({counts[0]})", f"vague ({counts[1]})", "absent words found")
    return markdown(titles, rows)


def certainties(trials: Sequence[Record]) -> str:
    rows = []
    for name, which in (("clear words", is_clear), ("vague words", is_vague), ("absent words", is_absent)):
        of_each = [one | {"asked": [each for each in one["asked"] if which(each)]} for one in trials]
        own = Answers(of_each)
        rows.append((name, *(own.share(lambda one, s=said: one["certainty"] == s, which is not is_absent)
                             for said in (SURE, MAYBE, NOTHING))))  # fmt: skip
    return markdown(("words", "sure", "maybe", "nothing"), rows)


def operating(trials: Sequence[Record]) -> list[Line]:
    """By level, the shares of absent and present words that are answered above it. Marks: sure, and sure or maybe."""
    own, lines = Answers(trials), []
    for name, level in LEVELS.items():
        there, absent = (np.sort([level(one) for one in own.each(side)]) for side in (True, False))
        at = np.unique(np.concatenate([there, absent]))
        across, up = (100 * (1 - np.searchsorted(side, at, "right") / len(side)) for side in (absent, there))
        lines.append(Line(name, [100.0, *across], [100.0, *up], ()))
    marks = []
    for name, said in (("sure", (SURE,)), ("sure or maybe", (SURE, MAYBE))):
        shares = (np.mean([one["certainty"] in said for one in own.each(side)]) for side in (False, True))
        marks.append(Mark(name, *(100 * float(share) for share in shares)))
    return [lines[0]._replace(marks=marks), *lines[1:]]


def report(trials: Sequence[Record], choosing: set[str], curve: Path | None) -> None:
    chosen = [one for one in trials if one["place"] in choosing]
    judged = [one for one in trials if one["place"] not in choosing]
    for part, kind in product((judged, chosen), (CAPTURE, ROOM)):
        own = [one for one in part if one["kind"] == kind]
        if own:
            places = ", ".join(dict.fromkeys(one["place"].partition(",")[0] for one in own))
            print(f"\n{kind}s{' that choose' if part is chosen and choosing else ''}: {places}\n")
            print(f"{table(own, chosen)}\n\n{certainties(own)}", flush=True)
    if curve is not None:
        title = "Words that are answered, by the level above which they are (percent)"
        drawn = curves(title, "of words that are not there", "of words that are there", operating(judged))
        curve.write_text(drawn, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--choosing", nargs="*", default=[])
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--records", type=Path, required=True, metavar="FILE.jsonl")
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--curve", type=Path, metavar="FILE.svg")
    arguments = parser.parse_args()
    print(describe())
    for make, folder in ((Clip, arguments.clip), (Names, arguments.names)):
        if folder is not None:
            run([*arguments.choosing, *arguments.places], make(folder), arguments.kept, arguments.records,
                arguments.wrong, arguments.seeds)  # fmt: skip
    choosing = {f"{Path(one.partition('=')[0]).name}, graph" for one in arguments.choosing}
    report(read(arguments.records), choosing, arguments.curve)


if __name__ == "__main__":
    main()
