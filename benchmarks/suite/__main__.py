"""python -m benchmarks.suite [SCENE ...] --output docs/evaluation.json [--masks true graph] [--methods mean ...]
    [--captures CAPTURE=SCENE.ply ... --clip FOLDER --kept FOLDER] [--jobs 2]

Makes everything that the page of the evaluation needs, and the page. Without scenes, all of world/scenes. A run that
was stopped goes on when it is started again; parts of other inputs or older code are made again.

Writes results of all methods in the made rooms to FILE.json, together with what an earlier run left there. With --clip,
also answers.json beside it: answers to words in the same rooms and in --captures, each with the scene that was trained
on it (suite/answers.py). --kept: folder of registered places. Then FILE.md and FILE.svg.
"""

import argparse
import time
from pathlib import Path

from .answers import Draws
from .answers import run as ask
from .masks import MASKS
from .page import ANSWERS_FILE, write_page
from .results import answers_of, results_of, with_earlier, write_results
from .rivals import FITTED
from .running import ALL, METHODS, Task, run, threads_for
from .vocabularies import Clip

SCENES = Path(__file__).resolve().parents[2] / "world" / "scenes"


def parsed() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="*", help="folders of world.packing")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE.json")
    parser.add_argument("--masks", nargs="+", choices=tuple(MASKS), default=list(MASKS))
    parser.add_argument(
        "--methods", "--aggregators", nargs="+", choices=ALL, default=list(METHODS),
        metavar="NAME", help=f"of {', '.join(ALL)} (default: all but the last {len(FITTED)}, which take hours)",
    )  # fmt: skip
    parser.add_argument("--rivals", action="store_true", help="the methods, and the rivals that are fitted")
    parser.add_argument(
        "--effort", type=effort, nargs="+", action="extend", default=[], metavar="NAME=SHARE",
        help="rivals that take only a share of their papers' steps",
    )  # fmt: skip
    parser.add_argument("--device", default="cpu", help="of PyTorch, that rivals are fitted on (default: cpu)")
    parser.add_argument("--jobs", type=int, default=1, help="scenes at a time (default: 1)")
    parser.add_argument("--every", type=int, default=1, help="take one in so many views")
    parser.add_argument("--work", type=Path, help="folder of what is finished (default: FILE.json.parts)")
    parser.add_argument("--captures", nargs="+", default=[], metavar="CAPTURE=SCENE", help="real captures, for words")
    parser.add_argument("--clip", type=Path, help="folder of CLIP's vectors: asks for words, too")
    parser.add_argument("--kept", type=Path, help="folder of places that are registered (default: in --work)")
    parser.add_argument("--seeds", type=int, default=1, help="trials of words of each kind (default: 1)")
    arguments = parser.parse_args()
    if arguments.captures and not arguments.clip:
        parser.error("--captures needs --clip, the folder of CLIP's vectors")
    return arguments


def main() -> None:
    arguments = parsed()
    start, scenes = time.perf_counter(), arguments.scenes or packed_scenes(SCENES)
    work = arguments.work or Path(f"{arguments.output}.parts")
    methods = (*arguments.methods, *(FITTED if arguments.rivals else ()))
    threads, device = threads_for(arguments.jobs), arguments.device
    tasks = [
        Task(folder, masks, methods, work, arguments.every, threads, dict(arguments.effort), device)
        for folder in scenes
        for masks in arguments.masks
    ]
    records = run(tasks, arguments.jobs)
    results = with_earlier(results_of(scenes, arguments.every, records), arguments.output)
    write_results(arguments.output, results)
    print(f"{arguments.output}: {len(records)} records in {time.perf_counter() - start:.0f} s")
    if arguments.clip:
        given = [*arguments.captures, *map(str, scenes)]
        draws, asked = Draws(seeds=arguments.seeds), []
        words = Clip(arguments.clip)
        for record in ask(given, words, arguments.clip, arguments.kept or work / "kept", draws, work):
            asked.append(record)
            print(f"{record['place']}, {record['masks']}, words: {record['seconds']:.1f} s", flush=True)
        write_results(arguments.output.with_name(ANSWERS_FILE), answers_of(draws, asked))
    write_page(arguments.output, arguments.output.with_suffix(".md"))


def effort(text: str) -> tuple[str, float]:
    name, _, share = text.partition("=")
    if name not in FITTED:
        raise argparse.ArgumentTypeError(f"expected one of {', '.join(FITTED)}, and =SHARE, got {text!r}")
    return name, float(share)


def packed_scenes(folder: Path) -> list[Path]:
    """All that are there, by name."""
    return sorted(path.parent for path in folder.glob("*/scene.compressed.ply"))


if __name__ == "__main__":
    main()
