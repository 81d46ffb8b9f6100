"""drsplat scan: photos, a video or a capture -> a scene that answers words, and a page of it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.system import peak_memory_bytes
from ...errors import InputError
from .declaring import Facts, argument, count, declaration, flag, option, words
from .options import Verb, keep_people, parts_of
from .stages import (
    Stage,
    VerbLine,
    answered,
    check_tables,
    differences,
    is_done,
    notes,
    remove,
    run_stages,
    show_answer,
    summary,
    verb_line,
)
from .train import EVERYDAY_ITERATIONS

if TYPE_CHECKING:
    from ..scanning.choosing import ModelChoice
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
options from its table in --config. Poses need COLMAP's package: `drsplat doctor` says how to install it."""
FIELD, FEATURES, PAGE = "scene.field", "features", "index.html"
CPU_SIDE_PIXELS = 800  # longer side of photos that a CPU trains on
DEFAULT_VIDEO_PHOTOS = 100  # until the frames of a video are chosen
SECONDS_PER_PHOTO = {"capture": 0.8, "train": 0.03, "embed": 0.3, "register": 0.1}
"""Seconds a photo, in training an iteration, on two cores: the first guess of the time that is left."""
GRAPH, VOTE_SECONDS_PER_PHOTO = "graph", 0.4  # the built-in segmenter, whose pieces photos join
SAM_SECONDS_PER_PHOTO = 8.0
STAGE_VERBS = ("scan", "capture", "train", "embed", "register", "objects", "locate", "view")
DAILY = "output ask iterations segmenter encoder keep_people overwrite config"


@declaration
class Options(Verb):
    """Options of this verb."""

    input: str = argument("folder of photos, a video, or posed photos (a capture)")
    output: str | None = option(
        "folder for all results (default: ./NAME-scan, with the input's name)", "DIR", flags="-o"
    )  # fmt: skip
    ask: list[str] = option(
        'query that the page answers; for several, "mug; lamp" or repeat the option (default: words that find '
        "something)", "TEXT", words, [], action="append",
    )  # fmt: skip
    iterations: int | None = option(
        f"iterations of training (default: {EVERYDAY_ITERATIONS})", "N", count
    )  # fmt: skip
    segmenter: str | None = option(
        "model that cuts the photos into masks, as in drsplat embed (default: auto, SAM if it is installed and its "
        "weights are available, else graph)", "NAME", words,
    )  # fmt: skip
    encoder: str | None = option(
        "model that embeds the masks, as in drsplat embed (default: auto, CLIP if it is installed and its weights are "
        "available, else drsplat-mini)", "NAME", words,
    )  # fmt: skip
    keep_people: bool = keep_people()
    overwrite: bool = flag("redo the stages that changed photos or options affect, and keep the rest (default: refuse)")

    @property
    def folder(self) -> Path:
        """Folder for all results; all messages name it."""
        return Path(f"{Path(self.input).resolve().stem}-scan" if self.output is None else self.output)

    @property
    def people(self) -> list[str]:
        """Option of the stages that look for people."""
        return ["--keep-people"] * self.keep_people

    @property
    def common(self) -> list[str]:
        """Options of the scan that all of its stages have."""
        common = ["--config", self.config] if self.config else []
        common += ["--threads", str(self.threads)] if self.threads else []
        return [*common, "--json"] if self.json else common


