"""The picture and the tables that the page begins with."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from drsplat.evaluation import scorers

from .answers import ASKED, CAPTURE, COLUMNS, ROOM
from .chart import Bar, Group, grouped_bars
from .numbers import Results, difference, masks_of, methods_of, over_places, records_of, said, values, within
from .rendered import RENDERED
from .rivals import LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN
from .tables import markdown

Answers = Mapping[str, Any]

PLACES = {CAPTURE: "real captures", ROOM: "made-up rooms"}
HEADS = {"plain": "Gaussians alone (plain)", "objects": "whole objects (the default)", "best": "best threshold"}
BUILT_IN = ("official", "objects")
"""The plain method and objects, as the built-in encoder is asked with both."""
SYSTEMS = {
    "objects": "drsplat, whole objects", "mean": "drsplat, plain", "official": "Dr. Splat, as published",
    "centre-pixel": "Occam's LGS", "vala": "VALA", "vala-scannet": "VALA, for ScanNet",
    LANGSPLAT: "LangSplat-m", LEGAUSSIANS: "LEGaussians-m", OPENGAUSSIAN: "OpenGaussian",
    RENDERED: "features fitted to renderings",
}  # fmt: skip
COMPARED = {"automatic": "selection", "localization": "localization", "volume": "classes"}


class Asked(NamedTuple):
    """Records of answers in places of one kind with one kind of masks."""

    kind: str
    masks: str
    words: int
    records: list[dict[str, Any]]

    def each(self, column: str) -> list[list[float]]:
        """By place, percent for each word that was asked for."""
        return [[100 * value for value in record[column]] for record in self.records]

    @property
    def texts(self) -> list[list[str]]:
        return [record["texts"] for record in self.records]

    def over(self, column: str) -> tuple[float, float, float]:
        """Return the mean over places and its interval, as `over_places`."""
        return over_places(self.each(column), self.texts)

    def gain(self, column: str, base: str) -> tuple[float, float, float]:
        """Return the same of what a column has more than another, word by word."""
        pairs = zip(self.each(column), self.each(base), strict=True)
        return over_places([difference(a, b) for a, b in pairs], self.texts)

    @property
    def by_place(self) -> "list[Asked]":
        return [self._replace(records=[record]) for record in self.records]

    def share(self, what: str, column: str) -> float:
        """Percent of the words that were missed, or found though absent: the mean over places."""
        return 100 * scorers.mean([record[what][column] for record in self.records])


def asked(answers: Answers) -> list[Asked]:
    """Captures first, and the masks that people have first."""
    groups: dict[tuple[bool, bool, int, str], list[dict[str, Any]]] = {}
    for record in answers["records"]:
        key = (record["masks"] != "graph", record["kind"] != CAPTURE, record["words"], record["masks"])
        groups.setdefault(key, []).append(record)
    return [Asked(records[0]["kind"], key[3], key[2], records) for key, records in sorted(groups.items())]


def picture(answers: Answers) -> str:
    """Return SVG: bars for each place, and for the mean over the places, with the masks that people have."""
    sections = []
    for one in asked(answers):
        if one.masks == "graph":
            mean = Group("mean", _bars(one), strong=True)
            each = [Group(place.records[0]["place"], _bars(place)) for place in one.by_place]
            sections.append((f"{len(each)} {PLACES[one.kind]}", [mean, *each]))
    return grouped_bars("How well answers overlap what is meant (IoU, percent)", list(HEADS.values()), sections)


def _bars(one: Asked) -> list[Bar]:
    return [Bar(*one.over(column)) for column in COLUMNS]


def headline_table(results: Results, answers: Answers | None) -> str:
    """Rows of places, encoder and masks; answers of CLIP's vectors are missing where none were made."""
    rows = [_row_of_words(one, answers or {}) for one in asked(answers)] if answers else []
    for masks in sorted(masks_of(results), key=lambda masks: masks != "graph"):
        if set(BUILT_IN) <= set(methods_of(results, masks)):
            cells = [said(values(results, masks, method, "automatic")) for method in BUILT_IN]
            where = f"{len(records_of(results, masks, 'objects'))} {PLACES[ROOM]}, the built-in encoder"
            rows.append((where, _masks_said(masks, results), *cells, "", "", ""))
    heads = ("words asked in", "masks", *HEADS.values(), "found nothing", "absent words found")
    return markdown(heads, sorted(rows, key=lambda row: not row[1].startswith("`graph`")))


def _row_of_words(one: Asked, answers: Answers) -> tuple[str, ...]:
    where = f"{len(one.records)} {PLACES[one.kind]}, CLIP's vectors, {one.words} words"
    return where, _masks_said(one.masks, answers), *_cells(one)


def _cells(one: Asked) -> list[str]:
    """IoU by column, then what was missed and what was found though absent."""
    shares = [", ".join(f"{one.share(what, column):.0f}" for column in ASKED) for what in ("missed", "found")]
    return [*(within(*one.over(column)) for column in COLUMNS), *shares]


def _masks_said(masks: str, made: Mapping[str, Any]) -> str:
    return (
        f"`graph`, version {made['segmenter']['version']}"
        if masks == "graph"
        else {"sam": "simulated"}.get(masks, masks)
    )


def places_table(answers: Answers) -> str:
    """Return the table of every place: means, and the interval of what objects gain, word by word."""
    rows = []
    for one in (place for group in asked(answers) for place in group.by_place):
        record = one.records[0]
        asked_for = f"{len(set(record['texts']))}, {len(record['texts'])} times"
        gain = within(*one.gain("objects", "plain"), signed=True)
        means = (f"{one.over(column)[0]:.1f}" for column in COLUMNS)
        rows.append((record["place"], one.masks, asked_for, *means, gain, *_cells(one)[3:]))
    heads = (
        "place",
        "masks",
        "words asked",
        *HEADS.values(),
        "objects minus plain",
        "found nothing",
        "absent words found",
    )
    return markdown(heads, rows)


def systems_table(results: Results) -> str:
    """Every system by itself, on the masks that it was run on."""
    kinds = sorted(masks_of(results), key=lambda masks: masks != "graph")
    heads = [f"{_masks_said(masks, results)}: {words}" for masks in kinds for words in COMPARED.values()]
    rows = []
    for method, name in SYSTEMS.items():
        if any(method in methods_of(results, masks) for masks in kinds):
            cells = (
                said(values(results, masks, method, key)) if method in methods_of(results, masks) else ""
                for masks in kinds
                for key in COMPARED
            )
            rows.append((f"{name} (`{method}`)", *cells))
    return markdown(("system", *heads), rows)
