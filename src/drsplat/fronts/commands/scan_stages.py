"""The stages of a scan: which verbs, with which lines, and how long they may take."""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .parts import parts_of
from .scan_answers import answered
from .stages import Stage, VerbLine, verb_line
from .train import planned_iterations

if TYPE_CHECKING:
    from ..scanning.choosing import ModelChoice
    from ..scanning.inputs import ScanInput

FIELD, FEATURES, PAGE = "scene.field", "features", "index.html"
CPU_SIDE_PIXELS = 800  # longer side of photos that a CPU trains on
SAM_ON_A_CPU = {"points": "auto", "crop-layers": "0", "levels": "large"}
"""Options of embed: few points. Fewer photos and crops may cost answers on real photos (docs/embedding.md)."""
DEFAULT_VIDEO_PHOTOS = 100  # until the frames of a video are chosen
SECONDS_PER_PHOTO = {"capture": 1.1, "train": 0.05, "embed": 0.7, "register": 0.3}
"""Seconds a photo, in training an iteration, on two cores: the first guess of the time that is left."""
SAM_SECONDS_PER_PHOTO = {"cpu": 8.0, "cuda": 1.5, "mps": 5.0}


@dataclass(frozen=True, eq=False)
class Plan:
    """All that is settled before any work.

    Attributes:
        stages: in order.
        capture: folder of the posed photos, relative to the output or absolute.
        models: what the record says of them.
        encoder_option: what queries on the command line need.
        expected: seconds of each stage, a guess.
        sentences: what people should know at the beginning.
    """

    stages: Sequence[Stage]
    capture: str
    models: dict[str, Any]
    encoder_option: Sequence[str]
    expected: Mapping[str, float]
    sentences: Sequence[str]


def planned(
    arguments: argparse.Namespace, source: ScanInput, output: Path, before: Mapping[str, Any] | None
) -> Plan:  # fmt: skip
    """Return the stages of a scan; options that no verb takes are found here, before any work.

    Raises: UsageError, InputError: as the verbs. MissingExtraError: what has to be installed first.
    """
    from ...formats.scan_record import CAPTURE, MODEL

    common = _common(arguments)
    has_poses = source.kind == "capture"
    capture = str(source.path.resolve()) if has_poses else CAPTURE
    folder = str(output / capture)
    embed, choice, asked = _embedding(arguments, folder, output, common, before)
    encoder = [] if choice.is_known else ["--encoder", choice.encoder]
    train = _training(arguments, folder, str(output / MODEL), common)
    field = str(output / FIELD)
    register = verb_line(
        "register", [str(output / MODEL), folder, "--features", str(output / FEATURES), "--output", field], common
    )
    view = verb_line("view", [str(output), "--export", str(output / PAGE), *encoder], [*common, "--play"])
    view.arguments.ask = _queries(arguments.ask)
    view.arguments.overwrite = True
    view.options["ask"] = view.arguments.ask
    stages = [
        *([] if has_poses else [_capturing(source, output / CAPTURE, common)]),
        Stage("train", train, (output / MODEL,)),
        Stage("embed", embed, (output / FEATURES, parts_of(output / FEATURES))),
        Stage("register", register, (output / FIELD, output / f"{FIELD}.parts"), run=_registered),
        Stage("objects", verb_line("objects", [str(output)], common), run=_counted),
        Stage("view", view, (output / PAGE,), run=lambda line: answered(line, encoder, common)),
    ]
    models = {"asked": asked, **asdict(choice)}
    sentences = [*([f"{source.path} has poses, which are taken as they are."] if has_poses else []), choice.sentence]
    expected = _expected(stages, source.num_photos or DEFAULT_VIDEO_PHOTOS, choice)
    return Plan(stages, capture, models, encoder, expected, sentences)


def _registered(line: argparse.Namespace) -> dict[str, Any]:
    """Run register; a field without parts is of a run that was killed when all but a note was made."""
    from . import register

    if not parts_of(line.output).is_dir():
        shutil.rmtree(line.output, ignore_errors=True)
    return register.run(line)


def _counted(line: argparse.Namespace) -> dict[str, Any]:
    """Find the objects, and return how many; the field has the rest."""
    from . import objects

    found = objects.run(line)
    return {name: found[name] for name in ("num_objects", "num_agreed", "doubt")}


