"""Answers of a scan: queries and their matches, numbers of all stages, and both for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted
from ...errors import DrSplatError
from ...query.defaults import MAYBE
from .declaring import Facts
from .stages import verb_line

if TYPE_CHECKING:
    from ..scanning.inputs import ScanInput

MAX_MATCHES_LISTED = 5  # of an answer
_FACTS = (
    "query", "count", "num_matches", "num_selected", "measure", "threshold", "score_range", "certainty", "doubt",
)  # fmt: skip


def answered(page: Any, texts: Sequence[str], encoder: Sequence[str], common: Sequence[str]) -> Facts:
    """Ask the queries of a scan as `drsplat locate` does, and write those that have an answer into the page.

    Without queries, words that find something are asked. A query that the encoder does not know is an answer with its
    fault, and does not stop the others. page: options of `drsplat view`.
    """
    from . import view

    answers = [_answer(page.field, text, [*encoder, *common]) for text in texts or _suggested(page)]
    known = [answer["query"] for answer in answers if "fault" not in answer] or _suggested(page)
    made = view.run(replace(page, ask="; ".join(known)))
    return {"answers": answers, "num_shown": made["num_shown"], "bytes": made["bytes"]}


def _answer(folder: str, text: str, options: Sequence[str]) -> Facts:
    from . import locate

    try:
        found = locate.run(verb_line("locate", [folder, text], options).options)
    except DrSplatError as error:
        return {"query": text, "fault": str(error)}
    matches = [
        {**match, "support": list(dict.fromkeys(one["view"] for one in match["support"]))}
        for match in found["matches"][:MAX_MATCHES_LISTED]
    ]
    return {**{name: found[name] for name in _FACTS}, "matches": matches}


def _suggested(page: Any) -> list[str]:
    """Return words that find something in the scene, else one that the encoder knows."""
    from ... import open_scene
    from ..viewing.naming import suggestions, words_of

    scene = open_scene(page.field, threads=page.threads, **vars(page.encoders))
    return suggestions(scene) or list(words_of(scene))[:1]


def ended(verb: str, answer: Facts) -> str:
    """Return what is said when a stage has ended."""

    if verb == "capture":
        return f"{answer['num_registered']:,} of {counted(answer['num_photos'], 'photo')} have a pose"
    if verb == "train":
        psnr = answer["psnr_test"]
        held_out = "" if psnr is None else f", PSNR {psnr:.2f} dB in photos that were held out"
        return f"{counted(answer['num_gaussians'], 'Gaussian')}{held_out}"
    if verb == "embed":
        one = _pictures(answer).removesuffix("s")
        return f"{counted(answer['num_masks'], 'mask')} in {counted(answer['num_photos'], one)}"
    if verb == "register":
        return f"{answer['num_registered']:,} of {counted(answer['num_gaussians'], 'Gaussian')} can be asked"
    if verb == "objects":
        return f"{counted(answer['num_agreed'], 'object')} that {_pictures(answer)} agree on"
    return f"{counted(len(answer['answers']), 'query', 'queries')} answered in the page"


def summary(states: Facts, source: ScanInput) -> Facts:
    """Return the numbers of all stages."""
    stages = {verb: state["answer"] for verb, state in states.items()}
    posed = stages.get("capture", {"num_photos": source.num_photos, "num_registered": source.num_photos})
    train, objects = stages["train"], stages["objects"]
    return {
        "num_photos": posed["num_photos"],
        "pictures": _pictures(stages["register"]),
        "num_registered": posed["num_registered"],
        "psnr_test": train["psnr_test"],
        "num_gaussians": train["num_gaussians"],
        "num_masks": stages["embed"]["num_masks"],
        "num_objects": objects["num_agreed"],
        "num_unsure_objects": objects["num_objects"] - objects["num_agreed"],
        "left_out": posed.get("left_out", []),
        "answers": stages["view"]["answers"],
        "stage_seconds": {verb: state["seconds"] for verb, state in states.items()},
        "stage_cpu_seconds": {verb: state["cpu_seconds"] for verb, state in states.items()},
        "seconds": sum(state["seconds"] for state in states.values()),
    }


def _pictures(answer: Facts) -> str:
    """Return what a stage looked at; stages of older versions knew photos only."""
    return str(answer.get("pictures", "photos"))


def notes(states: Facts) -> list[str]:
    """Return sentences about what was left out, and about what to doubt."""
    stages = {verb: state["answer"] for verb, state in states.items()}
    said = []
    without = stages.get("capture", {}).get("left_out", [])
    if without:
        said.append(f"{len(without):,} of {stages['capture']['num_photos']:,} photos have no pose (left_out says why).")
    if stages["train"]["held_out_far_below"]:
        said.append(
            "Photos that were held out look far worse than those trained on: the photos overlap too little, or poses "
            "are wrong."
        )
    if stages["objects"]["doubt"]:
        doubt: str = stages["objects"]["doubt"]
        said.append(doubt[0].upper() + doubt[1:] + ".")
    return said


def show_answer(answer: Facts) -> None:
    """Print what a scan has made, for people."""
    from .tables import show_facts, show_table, size_text, text_of

    psnr = answer["psnr_test"]
    seconds = ", ".join(f"{verb} {spent:.0f}" for verb, spent in answer["stage_seconds"].items())
    show_facts(
        f"scanned: {answer['output']}",
        {
            "posed": f"{text_of(answer['num_registered'])} of {text_of(answer['num_photos'])} {answer['pictures']}",
            "held out": "nothing" if psnr is None else f"PSNR {psnr:.2f} dB",
            "Gaussians": answer["num_gaussians"],
            "masks": answer["num_masks"],
            "objects": f"{text_of(answer['num_objects'])}, and {text_of(answer['num_unsure_objects'])} less sure",
            "time": f"{answer['seconds']:.0f} s ({seconds})",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )
    if answer["left_out"]:
        show_table(
            "Photos without a pose", ("photo", "why"), [(one["name"], one["reason"]) for one in answer["left_out"]]
        )
    for one in answer["answers"]:
        print(f"{one['query']}: {_answer_text(one)}")
    for note in answer["notes"]:
        print(note)
    print(f"Open {Path(answer['page'])} in a browser. To search it live: {answer['view']}")


def _answer_text(one: Facts) -> str:

    if "fault" in one:
        return f"not asked: {one['fault']}"
    places = [" ".join(f"{x:.2f}" for x in match["center"]) for match in one["matches"]]
    where = f" at {'; '.join(places)}" if places else ""
    maybe = "maybe " if one["certainty"] == MAYBE else ""
    return f"{maybe}{counted(one['num_matches'], 'match', 'matches')}{where}"