def run(options: Options) -> Facts:
    from ...formats.replacing import claimed_folder
    from ...formats.scan_record import MODEL, read_scan_record, write_scan_record
    from ..scanning.display import Display
    from ..scanning.inputs import scan_input

    source, output = scan_input(Path(options.input)), options.folder
    if options.config:
        check_tables(options.config, STAGE_VERBS)
    _refuse_strangers(output, source)
    with claimed_folder(output):
        before = read_scan_record(output)
        plan = planned(options, source, output, before)
        states = _states(before, plan, source, output, options.overwrite)
        record = {"input": source.document(), "capture": plan.capture, "models": plan.models, "stages": states}
        write_scan_record(output, record)
        display = Display(plan.expected, quiet=options.json)
        for text in plan.sentences:
            display.tell(text)
        run_stages(plan.stages, states, partial(write_scan_record, output, record), display)
    return {
        "output": output,
        "scene": output / MODEL,
        "field": output / FIELD,
        "page": output / PAGE,
        "capture": output / plan.capture,
        "view": shlex.join(["drsplat", "view", str(output), *plan.encoder_option]),
        "models": plan.models,
        **summary(states, source),
        "notes": [*plan.sentences, *notes(states, plan.is_doubted)],
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _refuse_strangers(output: Path, source: ScanInput) -> None:
    """Check input and output.

    Raises: InputError: the output holds files that no scan made, or is the capture itself; a path that is not UTF-8.
    """
    from ...formats.json_files import is_text
    from ...formats.replacing import LOCK
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


def _states(before: Facts | None, plan: Plan, source: ScanInput, output: Path, overwrite: bool) -> Facts:
    """Return the stages of an earlier scan that stay.

    Raises: InputError: it was of other photos, or had other options, and not `overwrite`.
    """
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
    if asked != plan.stages[-1].line.given:
        kept = [verb for verb in kept if verb != "view"]
    return {verb: before["stages"][verb] for verb in kept}


class Plan(NamedTuple):
    """All that is settled before any work.

    Attributes:
        stages: in order.
        capture: folder of the posed photos, relative to the output or absolute.
        models: what the record says of them.
        encoder_option: what queries on the command line need.
        expected: seconds of each stage, a guess.
        sentences: what people should know at the beginning.
        is_doubted: whether one of them says that nouns are not to be believed.
    """

    stages: Sequence[Stage]
    capture: str
    models: Facts
    encoder_option: Sequence[str]
    expected: Mapping[str, float]
    sentences: Sequence[str]
    is_doubted: bool


def planned(options: Options, source: ScanInput, output: Path, before: Mapping[str, Any] | None) -> Plan:
    """Return the stages of a scan; options that no verb takes and words that nobody knows are found here.

    Raises: UsageError, InputError: as the verbs, and as a query. MissingExtraError: what has to be installed first.
    """
    from ...formats.scan_record import CAPTURE, MODEL
    from ..viewing.results import split_queries

    common, has_poses = options.common, source.kind == "capture"
    capture = str(source.path.resolve()) if has_poses else CAPTURE
    folder = str(output / capture)
    embed, choice, named = _embedding(options, folder, output, before)
    encoder = [] if choice.is_known else ["--encoder", choice.encoder]
    train = _training(options, folder, str(output / MODEL))
    made = ["--features", str(output / FEATURES), "--output", str(output / FIELD)]
    register = verb_line("register", [str(output / MODEL), folder, *made], common)
    line, given = verb_line("view", [str(output), "--export", str(output / PAGE), *encoder], [*common, "--play"])
    queries = split_queries(";".join(options.ask))
    trained = before is not None and is_done(before["stages"].get("train", {}))
    nouns = [] if trained else choice.nouns_of(queries)  # a slip is worth more before an hour of training than after
    choice = choice.judged(source, options.threads)
    view = VerbLine(replace(line, overwrite=True, ask="; ".join(queries)), given | {"ask": queries})
    vote = ["--vote"] if choice.segmenter == GRAPH else []  # pieces are what its masks are short of wholes
    stages = [
        *([] if has_poses else [_capturing(source, output / CAPTURE, [*common, *options.people])]),
        Stage("train", train, (output / MODEL,)),
        Stage("embed", embed, (output / FEATURES, parts_of(output / FEATURES))),
        Stage("register", register, (output / FIELD, output / f"{FIELD}.parts"), run=_registered),
        Stage("objects", verb_line("objects", [str(output), *vote], common), run=_counted),
        Stage("view", view, (output / PAGE,), run=lambda line: answered(line, queries, encoder, common)),
    ]
    models = {"asked": named, **asdict(choice)}
    sentences = [
        *([f"{source.path} has poses, which are taken as they are."] if has_poses else []),
        choice.sentence(nouns),
    ]
    expected = _expected(stages, source.num_photos or DEFAULT_VIDEO_PHOTOS, choice)
    return Plan(stages, capture, models, encoder, expected, sentences, choice.doubts_nouns)


def _registered(line: Any) -> Facts:
    """Run register; a field without parts is of a run that was killed when all but a note was made."""
    from . import register

    if not parts_of(line.output).is_dir():
        remove(Path(line.output))
    return register.run(line)


def _counted(line: Any) -> Facts:
    """Find the objects, and return how many; the field has the rest."""
    from . import objects

    found = objects.run(line)
    return {name: found[name] for name in ("num_objects", "num_agreed", "pictures", "doubt")}


def _capturing(source: ScanInput, folder: Path, common: Sequence[str]) -> Stage:
    from ...formats.json_files import read_json
    from ...photos.capture.program import require_colmap
    from ...photos.capture.work import RECORD, is_ready

    require_colmap()
    line, given = verb_line("capture", [str(source.path), "--output", str(folder)], common)
    settings = json.loads(json.dumps(asdict(line.settings)))
    # a capture that is there stays until the new one is complete
    capturing = VerbLine(replace(line, overwrite=True), given)

    def found() -> Facts | None:
        if not (folder / RECORD).is_file() or is_ready(folder):
            return None
        record = read_json(folder / RECORD)
        wanted = {"sources": source.fingerprint, "settings": settings}
        return record if isinstance(record, dict) and record.items() >= wanted.items() else None

    return Stage("capture", capturing, found=found)


def _training(options: Options, capture: str, model: str) -> VerbLine:
    from ...kernels.cuda.devices import chosen_device

    given = [capture, "--output-dir", model, *options.people]
    given += [] if options.iterations is None else ["--iterations", str(options.iterations)]
    on_cpu = chosen_device(verb_line("train", given, options.common).options.device) == "cpu"
    return verb_line("train", given, options.common, {"resolution": str(CPU_SIDE_PIXELS)} if on_cpu else None)


def _embedding(
    options: Options, capture: str, output: Path, before: Mapping[str, Any] | None
) -> tuple[VerbLine, ModelChoice, list[str]]:
    """Return the line of embed, its models, and what was asked for, of which "auto" may mean others elsewhere."""
    from ...formats.scan_record import MODEL
    from ..scanning.choosing import AUTO, ModelChoice, choose_models

    given = [capture, "--output", str(output / FEATURES), "--scene", str(output / MODEL), *options.people]
    for name, model in {"segmenter": options.segmenter, "encoder": options.encoder}.items():
        if model is not None and model != AUTO:
            given += [f"--{name}", model]
    first = verb_line("embed", given, options.common)
    named = [first.given.get(name, [[AUTO]])[-1][0] for name in ("segmenter", "encoder")]
    known = before["models"] if before is not None and not options.overwrite else {}
    if known.get("asked") == named:
        parts = ("segmenter", "encoder", "reason", "cure", "meaning")
        choice = ModelChoice(*(str(known.get(part, "")) for part in parts))
    else:
        choice = choose_models(named[0], named[1], first.options.device)
    defaults = {"segmenter": choice.segmenter, "encoder": choice.encoder}
    defaults |= {name.replace("_", "-"): str(value) for name, value in choice.cutting(named[0]).items()}
    line = verb_line("embed", given, options.common, defaults)
    line.options.point_settings(choice)  # or the error that says which options do not go together
    return line, choice, named


def _expected(stages: Sequence[Stage], num_photos: int, choice: ModelChoice) -> dict[str, float]:
    """Return how many seconds each stage may take."""
    train = next(stage.line.options for stage in stages if stage.verb == "train")
    expected = {verb: seconds * num_photos for verb, seconds in SECONDS_PER_PHOTO.items()}
    expected |= {"train": SECONDS_PER_PHOTO["train"] * train.planned_iterations, "objects": 4.0, "view": 6.0}
    if choice.segmenter == GRAPH:
        expected["objects"] += VOTE_SECONDS_PER_PHOTO * num_photos
    else:
        expected["embed"] = num_photos * SAM_SECONDS_PER_PHOTO
    return {stage.verb: expected[stage.verb] for stage in stages}


def interrupted(options: Options) -> str:
    """Return what a stopped run keeps, and how to go on."""
    return f"what is done is kept in {options.folder}: give the same command again to go on"


show = show_answer
