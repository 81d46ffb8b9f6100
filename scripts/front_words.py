#!/usr/bin/env python3
"""Record what every verb says: all help, wrong lines and their errors, settings files, and answers on the demo.

    drsplat demo --output DEMO
    python scripts/front_words.py DEMO --write before.json      (in one version)
    python scripts/front_words.py DEMO --against before.json    (in another: prints what differs, exits 1 if anything)

Lines are those of the first record. Outputs go to a folder of their own; files are compared by their hash, JSON without
what measures this run: seconds, memory and bytes a second.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from drsplat.cli import VERBS, main, make_parser

MEASURED = re.compile(r"second|memory|cpu|^added$|^bytes$|kernels")
TIMED = re.compile(r"^cat/|cfg_args$|checkpoint\.safetensors$|results\.json$|scan\.json$")
ASKED = ("red vase", "mug", "something to sit on", "chair, not red", "how many chairs", "vase on table", "zebra")
COMMANDS = (
    *(f"locate DEMO '{words}' --json" for words in ASKED),
    *(f"locate DEMO '{words}'" for words in ASKED[:3]),
    "locate DEMO 'red vase' --present --top 2 --picture OUT/a.png --json",
    "locate DEMO --point 0,0,1 --json",
    "select DEMO 'red vase' --save OUT/ids.npy --json",
    "select DEMO 'red vase' --top-share 0.02 --save OUT/part.ply --json",
    "select DEMO 'red vase' --relevancy --negatives 'wall,floor' --json",
    "segment DEMO --classes 'vase,table,chair' --save OUT/classes.ply --json",
    "objects DEMO --json",
    "objects DEMO --save OUT/objects.json --json",
    "inspect DEMO --json",
    "inspect DEMO",
    "export DEMO --output OUT/room.glb --json",
    "export DEMO --query 'red vase' --only --output OUT/vase.glb",
    "export DEMO --object 4 --output OUT/thing.ply --json",
    "export DEMO --output OUT/room.spz --json",
    "export DEMO --output OUT/room.sog --json",
    "export DEMO --output OUT/room.usda --json",
    "edit DEMO --query 'red vase' --recolour '#2060ff' --save OUT/blue.ply --json",
    "edit DEMO --list --json",
    "edit DEMO --query 'red vase' --remove --fill --turn 30 --axis z --move 0.1 0 0 --save OUT/no.ply --json",
    "render SCENE --views DEMO --view frame_00001 --output-dir OUT/still --alpha --depth --json",
    "render SCENE --views DEMO --path orbit --seconds 1 --fps 2 --size 64x48 -o OUT/film.gif --json",
    "view DEMO --export OUT/page.html --ask 'red vase; chair' --json",
    "register SCENE DEMO --features FEATURES --output OUT/new.field --without every:4 --json",
    "add OUT/new.field DEMO --features FEATURES --scene SCENE --json",
    "remove OUT/new.field --scene SCENE --views frame_00002 --json",
    "objects OUT/new.field --scene SCENE --views DEMO --json",
    "field carry OUT/new.field SCENE --scene SCENE --output OUT/o.field --json",
    "tile SCENE --output OUT/tiles --json",
    "export OUT/tiles --output OUT/lod/lod-meta.json --json",
    "photograph SCENE --output OUT/photos --number 3 --size 64x48 --json",
    "catalogue add OUT/cat DEMO --json",
    "catalogue ask OUT/cat 'red vase' --json",
    "catalogue list OUT/cat --json",
    "catalogue remove OUT/cat demo0 --json",
    "embed DEMO --output OUT/features --segmenter graph --encoder drsplat-mini --json",
    "train DEMO --output-dir OUT/model --iterations 20 --resolution 8 --json",
    "codebook train OUT/features/no.npy --output OUT/c.safetensors",
    "scan DEMO --output OUT/scan --iterations 60 --ask 'red vase' --json",
    "inspect OUT/model --json",
    "doctor --json",
)


def said(argv: list[str]) -> dict[str, Any]:
    """Return the exit code of a line, what it prints, and what it prints as an error."""
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(argv)
        out.flush()
    return {"code": code, "out": out.buffer.getvalue().decode(), "err": err.getvalue()}


def help_lines() -> list[list[str]]:
    """Return the lines that ask for help, of all verbs."""
    return [["--help"], *([verb, flag] for verb in VERBS for flag in ("--help", "--help-all", "--print-config"))]


def wrong_lines() -> list[list[str]]:
    """Return lines with something wrong: each option of each verb with no value, a bad one and a slip in its name."""
    lines = [[], ["locat"], ["--nothing"], ["locate", "a", "b", "c"], ["locate", "", "mug"]]
    verbs = next(action.choices for action in make_parser()._actions if action.dest == "==SUPPRESS==" or action.choices)
    assert isinstance(verbs, dict)
    for verb, parser in verbs.items():
        positional = ["x" for one in parser._actions if not one.option_strings and one.nargs is None]
        lines += [] if verb == "demo" else [[verb]]
        lines += [[verb, *positional, "too", "many", "words", "here"], [verb, *positional, "--config", "no.toml"]]
        for action in parser._actions:
            flag = next((text for text in action.option_strings if text.startswith("--")), None)
            if flag is None or flag in ("--help", "--help-all", "--debug", "--log", "--print-config", "--config"):
                continue
            lines.append([verb, *positional, flag[:-1] + "qz"])
            if action.nargs != 0:
                lines += [[verb, *positional, flag], [verb, *positional, flag, "-1e99"], [verb, *positional, flag, ""]]
                lines.append([verb, *positional, flag, "1,5", "--print-config"])
    return lines


def answers(lines: list[str], demo: str, out: Path) -> dict[str, Any]:
    """Run real commands on a demo folder; returns what they print and the hashes of what they write."""
    import shlex

    out.mkdir()
    found: dict[str, Any] = {}
    for line in lines:
        argv = [placed(word, demo, out) for word in shlex.split(line)]
        one = said(argv)
        if "--json" in argv and one["out"].strip():
            one["out"] = unmeasured(json.loads(one["out"]))
        else:
            one["out"] = re.sub(r"\d+\.\d+ s\b.*", "", one["out"])
        found[line] = json.loads(json.dumps(one).replace(str(out), "OUT"))
    found["files"] = {
        file.relative_to(out).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(out.rglob("*")) if file.is_file() and not TIMED.search(file.relative_to(out).as_posix())
    }  # fmt: skip
    return found


def placed(word: str, demo: str, out: Path) -> str:
    """Return a word of a line with the places of this run."""
    word = word.replace("SCENE", "DEMO/scene.compressed.ply").replace("FEATURES", "DEMO/language_features")
    return word.replace("DEMO", demo).replace("OUT", str(out))


def unmeasured(value: Any) -> Any:
    """Return JSON without what measures the run."""
    if isinstance(value, dict):
        return {name: unmeasured(one) for name, one in value.items() if not MEASURED.search(name)}
    return [unmeasured(one) for one in value] if isinstance(value, list) else value


def recorded(demo: str, before: dict[str, Any] | None) -> dict[str, Any]:
    """Return the record of this version, of the lines of an earlier record if there is one."""
    os.environ["COLUMNS"] = "100"
    wrong = wrong_lines() if before is None else [json.loads(line) for line in before["wrong"]]
    helps = help_lines() if before is None else [json.loads(line) for line in before["help"]]
    commands = list(COMMANDS) if before is None else [line for line in before["answers"] if line != "files"]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        return {
            "help": {json.dumps(line): said(line) for line in helps},
            "wrong": {json.dumps(line): said(line) for line in wrong},
            "answers": answers(commands, demo, Path(folder) / "out"),
        }


def compared(before: dict[str, Any], after: dict[str, Any]) -> int:
    """Print a table of what differs; returns how many lines do."""
    differing = 0
    for part, lines in before.items():
        now = after[part] | after[part].pop("files", {})
        lines |= lines.pop("files", {})
        others = [line for line, one in lines.items() if now.get(line) != one]
        print(f"{part}: {len(lines)} lines, {len(others)} differ")
        differing += len(others)
        for line in others[:40]:
            print(f"  {line}\n    before {str(lines[line])[:1500]}\n    now    {str(now.get(line))[:1500]}")
    return differing


def run() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", help="folder of a demo")
    parser.add_argument("--write", type=Path, metavar="FILE")
    parser.add_argument("--against", type=Path, metavar="FILE")
    given = parser.parse_args()
    before = None if given.against is None else json.loads(given.against.read_text())
    write = None if given.write is None else given.write.resolve()
    after = json.loads(json.dumps(recorded(str(Path(given.demo).resolve()), before)))
    if write is not None:
        write.write_text(json.dumps(after, indent=1))
    return 0 if before is None else min(1, compared(before, after))


if __name__ == "__main__":
    sys.exit(run())
