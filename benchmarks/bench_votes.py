"""Seconds, processor seconds and memory of each step from posed photos and a scene to voted objects, as commands.

    python benchmarks/bench_votes.py CAPTURE SCENE [--photos 40] [--gaussians 100000] [--side 640] [--threads 2]
        [--kill 0.5] [--work FOLDER]

The photos are resized to SIDE pixels; where a capture has fewer than PHOTOS, each is taken more than once, with a name
of its own. Where the scene has fewer than GAUSSIANS, each is split into several that lie about it and together cover as
much; where it has more, as many are drawn. --kill: the step that looks at the photos is killed after this share of the
seconds that it took, run again, and has to give the same bits.

Then a photo is taken out of the field, forgotten, and added: the seconds until it is in the objects that are there, and
until these are made again with its vote, which has to give the bits of all photos at once.
"""

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.costs import Cost, cost_of
from benchmarks.machine import describe
from benchmarks.suite.tables import markdown
from drsplat import Gaussians, View, load_image, read_gaussians, read_views
from drsplat.drawing.pictures import write_picture
from drsplat.field.evidence.columns import part_name
from drsplat.formats.colmap_binary import write_colmap
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.photos.embedding.voting import votes_beside

DRSPLAT = Path(sys.executable).parent / "drsplat"


def write_photos(views: list[View], count: int, side: int, folder: Path) -> None:
    """Write a capture of undistorted photos, evenly taken from the views, or each several times."""
    chosen = [views[number * len(views) // count] for number in range(count)]
    placed = [replace(view.limited(side), name=f"{number:04}.png") for number, view in enumerate(chosen)]
    for part in ("images", "sparse/0"):
        (folder / part).mkdir(parents=True)
    for view in placed:
        write_picture(folder / "images" / view.name, load_image(view))
    posed = [replace(view, distortion=None) for view in placed]
    write_colmap(folder / "sparse" / "0", posed, np.zeros((1, 3)), np.zeros((1, 3), np.uint8))


def with_count(gaussians: Gaussians, count: int) -> Gaussians:
    """Split Gaussians, or draw some, so that there are `count`."""
    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(np.arange(count) % len(gaussians)))
    if count <= len(gaussians):
        return gaussians.subset(np.sort(rng.permutation(len(gaussians))[:count]))
    copies = np.bincount(rows, minlength=len(gaussians))[rows]
    split = gaussians.subset(rows)
    means = split.means + np.where(copies[:, None] > 1, rng.normal(0, 0.5, (count, 3)) * split.scales, 0)
    opacities = 1 - (1 - np.minimum(split.opacities, 0.999)) ** (1 / copies)
    return replace(split, means=means.astype(np.float32), opacities=opacities.astype(np.float32))


def killed(command: list[str], after: float) -> None:
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(after)
    if process.poll() is not None:
        raise SystemExit(f"ended before {after:.1f} s: choose a smaller share")
    process.send_signal(signal.SIGKILL)
    process.wait()


def steps(work: Path, threads: int) -> dict[str, list[str]]:
    capture, scene, features, field = (str(work / name) for name in ("capture", "scene.ply", "features", "room.field"))
    every = ["--threads", str(threads)]
    return {
        "masks, embeddings": ["embed", capture, "--segmenter", "graph", "--encoder", "drsplat-mini", "-o", features],
        "registration": ["register", scene, capture, "--features", features, "-o", field, *every],
        "objects": ["objects", field, "--scene", scene, "--again", *every],
        "objects and votes": ["objects", field, "--scene", scene, "--vote", "--views", capture, *every],
    }


def objects_of(field: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(field.rglob("*objects*")) if path.is_file()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--photos", type=int, default=40)
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--side", type=int, default=640)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--kill", type=float)
    parser.add_argument("--work", type=Path)
    args = parser.parse_args()
    print(describe())
    with tempfile.TemporaryDirectory() as place:
        work = args.work or Path(place)
        if not (work / "scene.ply").exists():
            work.mkdir(parents=True, exist_ok=True)
            write_photos(read_views(args.capture), args.photos, args.side, work / "capture")
            write_gaussians(work / "scene.ply", with_count(read_gaussians(args.scene), args.gaussians))
        rows, costs = [], {}
        for name, command in steps(work, args.threads).items():
            costs[name] = cost_of([str(DRSPLAT), *command])
            rows.append(row(name, costs[name]))
        print(markdown(("step", "s", "CPU s", "MiB"), rows))
        join(work, args.threads)
        if args.kill:
            resume(work, steps(work, args.threads)["objects and votes"], costs["objects and votes"], args.kill)


def row(name: str, cost: Cost) -> tuple[str, ...]:
    return name, f"{cost.clock_s:.1f}", f"{cost.cpu_s:.1f}", f"{cost.own / 2**20:.0f}"


def join(work: Path, threads: int) -> None:
    """Add a photo that the field and its votes do not know; print what it takes, and whether the objects are the same.

    Of the time of the whole command, reading the photos and the scene is the rest.
    """
    field, name = work / "room.field", read_views(work / "capture")[-1].name
    before = objects_of(field)
    line = [str(field), "--scene", str(work / "scene.ply"), "--views", name, "--threads", str(threads)]
    subprocess.run([str(DRSPLAT), "remove", *line], check=True, stdout=subprocess.DEVNULL)
    for part in ("columns", "regions"):
        (votes_beside(field) / part_name(name).replace("columns", part)).unlink()
    line[1:1] = [str(work / "capture"), "--features", str(work / "features"), "--json"]
    cost = cost_of([str(DRSPLAT), "add", *line])
    seconds = json.loads(cost.output)["stage_seconds"]
    joined = sum(seconds[stage] for stage in ("load", "read", "register", "weights", "code", "joined"))
    behind = seconds["objects"] + seconds["save"]
    print(
        f"a photo more ({cost.cpu_s:.1f} CPU s): {joined:.1f} s until it has joined, {behind:.1f} s behind it; ", end=""
    )
    print(f"the same bits: {before == objects_of(field)}")


def resume(work: Path, command: list[str], whole: Cost, share: float) -> None:
    """Kill the step and run it again; print what it cost, and whether the objects are the same bits."""
    field = work / "room.field"
    before = objects_of(field)
    shutil.rmtree(votes_beside(field))
    killed([str(DRSPLAT), *command], share * whole.clock_s)
    again = cost_of([str(DRSPLAT), *command])
    same = before == objects_of(field)
    print(f"killed after {share:.0%}, then {again.clock_s:.1f} s; the same bits: {same}, of {len(before)} files")


if __name__ == "__main__":
    main()
