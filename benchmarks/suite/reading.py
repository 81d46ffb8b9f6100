"""What the numbers say, in sentences that follow from them."""

from collections.abc import Sequence

from drsplat.evaluation import metrics

from .numbers import Results, correlations, difference, masks_of, methods_of, records_of, said, tuned, values
from .rendered import ONE_STEP, RENDERED
from .rivals import LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN
from .tables import COMPARED_WORDS, compared, gain

PAIRS = (
    ("mean", RENDERED), (ONE_STEP, RENDERED), ("robust", "mean"), ("trusted", "mean"), ("voting", "mean"),
    ("official", "mean"), ("mean", LANGSPLAT), ("mean", LEGAUSSIANS), ("mean", OPENGAUSSIAN), ("mean", "centre-pixel"),
    ("mean", "vala"), ("objects", "mean"),
)  # fmt: skip
FEW = 5  # of fewer scenes, no interval is believed


def reading(results: Results) -> list[str]:
    """Sentences."""
    found = []
    for masks in masks_of(results):
        known = methods_of(results, masks)
        for better, worse in PAIRS:
            if {better, worse} <= set(known):
                found.append(_compared(results, masks, better, worse))
        found.append(_best(results, masks))
        found.append(_thresholds(results, masks, "mean"))
        found.append(_study(results, masks, "mean"))
    if {"true", "graph"} <= set(masks_of(results)):
        found.append(_masks(results, "mean"))
    return [sentence for sentence in found if sentence]


def verdict(numbers: Sequence[float]) -> str:
    """By the interval of the mean over scenes.

    >>> verdict([1.0, 2.0, 1.0, 2.0, 1.0]), verdict([-1.0, 1.0, -2.0, 2.0, 0.0]), verdict([1.0, 2.0])
    ('more', 'undecided', 'too few scenes to say')
    """
    if len(numbers) < FEW:
        return "too few scenes to say"
    low, high = metrics.mean_interval(numbers)
    if low > 0:
        return "more"
    return "less" if high < 0 else "undecided"


def _compared(results: Results, masks: str, method: str, base: str) -> str:
    groups: dict[str, list[str]] = {}
    for key in compared(results):
        numbers = gain(results, masks, method, base, key)
        part = f"{COMPARED_WORDS[key]} {said(numbers, signed=True)}"
        groups.setdefault(verdict(numbers), []).append(part)
    parts = (f"*{word}:* {'; '.join(group)}" for word, group in groups.items())
    return f"**{masks} masks, `{method}` minus `{base}`.** {'. '.join(parts)}."


def _best(results: Results, masks: str) -> str:
    parts = []
    for key in compared(results):
        means = {m: metrics.mean(values(results, masks, m, key)) for m in methods_of(results, masks)}
        best = max(means, key=lambda method: means[method])
        parts.append(f"{COMPARED_WORDS[key]} `{best}` {means[best]:.1f}")
    return (
        f"**{masks} masks, highest mean of each column.** {', '.join(parts)}. The highest of many is "
        "partly luck: see the intervals."
    )


def _thresholds(results: Results, masks: str, method: str) -> str:
    if method not in methods_of(results, masks):
        return ""
    threshold, best = tuned(results, masks, method, "lerf-ovs")
    fixed, automatic = (values(results, masks, method, key) for key in ("selection", "automatic"))
    over = difference(best, fixed)
    return (
        f"**{masks} masks, thresholds (`{method}`, selection).** Tuning on the test (at {threshold:.2f}) adds "
        f"{said(over, signed=True)} to the fixed threshold; the automatic one adds "
        f"{said(difference(automatic, fixed), signed=True)} ({verdict(difference(automatic, fixed))})."
    )


def _study(results: Results, masks: str, method: str) -> str:
    found = correlations(records_of(results, masks, method))
    if not found:
        return ""
    a, b = found["weighted"], found["unweighted"]
    follows = "more" if a["pearson"] > b["pearson"] else "not more"
    return (
        f"**{masks} masks, significance (`{method}`).** mIoU weighted by it follows the voxels {follows} closely "
        f"than unweighted (Pearson {a['pearson']:.3f} and {b['pearson']:.3f}, Spearman {a['spearman']:.3f} and "
        f"{b['spearman']:.3f}, {len(records_of(results, masks, method))} scenes)."
    )


def _masks(results: Results, method: str) -> str:
    parts = []
    for key in compared(results):
        lost = difference(*(values(results, masks, method, key) for masks in ("graph", "true")))
        parts.append(f"{COMPARED_WORDS[key]} {said(lost, signed=True)}")
    return f"**Found masks minus true ones (`{method}`).** {'; '.join(parts)}."
