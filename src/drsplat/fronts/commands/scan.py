"""drsplat scan: photos, a video or a capture -> a scene that answers words, and a page of it."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .options import count, words
from .scan_answers import ended, notes, show_answer, summary
from .scan_stages import FIELD, PAGE, Plan, planned
from .stages import check_tables, differences, is_done, run_stages
from .train import EVERYDAY_ITERATIONS

if TYPE_CHECKING:
    from ..scanning.inputs import ScanInput

EXAMPLES = """\
  drsplat scan walk.mp4 --output room
  drsplat scan photos --output room --ask "red mug; blue plate"
  drsplat scan capture --output room --iterations 2000 --segmenter graph --encoder drsplat-mini
  drsplat scan photos --output room --config scan.toml --json
  drsplat locate room "red mug"           (afterwards)
  drsplat view room                       (afterwards, in a browser)

A capture is a folder of posed photos, as `drsplat capture` and other programs write it. To resume a stopped run,
give the same command again. Each stage is a verb (capture, train, embed, register, objects, view) and takes its
options from its table in --config. Poses need COLMAP's package: pip install "drsplat[capture]"."""
DAILY = ("output", "ask", "iterations", "segmenter", "encoder", "overwrite", "config")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", help="folder of photos, a video, or posed photos (a capture)")
    parser.add_argument(
        "--output", "-o", metavar="DIR", help="folder for all results (default: ./NAME-scan, with the input's name)"
    )
    parser.add_argument(
        "--ask", type=words, action="append", default=[], metavar="TEXT",
        help='query that the page answers; for several, "mug; lamp" or repeat the option (default: words that find '
        "something)",
    )  # fmt: skip
    parser.add_argument(
        "--iterations", type=count, metavar="N",
        help=f"iterations of training (default: {EVERYDAY_ITERATIONS})",
    )  # fmt: skip
    parser.add_argument(
        "--segmenter", type=words, metavar="NAME",
        help="model that cuts the photos into masks, as in drsplat embed (default: auto, SAM if it is installed and "
        "its weights are available, else graph)",
    )  # fmt: skip
    parser.add_argument(
        "--encoder", type=words, metavar="NAME",
        help="model that embeds the masks, as in drsplat embed (default: auto, CLIP if it is installed and its weights "
        "are available, else drsplat-mini)",
    )  # fmt: skip
    parser.add_argument(
        "--overwrite", action="store_true",
        help="redo the stages that changed photos or options affect, and keep the rest (default: refuse)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.claiming import claimed_folder
    from ..scanning.inputs import scan_input

    source = scan_input(Path(arguments.input))
    output = _output(arguments)
    if arguments.config:
        check_tables(arguments.config, STAGE_VERBS)
    _refuse_strangers(output, source)
    with claimed_folder(output):
        return _scan(arguments, source, output)


STAGE_VERBS = ("scan", "capture", "train", "embed", "register", "objects", "locate", "view")


def _scan(arguments: argparse.Namespace, source: ScanInput, output: Path) -> dict[str, Any]:
    from ...base.system import peak_memory_bytes
    from ...formats.scan_record import read_scan_record, write_scan_record
    from ..scanning.display import Display

    before = read_scan_record(output)
    plan = planned(arguments, source, output, before)
    states = _states(before, plan, source, output, arguments.overwrite)
    record = {"input": source.document(), "capture": plan.capture, "models": plan.models, "stages": states}
    write_scan_record(output, record)
    display = Display(plan.expected, quiet=arguments.json)
    for text in plan.sentences:
        display.tell(text)
    run_stages(plan.stages, states, lambda: write_scan_record(output, record), display, ended)
    return {
        "output": str(output),
        "scene": str(output / "model"),
        "field": str(output / FIELD),
        "page": str(output / PAGE),
        "capture": str(output / plan.capture),
        "view": shlex.join(["drsplat", "view", str(output), *plan.encoder_option]),
        "models": plan.models,
        **summary(states, source),
        "notes": [*plan.sentences, *notes(states)],
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _output(arguments: argparse.Namespace) -> Path:
    """Return the folder of --output; the one that it stands for by default is named in all messages."""
    if arguments.output is None:
        arguments.output = f"{Path(arguments.input).resolve().stem}-scan"
    return Path(arguments.output)


def _refuse_strangers(output: Path, source: ScanInput) -> None:
    """Check input and output.

    Raises: InputError: the output holds files that no scan made, or is the capture itself; a path that is not UTF-8.
    """
    from ...errors import InputError
    from ...formats.claiming import LOCK
    from ...formats.json_files import is_text
    from ...formats.scan_record import RECORD

    for path in (source.path, output):
        if not is_text(str(path.resolve())):
            raise InputError(f"{path}: expected a path in UTF-8, as {RECORD} names it: rename the folder")
    if source.path.resolve() == output.resolve():
        raise InputError(f"{output} is what is scanned: name another output")
    if output.is_dir() and not (output / RECORD).is_file():
        others = sorted(path.name for path in output.iterdir() if path.name != LOCK and not path.name.endswith(".tmp"))
        if others:
            raise InputError(f"{output} holds {others[0]}, which drsplat scan did not make: name another output")


def _states(
    before: dict[str, Any] | None, plan: Plan, source: ScanInput, output: Path, overwrite: bool
) -> dict[str, Any]:  # fmt: skip
    """Return the stages of an earlier scan that stay.

    Raises: InputError: it was of other photos, or had other options, and not `overwrite`.
    """
    from ...errors import InputError

    if before is None or (before["stages"].keys() <= {"capture"} and not any(map(is_done, before["stages"].values()))):
        return before["stages"] if before else {}  # what `capture` began it goes on with, also of other photos
    verbs = [stage.verb for stage in plan.stages]
    changed = differences(before["stages"], [stage for stage in plan.stages if stage.verb != "view"])
    if any(before["input"].get(key) != value for key, value in source.document().items() if key != "path"):
        was = f"{before['input'].get('kind')} {before['input'].get('path')}"
        changed.insert(0, (verbs[0], f"it was of {was}, which was another input, or its photos have changed since"))
    if changed and not overwrite:
        raise InputError(
            f"{output} holds another scan: {'; '.join(text for _, text in changed)}. Pass overwrite=True to make anew "
            "what this changes, or name another output"
        )
    kept = [verb for verb in verbs if verb in before["stages"]]
    if changed:
        kept = kept[: min(verbs.index(verb) for verb, _ in changed)]
    asked = before["stages"].get("view", {}).get("options")
    if asked != plan.stages[-1].line.options:
        kept = [verb for verb in kept if verb != "view"]
    return {verb: before["stages"][verb] for verb in kept}


def interrupted(arguments: argparse.Namespace) -> str:
    """Return what a stopped run keeps, and how to go on."""
    return f"what is done is kept in {arguments.output}: give the same command again to go on"


def show(answer: dict[str, Any]) -> None:
    show_answer(answer)
