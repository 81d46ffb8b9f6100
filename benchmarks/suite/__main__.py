"""python -m benchmarks.suite [SCENE ...] --output results.json [--masks true graph] [--methods mean ...] [--jobs 2]

Without scenes, all of world/scenes. A run that was stopped goes on when it is started again.
Then: python -m benchmarks.suite.page results.json --output docs/evaluation.md
"""

import argparse
import time
from pathlib import Path

from .masks import MASKS
from .rivals import FITTED
from .running import ALL, METHODS, Task, results_of, run, threads_for, write_results

SCENES = Path(__file__).resolve().parents[2] / "world" / "scenes"


def main() -> None:
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
    arguments = parser.parse_args()
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
    write_results(arguments.output, results_of(scenes, arguments.every, records))
    print(f"{arguments.output}: {len(records)} records in {time.perf_counter() - start:.0f} s")


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
