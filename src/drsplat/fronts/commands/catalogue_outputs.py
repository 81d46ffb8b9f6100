"""Output of `drsplat catalogue`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ...base.terminal import counted
from .tables import show_table, text_of

STATES = {
    "current": "", "changed": "its field is another now: add it again", "missing": "nothing is there any more",
    "unknown": "not from a folder",
}  # fmt: skip


def _show_add(answer: dict[str, Any]) -> None:
    for one in answer["scenes"]:
        agreed = (
            f", {text_of(one['num_agreed'])} that photos agree on" if one["num_agreed"] < one["num_objects"] else ""
        )
        print(f"added '{one['scene']}': {counted(one['num_objects'], 'object')}{agreed}")
    print(f"{answer['catalogue']} has {counted(answer['num_objects'], 'object')}")
    if answer["wants_index"]:
        print(f"Every query compares all of them: drsplat catalogue index {answer['catalogue']}")


def _show_remove(answer: dict[str, Any]) -> None:
    for name, number in answer["removed"].items():
        if number is None:
            print(f"'{name}' was removed before")
        else:
            print(f"removed '{name}': {counted(number, 'object')}")
    print(f"{answer['catalogue']} has {counted(answer['num_objects'], 'object')}")


def _show_list(answer: dict[str, Any]) -> None:
    number = counted(len(answer["scenes"]), "scene")
    title = f"{number}, {counted(answer['num_objects'], 'object')}; words by {answer['encoder']}"
    rows = [
        (
            one["scene"],
            text_of(one["num_objects"]),
            text_of(one["num_agreed"]),
            one["added"],
            STATES[one["state"]],
            one["folder"],
        )
        for one in answer["scenes"]
    ]
    show_table(title, ("scene", "objects", "agreed on", "added", "state", "folder"), rows)


def _show_ask(answer: dict[str, Any]) -> None:
    compared = counted(answer["num_compared"], "object")
    how = f"{answer['measure']}, threshold {answer['threshold']:.4g}; {compared} compared"
    show_table(
        f"{counted(answer['num_matches'], 'match', 'matches')} for “{answer['query']}” by {how}",
        ("scene", "object", "name", "score", "centre", "extent", "photo"),
        [_row(one) for one in answer["matches"]],
    )
    if not answer["num_compared"]:
        print("Nothing was compared: --scene, --box, --area and --since leave no object; `list` tells the scenes.")
    elif not answer["matches"]:
        print("No object of any scene answers this: try other words, or a lower --threshold.")
    if answer["picture"]:
        print(f"written to {answer['picture']}")


def _row(one: dict[str, Any]) -> tuple[str, ...]:
    places = (" ".join(f"{x:.2f}" for x in one[key]) for key in ("center", "extent"))
    name, photo = one["label"] or one["name"] or "", one["photo"] or ""
    return one["scene"], str(one["object_id"]), name, f"{one['score']:.3f}", *places, photo


def _show_index(answer: dict[str, Any]) -> None:
    print(f"indexed {counted(answer['num_objects'], 'object')}")


SHOWN: Mapping[str, Callable[[dict[str, Any]], None]] = {
    "add": _show_add, "remove": _show_remove, "list": _show_list, "ask": _show_ask, "index": _show_index,
}  # fmt: skip
