"""Verbs as stages of a scan: their options out of --config, how they go on, and what they answered."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.terminal import counted
from ...errors import DrSplatError, InputError
from ...query.defaults import MAYBE
from .configuring import OPTIONS_NOT_KEPT, Given, did_you_mean, name_of, place, tables_of
from .declaring import Facts, made
from .options import people_text, transients_text, verb_parser
from .tables import place_text, show_facts, show_table, size_text, text_of

if TYPE_CHECKING:
    from ..scanning.display import Display
    from ..scanning.inputs import ScanInput


SETTLED_OPTIONS = ("output", "output-dir", "overwrite", "json", "features", "scene", "views", "export", "ask", "masks")
"""Options that a scan settles itself, so that a file of --config may not."""
OPTIONS_NOT_RECORDED = (*OPTIONS_NOT_KEPT, "threads", "json", "overwrite")
STARTED, DONE = "started", "done"
MAX_MATCHES_LISTED = 5  # of an answer
_FACTS = (
    "query", "count", "num_matches", "num_selected", "measure", "threshold", "score_range", "certainty", "doubt",
)  # fmt: skip


class VerbLine(NamedTuple):
    """A verb's options. given: texts of each use of what was given, by names without dashes."""

    options: Any
    given: dict[str, Any]


def verb_line(
    verb: str, line: Sequence[str], common: Sequence[str], defaults: Mapping[str, str] | None = None
) -> VerbLine:
    """Return what a verb's own parser makes of a line and of the verb's table in --config.

    Args:
        verb: name of the verb, such as register.
        line: what the scan settles, positional arguments first.
        common: --config, --threads and --json of the scan.
        defaults: options and values that count where neither the line nor the file has them.

    Raises: UsageError, InputError: as the verb itself.
    """
    options, uses = _parsed(verb, [*line, *common])
    taken = {use.option.dest for use in uses}
    more = [(f"--{name}", value) for name, value in (defaults or {}).items() if name.replace("-", "_") not in taken]
    if more:
        options, uses = _parsed(verb, [*line, *(text for pair in more for text in pair), *common])
    ours = {text[2:] for text in line if text.startswith("--")} & set(SETTLED_OPTIONS)
    given: dict[str, Any] = {}
    for option, texts in uses:
        name = name_of(option)
        if name and name not in ours and place(option) not in OPTIONS_NOT_RECORDED:
            given.setdefault(name, []).append(texts)
    return VerbLine(options, given)


def _parsed(verb: str, line: Sequence[str]) -> tuple[Any, list[Given]]:
    """Return a verb's options of a line, and what it gives. What a scan replaces, it removes itself."""
    declared = import_module(f".{verb}", __package__).Options
    parser = verb_parser(f"drsplat {verb}", declared)
    values = vars(parser.parse_args(list(line))) | {"overwrite": False}
    return made(declared, values), parser.given


def check_tables(path: str, verbs: Sequence[str]) -> None:
    """Refuse a file of --config that has a table of no stage with a name like one, or settles what a scan settles.

    Raises: InputError.
    """
    for verb, table in tables_of(path).items():
        if not isinstance(table, dict) or verb == "scan":
            continue
        if verb not in verbs:
            if meant := did_you_mean(verb, verbs):
                raise InputError(f"{path}: there is no verb {verb}{meant}")
            continue
        others = {"views"} if verb == "embed" else set()  # there it is a number of photos, no path
        settled = sorted(table.keys() & {*SETTLED_OPTIONS} - others)
        if settled:
            raise InputError(f"{path}: [{verb}] {settled[0]} is settled by drsplat scan: drop it")


@dataclass(eq=False)
class Stage:
    """A verb that is a part of a scan.

    Attributes:
        verb: its name.
        line: its parsed line.
        outputs: what it makes.
        run: makes them, and returns what it answered; goes on where it was stopped.
        found: what it would answer if its outputs are complete already, else None.
    """

    verb: str
    line: VerbLine
    outputs: tuple[Path, ...] = ()
    run: Callable[[Any], Facts] | None = None
    found: Callable[[], Facts | None] = lambda: None

    def make(self) -> Facts:
        """Run the verb. Raises: as the verb; the message begins with its name."""
        run = self.run or import_module(f".{self.verb}", __package__).run
        try:
            answer: Facts = run(self.line.options)
        except KeyboardInterrupt as interrupt:
            interrupt.args = ()  # the scan says how to go on
            raise
        except DrSplatError as error:
            error.args = (f"{self.verb}: {error}",)
            raise
        return answer


def is_done(state: Mapping[str, Any]) -> bool:
    """Return whether a stage has ended."""
    return state.get("state") == DONE


def differences(before: Mapping[str, Any], stages: Sequence[Stage]) -> list[tuple[str, str]]:
    """Return the verb and a sentence for each option that another scan in the same folder had otherwise."""
    found = []
    for stage in stages:
        if stage.verb in before:
            old, new = before[stage.verb]["options"], stage.line.given
            for name in sorted(old.keys() | new.keys()):
                if old.get(name) != new.get(name):
                    was, now = (_options_text(options.get(name)) for options in (old, new))
                    found.append((stage.verb, f"{stage.verb}: {name} was {was}, now {now}"))
    return found


def _options_text(uses: list[list[str]] | None) -> str:
    if uses is None:
        return "not given"
    return " ".join(str(text) for texts in uses for text in texts) or "given"


