"""Whether objects help: answers of the plain field and of objects, side by side, in made rooms and real captures.

    python benchmarks/study_answers.py PLACE... --kept FOLDER [--clip FOLDER] [--names FOLDER] [--wrong 0 20 40]
        [--seeds 2] [--output FILE.json]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. How answers are
made and scored is in `suite/answers.py`; `python -m benchmarks.suite` runs the same for the page of the evaluation.
--clip and --names: vectors of 40 words and genuine centroids, and of the 1,203 names of LVIS (`suite/vocabularies.py`).
Columns: the plain field, objects, and the best threshold of the plain field; the first two of things of less than 1 %
of the Gaussians; how many present words find nothing, and how many absent ones find something. --output: records for
the page, docs/answers.json; a run that was stopped goes on.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import ASKED, COLUMNS, Draws, run
from benchmarks.suite.results import answers_of, write_results
from benchmarks.suite.vocabularies import Clip, Names


def row(record: dict[str, Any]) -> str:
    means = " | ".join(said(record[column]) for column in COLUMNS)
    small = np.array(record["small"], bool)
    of_small = ", ".join(f"{np.mean(np.array(record[name])[small]):.3f}" if small.any() else "-" for name in ASKED)
    shares = " | ".join(", ".join(f"{share:.0%}" for share in record[name].values()) for name in ("missed", "found"))
    return f"| {record['place']}, {record['masks']}, {record['words']} words | {means} | {of_small} | {shares} |"


def said(values: list[float]) -> str:
    """Mean, and half of a 95 % interval over queries."""
    return f"{np.mean(values):.3f} ± {1.96 * np.std(values) / np.sqrt(len(values)):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--names", type=Path)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--wrong", nargs="+", type=int, default=[0, 20, 40])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--output", type=Path, metavar="FILE.json")
    arguments = parser.parse_args()
    vocabularies = [(make, folder) for make, folder in ((Clip, arguments.clip), (Names, arguments.names)) if folder]
    if not vocabularies:
        parser.error("expected --clip FOLDER or --names FOLDER: without vectors of words nothing can be asked")
    draws, output = Draws(tuple(arguments.wrong), arguments.seeds), arguments.output or arguments.kept / "answers.json"
    print("| place | plain | objects | best threshold | small things | missed | absent found |\n" + "|---" * 7 + "|")
    records = []
    for make, folder in vocabularies:
        for record in run(arguments.places, make(folder), folder, arguments.kept, draws, Path(f"{output}.parts")):
            records.append(record)
            print(row(record), flush=True)
    write_results(output, answers_of(draws, records))


if __name__ == "__main__":
    main()
