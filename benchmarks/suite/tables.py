"""The tables of the page, in Markdown."""

from collections.abc import Sequence

from .numbers import MEASURES, Results, by_scene, correlations, measured, methods_of, records_of, said, tuned, values

SELECTION = ("selection", "seen", "acc25", "acc50", "automatic", "seen_automatic", "selection_tuned", "localization")
SEGMENTATION = ("volume", "points", "voxel", "volume_fixed", "volume_automatic", "volume_tuned")
COMPARED = ("selection", "seen", "automatic", "selection_tuned", "volume", "points", "voxel")
WORDS = {key: measure.words for key, measure in MEASURES.items()} | {
    "selection_tuned": "mIoU, tuned on test", "volume_tuned": "tuned on test",
}  # fmt: skip
COMPARED_WORDS = {
    "selection": "selection, fixed", "seen": "seen, fixed", "automatic": "selection, automatic",
    "selection_tuned": "selection, tuned on test", "volume": "volume", "points": "points", "voxel": "voxel",
}  # fmt: skip


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; the first column is of names.

    >>> print(markdown(("a", "b"), [("x", "1")]))
    | a | b |
    |---|--:|
    | x | 1 |
    """
    lines = [columns, ("---", *("--:" for _ in columns[1:]))]
    head = [f"| {' | '.join(lines[0])} |", f"|{'|'.join(lines[1])}|"]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def scenes_table(results: Results) -> str:
    keys = ("things", "photos", "labelled_photos", "pairs", "gaussians", "points")
    words = ("things", "photos", "labelled photos", "pairs", "Gaussians", "labelled points")
    rows = [
        (name, str(scene["seed"]), scene["cameras"], *(f"{scene[key]:,}" for key in keys))
        for name, scene in results["scenes"].items()
    ]
    return markdown(("scene", "seed", "cameras", *words), rows)


def measures_table(results: Results, masks: str, keys: Sequence[str]) -> str:
    keys = [key for key in keys if measured(results, key)]
    rows = [
        (f"`{method}`", *(said(values(results, masks, method, key)) for key in keys))
        for method in methods_of(results, masks)
    ]
    return markdown(("method", *(WORDS[key] for key in keys)), rows)


def against_table(results: Results, masks: str, base: str) -> str:
    """Each method minus one of them, scene by scene."""
    rows, keys = [], compared(results)
    for method in methods_of(results, masks):
        if method != base:
            cells = [said(gain(results, masks, method, base, key), signed=True) for key in keys]
            rows.append((f"`{method}`", *cells))
    return markdown(("method", *(COMPARED_WORDS[key] for key in keys)), rows)


def compared(results: Results) -> list[str]:
    """What methods are compared in, as far as the run measured it."""
    return [key for key in COMPARED if measured(results, key)]


def gain(results: Results, masks: str, method: str, base: str, key: str) -> list[float]:
    """Scene by scene, in those scenes that both were run in."""
    one, other = (by_scene(results, masks, name, key) for name in (method, base))
    return [one[scene] - other[scene] for scene in one if scene in other]


def thresholds_table(results: Results, masks: Sequence[str]) -> str:
    """Which threshold was tuned on the test."""
    rows = []
    for method in dict.fromkeys(method for kind in masks for method in methods_of(results, kind)):
        found = [
            f"{tuned(results, kind, method, protocol)[0]:.2f}" if method in methods_of(results, kind) else ""
            for kind in masks
            for protocol in ("lerf-ovs", "scannet-volume")
        ]
        rows.append((f"`{method}`", *found))
    columns = [f"{kind}: {p}" for kind in masks for p in ("lerf-ovs", "scannet-volume")]
    return markdown(("method", *columns), rows)


def study_table(results: Results, masks: str, method: str) -> str:
    """Fig. S3 of one method."""
    rows = []
    for record in records_of(results, masks, method):
        row = record["voxel"]["study"]
        rows.append((row["scene"], *(f"{100 * row[k]:.1f}" for k in ("voxel", "weighted", "unweighted"))))
    for name in ("pearson", "spearman"):
        found = correlations(records_of(results, masks, method))
        if found:
            pair = (f"{found[kind][name]:.3f}" for kind in ("weighted", "unweighted"))
            rows.append((f"{name.capitalize()} with voxels", "", *pair))
    return markdown(("scene", "voxels", "with significance", "without"), rows)


def files_table(results: Results) -> str:
    rows = [
        (
            name,
            *(f"`{digest}`" for file, digest in scene["files"].items() if file.endswith(".ply")),
            f"`{scene['photos_and_truth']}`",
        )
        for name, scene in results["scenes"].items()
    ]
    return markdown(("scene", "Gaussians", "labelled points", "photos, poses, ids"), rows)
