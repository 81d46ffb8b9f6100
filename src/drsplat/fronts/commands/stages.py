"""Verbs as stages of a scan: their options out of --config, how they go on, and what they answered."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...errors import DrSplatError, InputError
from .configuring import OPTIONS_NOT_KEPT, Given, place, table_keys
from .declaring import Facts, made
from .help_texts import did_you_mean
from .options import verb_parser

if TYPE_CHECKING:
    from ..scanning.display import Display

SETTLED_OPTIONS = ("output", "output-dir", "overwrite", "json", "features", "scene", "views", "export", "ask", "masks")
"""Options that a scan settles itself, so that a file of --config may not."""
OPTIONS_NOT_RECORDED = (*OPTIONS_NOT_KEPT, "threads", "json")
STARTED, DONE = "started", "done"


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
    for use in uses:
        flags = [flag[2:] for flag in use.option.option_strings if flag.startswith("--")]
        if (
            flags
            and not ours & set(flags)
            and place(use.option) not in OPTIONS_NOT_RECORDED
            and use.option.dest != "overwrite"
        ):
            given.setdefault(flags[0], []).append(use.texts)
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
    for verb, keys in table_keys(path).items():
        meant = did_you_mean(verb, verbs)
        if verb not in verbs and meant:
            raise InputError(f"{path}: there is no verb {verb}{meant}")
        others = {"views"} if verb == "embed" else set()  # there it is a number of photos, no path
        settled = sorted(keys & set(SETTLED_OPTIONS) - others) if verb in verbs and verb != "scan" else []
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

    def remove(self) -> None:
        """Remove what is there of its outputs, made with other options."""
        for path in self.outputs:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


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
                    found.append(
                        (
                            stage.verb,
                            f"{stage.verb}: {name} was {_options_text(old, name)}, now {_options_text(new, name)}",
                        )
                    )
    return found


def _options_text(options: Mapping[str, Any], name: str) -> str:
    uses = options.get(name)
    if not uses:
        return "not given"
    return " ".join(str(text) for texts in uses for text in texts) or "given"


def run_stages(
    stages: Sequence[Stage], states: Facts, save: Callable[[], None], display: Display,
    ended: Callable[[str, Facts], str],
) -> None:  # fmt: skip
    """Run the stages that are not done, each in the knowledge of `states`, which `save` keeps.

    ended: returns what is said of a stage that has ended, from its answer.
    """
    for stage in stages:
        state = states.get(stage.verb, {})
        if not is_done(state):
            with display.stage(stage.verb):
                answer = stage.found() if state else None
                if answer is None:
                    if not state:
                        stage.remove()
                        states[stage.verb] = {"options": stage.line.given, "state": STARTED}
                        save()
                    answer = stage.make()
            cost = display.costs[stage.verb]
            states[stage.verb] = {"options": stage.line.given, "state": DONE, **cost._asdict(), "answer": answer}
            save()
        display.say(stage.verb, ended(stage.verb, states[stage.verb]["answer"]))