def _common(arguments: argparse.Namespace) -> list[str]:
    """Return the options of the scan that all of its stages have."""
    common = ["--config", arguments.config] if arguments.config else []
    common += ["--threads", str(arguments.threads)] if arguments.threads else []
    return [*common, "--json"] if arguments.json else common


def _queries(asked: Sequence[str]) -> list[str]:
    from ..viewing.results import split_queries

    return split_queries(";".join(asked))


def _capturing(source: ScanInput, folder: Path, common: Sequence[str]) -> Stage:
    from ...formats.json_files import read_json
    from ...photos.capture.program import require_colmap
    from ...photos.capture.work import RECORD, is_ready
    from .capture import capture_settings

    require_colmap()
    line = verb_line("capture", [str(source.path), "--output", str(folder)], common)
    line.arguments.overwrite = True  # a capture that is there stays until the new one is complete
    settings = json.loads(json.dumps(asdict(capture_settings(line.arguments))))

    def found() -> dict[str, Any] | None:
        record = read_json(folder / RECORD) if (folder / RECORD).is_file() and not is_ready(folder) else None
        same = isinstance(record, dict) and record.get("sources") == source.fingerprint
        return record if isinstance(record, dict) and same and record.get("settings") == settings else None

    return Stage("capture", line, found=found)


def _training(arguments: argparse.Namespace, capture: str, model: str, common: Sequence[str]) -> VerbLine:
    from ...kernels.cuda.devices import chosen_device

    given = [capture, "--output-dir", model]
    given += [] if arguments.iterations is None else ["--iterations", str(arguments.iterations)]
    defaults: dict[str, str] = {}
    if chosen_device(verb_line("train", given, common).arguments.device) == "cpu":
        defaults["resolution"] = str(CPU_SIDE_PIXELS)
    return verb_line("train", given, common, defaults)


def _embedding(
    arguments: argparse.Namespace, capture: str, output: Path, common: Sequence[str], before: Mapping[str, Any] | None
) -> tuple[VerbLine, ModelChoice, list[str]]:
    """Return the line of embed, its models, and what was asked for, of which "auto" may mean others elsewhere."""
    from ...formats.scan_record import MODEL
    from ..scanning.choosing import AUTO, ModelChoice, choose_models
    from .embed import point_settings

    given = [capture, "--output", str(output / FEATURES)]
    for name in ("segmenter", "encoder"):
        if getattr(arguments, name) not in (None, AUTO):
            given += [f"--{name}", getattr(arguments, name)]
    first = verb_line("embed", given, common)
    asked = [first.options.get(name, [[AUTO]])[-1][0] for name in ("segmenter", "encoder")]
    known = before["models"] if before is not None and not arguments.overwrite else {}
    parts = ("segmenter", "encoder", "reason", "cure")
    if known.get("asked") == asked and all(isinstance(known.get(part), str) for part in parts):
        choice = ModelChoice(*(known[part] for part in parts))
    else:
        choice = choose_models(asked[0], asked[1], first.arguments.device)
    defaults = {"segmenter": choice.segmenter, "encoder": choice.encoder}
    if asked[0] == AUTO and choice.segmenter.startswith("facebook/sam2"):
        defaults |= SAM_ON_A_CPU | {"scene": str(output / MODEL)}
    line = verb_line("embed", given, common, defaults)
    point_settings(line.arguments)  # or the error that says which options do not go together
    return line, choice, asked


def _expected(stages: Sequence[Stage], num_photos: int, choice: ModelChoice) -> dict[str, float]:
    """Return how many seconds each stage may take."""
    train = next(stage.line.arguments for stage in stages if stage.verb == "train")
    expected = {verb: seconds * num_photos for verb, seconds in SECONDS_PER_PHOTO.items()}
    expected |= {"train": SECONDS_PER_PHOTO["train"] * planned_iterations(train), "objects": 4.0, "view": 6.0}
    if choice.segmenter != "graph":
        expected["embed"] = num_photos * SAM_SECONDS_PER_PHOTO["cpu"]
    return {stage.verb: expected[stage.verb] for stage in stages}
