"""What the numbers say, in a few sentences that follow from them."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from drsplat.evaluation import scorers

from .headline import PLACES, SYSTEMS, Answers, Asked, asked
from .numbers import Results, masks_of, methods_of, said, values, within
from .rivals import FITTED
from .tables import gain

FEW = 5  # of fewer scenes, no interval over scenes is believed
WORDS = {
    "more": "better", "less": "worse", "undecided": "neither clearly better nor worse", "": "too few to be judged",
}  # fmt: skip


def reading(results: Results, answers: Answers | None) -> list[str]:
    """Five or six sentences for somebody who reads nothing else."""
    groups = asked(answers) if answers else []
    found = {one.kind: one for one in groups if one.masks == "graph"}
    better = {one.kind: one for one in groups if one.masks != "graph"}
    sentences = []
    if found:
        sentences += [_how_good(found), _objects(found), _threshold(found), _absent(found)]
    if found and better:
        sentences.append(_masks(found, better))
    return [*sentences, *_rivals(results)]


def verdict(numbers: Sequence[float]) -> str:
    """By the interval of the mean over scenes.

    >>> verdict([1.0, 2.0, 1.0, 2.0, 1.0]), verdict([-1.0, 1.0, -2.0, 2.0, 0.0]), verdict([1.0, 2.0])
    ('more', 'undecided', '')
    """
    return _side(*scorers.mean_interval(numbers)) if len(numbers) >= FEW else ""


def _side(low: float, high: float) -> str:
    if low > 0:
        return "more"
    return "less" if high < 0 else "undecided"


def _listed(groups: Mapping[str, Asked], say: Callable[[Asked], str]) -> str:
    return " and ".join(f"{say(one)} in {len(one.records)} {PLACES[kind]}" for kind, one in groups.items())


def _how_good(found: Mapping[str, Asked]) -> str:
    parts = _listed(found, lambda one: f"{one.over('objects')[0]:.0f} %")
    return f"Asked for a word, drsplat selects what overlaps the thing that is meant by {parts} (IoU, all by default)."


def _objects(found: Mapping[str, Asked]) -> str:
    def say(one: Asked) -> str:
        mean, low, high = one.gain("objects", "plain")
        return f"{WORDS[_side(low, high)]} ({within(mean, low, high, signed=True)})"

    return f"Answers in whole objects, the default, beside those of Gaussians alone, are {_listed(found, say)}."


def _threshold(found: Mapping[str, Asked]) -> str:
    parts = _listed(found, lambda one: f"{one.gain('best', 'objects')[0]:+.0f}")
    return f"The best threshold for each word, which nobody knows without the truth, is worth {parts}."


def _absent(found: Mapping[str, Asked]) -> str:
    absent = _listed(found, lambda one: f"{one.share('found', 'objects'):.0f} %")
    missed = _listed(found, lambda one: f"{one.share('missed', 'objects'):.0f} %")
    return (
        f"Words for what is not there find something all the same: {absent}. Words for what is find nothing: {missed}."
    )


def _masks(found: Mapping[str, Asked], better: Mapping[str, Asked]) -> str:
    def say(one: Asked) -> str:
        mean, base = (some[one.kind].over("objects")[0] for some in (better, found))
        return f"{mean - base:+.0f}"

    both = {kind: one for kind, one in better.items() if kind in found}
    return f"Masks of whole things, in place of what the built-in segmenter finds, are worth {_listed(both, say)}."


def _rivals(results: Results) -> Iterator[str]:
    """The best of the fitted rivals beside objects, for the masks that most of them were fitted on."""
    fitted = {masks: [name for name in FITTED if name in methods_of(results, masks)] for masks in masks_of(results)}
    masks = max(fitted, key=lambda kind: len(fitted[kind]), default="")
    if not masks or not fitted[masks] or "objects" not in methods_of(results, masks):
        return
    best = max(fitted[masks], key=lambda name: scorers.mean(values(results, masks, name, "automatic")))
    gains = gain(results, masks, "objects", best, "automatic")
    yield (
        f"The best of {len(fitted[masks])} systems that were fitted from their papers on the same {masks} masks is "
        f"{SYSTEMS[best]}; selections of drsplat, beside its own, are {WORDS[verdict(gains)]} "
        f"({said(gains, signed=True)} in {len(gains)} rooms)."
    )