def run_stages(stages: Sequence[Stage], states: Facts, save: Callable[[], None], display: Display) -> None:
    """Run the stages that are not done, each in the knowledge of `states`, which `save` keeps."""
    for stage in stages:
        state = states.get(stage.verb, {})
        if not is_done(state):
            with display.stage(stage.verb):
                answer = stage.found() if state else None
                if answer is None:
                    if not state:
                        for path in stage.outputs:  # made with other options
                            remove(path)
                        states[stage.verb] = {"options": stage.line.given, "state": STARTED}
                        save()
                    answer = stage.make()
            cost = display.costs[stage.verb]
            states[stage.verb] = {"options": stage.line.given, "state": DONE, **cost._asdict(), "answer": answer}
            save()
        display.say(stage.verb, _ended(stage.verb, states[stage.verb]["answer"]))


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def answered(page: Any, texts: Sequence[str], encoder: Sequence[str], common: Sequence[str]) -> Facts:
    """Ask the queries of a scan as `drsplat locate` does, and write those that have an answer into the page.

    Without queries, words that find something are asked; where nouns are doubted, they open the page. A query that the
    encoder does not know is an answer with its fault, and does not stop the others. page: options of `drsplat view`.
    """
    from ...query.naming import ONLY_COLORS_DOUBT
    from . import view

    answers = [_answer(page.field, text, [*encoder, *common]) for text in texts or _suggested(page)]
    known = [answer for answer in answers if "fault" not in answer]
    is_sound = any(ONLY_COLORS_DOUBT not in answer["doubt"] for answer in known)
    shown = [*([] if is_sound else _suggested(page)), *(answer["query"] for answer in known)]
    made = view.run(replace(page, ask="; ".join(dict.fromkeys(shown))))
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
    from ...query.suggesting import suggestions, words_of

    scene = open_scene(page.field, threads=page.threads, **vars(page.encoders))
    return suggestions(scene) or list(words_of(scene))[:1]


def _ended(verb: str, answer: Facts) -> str:
    """Return what is said when a stage has ended."""
    match verb:
        case "capture":
            return f"{answer['num_registered']:,} of {counted(answer['num_photos'], 'photo')} have a pose"
        case "train":
            psnr = answer["psnr_test"]
            held_out = "" if psnr is None else f", PSNR {psnr:.2f} dB in photos that were held out"
            return f"{counted(answer['num_gaussians'], 'Gaussian')}{held_out}"
        case "embed":
            one = answer["pictures"].removesuffix("s")
            return f"{counted(answer['num_masks'], 'mask')} in {counted(answer['num_photos'], one)}"
        case "register":
            return f"{answer['num_registered']:,} of {counted(answer['num_gaussians'], 'Gaussian')} can be asked"
        case "objects":
            return f"{counted(answer['num_agreed'], 'object')} that {answer['pictures']} agree on"
    return f"{counted(len(answer['answers']), 'query', 'queries')} answered in the page"


def summary(states: Facts, source: ScanInput) -> Facts:
    """Return the numbers of all stages."""
    stages = {verb: state["answer"] for verb, state in states.items()}
    posed = stages.get("capture", {"num_photos": source.num_photos, "num_registered": source.num_photos})
    train, objects = stages["train"], stages["objects"]
    return {
        "num_photos": posed["num_photos"],
        "pictures": stages["register"]["pictures"],
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


def notes(states: Facts, is_doubted: bool) -> list[str]:
    """Return sentences about what was left out, and about what to doubt unless that has been said."""
    stages = {verb: state["answer"] for verb, state in states.items()}
    said: list[str] = []
    posed = stages.get("capture", {})
    if without := posed.get("left_out"):
        have = "has" if len(without) == 1 else "have"
        said.append(f"{len(without):,} of {posed['num_photos']:,} photos {have} no pose (left_out says why).")
    if posed.get("num_with_people"):
        said.append(_sentence(people_text(posed["num_with_people"], posed["num_registered"])))
    if moved := stages["train"].get("num_views_with_transients"):
        said.append(_sentence(transients_text(moved, stages["train"]["num_views"])))
    if stages["train"]["held_out_far_below"]:
        said.append(
            "Photos that were held out look far worse than those trained on: the photos overlap too little, or poses "
            "are wrong."
        )
    if stages["objects"]["doubt"] and not is_doubted:
        said.append(_sentence(stages["objects"]["doubt"]))
    return said


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def show_answer(answer: Facts) -> None:
    """Print what a scan has made, for people."""
    from ...query.naming import ONLY_COLORS_DOUBT

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
        rows = [(one["name"], one["reason"]) for one in answer["left_out"]]
        show_table("Photos without a pose", ("photo", "why"), rows)
    said = {ONLY_COLORS_DOUBT}  # by one of the notes
    for note in answer["notes"]:
        print(note)
    for one in answer["answers"]:
        doubts = [text for text in one.get("doubt", "").split(". ") if text and text not in said]
        said.update(doubts)
        print(*map(_sentence, doubts), f"{one['query']}: {_answer_text(one)}", sep="\n")
    print(f"Open {answer['page']} in a browser. To search it live: {answer['view']}")


def _answer_text(one: Facts) -> str:
    if "fault" in one:
        return f"not asked: {one['fault']}"
    places = [place_text(match["center"]) for match in one["matches"]]
    where = f" at {'; '.join(places)}" if places else ""
    maybe = "maybe " if one["certainty"] == MAYBE else ""
    return f"{maybe}{counted(one['num_matches'], 'match', 'matches')}{where}"
