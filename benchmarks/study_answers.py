"""Whether objects help: answers of the plain field and of objects, side by side, in made rooms and real captures.

    python benchmarks/study_answers.py PLACE... --clip FOLDER --kept FOLDER [--wrong 0 20 40] [--seeds 2] [--output F]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. How answers are
made and scored is in `suite/answers.py`; `python -m benchmarks.suite` runs the same for the page of the evaluation.
Columns: the plain field, objects, and the best threshold of the plain field; how many present words find nothing, and
how many absent ones find something. --output: records for the page, docs/answers.json; a run that was stopped goes on.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import COLUMNS, Draws, run
from benchmarks.suite.results import answers_of, write_results


def row(record: dict[str, Any]) -> str:
    means = " | ".join(said(record[column]) for column in COLUMNS)
    shares = " | ".join(", ".join(f"{share:.0%}" for share in record[name].values()) for name in ("missed", "found"))
    return f"| {record['place']}, {record['masks']} | {means} | {shares} |"


def said(values: list[float]) -> str:
    """Mean, and half of a 95 % interval over queries."""
    return f"{np.mean(values):.3f} ± {1.96 * np.std(values) / np.sqrt(len(values)):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20, 40])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--output", type=Path, metavar="FILE.json")
    arguments = parser.parse_args()
    draws, output = Draws(tuple(arguments.wrong), arguments.seeds), arguments.output or arguments.kept / "answers.json"
    print("| place | plain | objects | best threshold | missed | absent found |\n" + "|---" * 6 + "|")
    records = []
    for record in run(arguments.places, arguments.clip, arguments.kept, draws, Path(f"{output}.parts")):
        records.append(record)
        print(row(record), flush=True)
    write_results(output, answers_of(draws, records))


if __name__ == "__main__":
    main()
