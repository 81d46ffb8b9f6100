"""python -m world --split test --seed 7 --output DIR [--views 40 --size 640x480]"""

import argparse
import secrets
import shutil
import sys
import time
from pathlib import Path

from .cameras import PATHS, views_of
from .layouts import write_lerf, write_scannet, write_truth
from .looks import SPLITS
from .render import shoot
from .rooms import make_room
from .scan import from_depth, of_surfaces

VERSION = 1  # of the world: a change of what a seed makes raises it


def main() -> None:
    arguments = _arguments()
    output: Path = arguments.output
    if output.exists():
        sys.exit(f"{output} exists already: name a folder that does not, or remove it")
    output.parent.mkdir(parents=True, exist_ok=True)
    temporary = output.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        write_scene(temporary, arguments)
        temporary.rename(output)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_scene(folder: Path, plan: argparse.Namespace) -> None:
    """One room in all layouts (see `layouts`)."""
    split, seed = SPLITS[plan.split], plan.seed
    room = make_room(split, seed)
    cameras = views_of(room, plan.views, plan.size, split.rng(seed, 300), plan.cameras)
    shots = []
    started = time.perf_counter()
    for shot in shoot(room, cameras, plan.spp, seed):
        shots.append(shot)
        passed = time.perf_counter() - started
        print(f"\r{len(shots)}/{plan.views} views, {passed:.0f} s", end="", flush=True)
    print()
    rng, scene = split.rng(seed, 400), f"{split.name}_{seed:04d}"
    about = {"world": VERSION, "split": split.name, "seed": seed, "cameras": plan.cameras, "spp": plan.spp}
    write_truth(folder, room, shots, {**about, "scene": scene})
    write_lerf(folder / "lerf_ovs", scene, room, shots, from_depth(shots, 20_000, rng))
    write_scannet(folder / "scannet", scene, room, of_surfaces(room, shots, rng))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m world", description="Makes a household scene.")
    parser.add_argument("--split", choices=sorted(SPLITS), default="train")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, metavar="DIR", required=True)
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--size", type=_size, default=(640, 480), metavar="WIDTHxHEIGHT")
    parser.add_argument("--cameras", choices=PATHS, default="both", help="round the table, through the room, or both")
    parser.add_argument("--spp", type=int, default=16, help="samples per pixel")
    return parser.parse_args()


def _size(text: str) -> tuple[int, int]:
    width, height = text.lower().split("x")
    return int(width), int(height)


if __name__ == "__main__":
    main()
