"""The tables of the page, in Markdown."""

from collections.abc import Sequence

from .numbers import Results, by_scene, correlations, masks_of, methods_of, records_of, said, values

COMPARED = {
    "automatic": "selection",
    "volume": "volume", "points": "points", "voxel": "voxel",
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


def methods_table(results: Results, masks: str, base: str) -> str:
    """Return the numbers of one method and the difference of each other from it, scene by scene.

    Without that method, all rows are numbers.
    """
    rows, methods = [], methods_of(results, masks)
    for method in methods:
        minus = base in methods and method != base
        cells = [
            said(gain(results, masks, method, base, key), signed=True)
            if minus
            else said(values(results, masks, method, key))
            for key in COMPARED
        ]
        rows.append((f"`{method}`", *cells))
    return markdown(("method", *COMPARED.values()), rows)


def gain(results: Results, masks: str, method: str, base: str, key: str) -> list[float]:
    """Scene by scene, in those scenes that both were run in."""
    one, other = (by_scene(results, masks, name, key) for name in (method, base))
    return [one[scene] - other[scene] for scene in one if scene in other]


def study_table(results: Results, method: str) -> str:
    """Return the correlations of Fig. S3 of one method by masks, "" where there are none."""
    rows = []
    for masks in masks_of(results):
        found = correlations(records_of(results, masks, method))
        for name in ("pearson", "spearman") if found else ():
            pair = (f"{found[kind][name]:.3f}" for kind in ("weighted", "unweighted"))
            rows.append((f"{masks}, {name.capitalize()}", *pair))
    return markdown(("masks", "with significance", "without"), rows) if rows else ""
