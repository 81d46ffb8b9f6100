"""Seconds, size and memory of every format that `drsplat export` writes, beside splat-transform's.

    python benchmarks/bench_export.py [--gaussians 1000000] [--degree 3] [--objects 500] [--tiles 2000000 10000000]
        [--theirs ply spz compressed.ply glb] [--only glb sog]

A made-up scene is written as PLY once. Each row is a process of its own that reads the PLY and writes a format; ours
with the objects, where the format holds them. CPU seconds and the largest memory are what the system counts of the
process, start and reading included; "read" reads the PLY and writes nothing. splat-transform runs on the processor;
its SOG is left out unless --theirs names it, as without a graphics card it takes minutes for 100,000 Gaussians.

--tiles: 3D Tiles and streamed SOG of scenes of so many Gaussians that are cut into tiles first. Memory must not grow
with the scene. `--only --theirs --tiles COUNT` prints nothing else.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

from benchmarks.machine import arguments

TILED = ("tiles3d", "streamed")
OURS = ("read", "ply", "glb", "spz", "spz4", "sog", "usda", "usdc", "rrd", "tiles3d")
SIDE = 100.0  # of the made-up scene, in its units
BLOCK_ROWS = 1 << 19  # of a scene that is made at once
CHILD, CHILD_OF_TILES, MAKE = "--child", "--child-of-tiles", "--make"


class Measured(NamedTuple):
    """What a process took."""

    cpu: float
    clock: float
    peak_mib: float


def scene_of(count: int, degree: int, seed: int = 0):
    """Make clusters of flat Gaussians, as trained ones are: few thick, many faint."""
    from drsplat.scene.gaussians import Gaussians

    rng = np.random.default_rng(seed)
    centers = rng.uniform(-SIDE / 2, SIDE / 2, (500, 3))
    means = (centers[np.arange(count) * 500 // count] + rng.normal(scale=0.5, size=(count, 3))).astype(np.float32)
    quats = rng.normal(size=(count, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = np.exp(rng.normal([-4, -4, -6], 0.7, (count, 3))).astype(np.float32)
    sh = rng.normal(scale=0.05, size=(count, (degree + 1) ** 2, 3)).astype(np.float32)
    sh[:, 0] = rng.normal(scale=0.8, size=(count, 3))
    return Gaussians(means, quats, scales, rng.beta(0.6, 0.6, count).astype(np.float32), sh)


def write(source: Path, output: Path, kind: str, num_objects: int) -> None:
    """Read a PLY and write it in a format, with so many objects, which are runs of its rows."""
    import drsplat as ds
    from drsplat.formats.known import write_scene
    from drsplat.formats.tiles3d_writing import write_tiles3d
    from drsplat.scene.labelled import LabelledScene, Thing

    gaussians = ds.read_gaussians(source)
    box = {"axes": np.eye(3), "extent": np.ones(3)}
    things = tuple(
        Thing(f"thing {number}", 0.5, np.full(3, float(number)), number=number, **box) for number in range(num_objects)
    )
    owners = (np.arange(len(gaussians)) * num_objects // len(gaussians)).astype(np.int32)
    scene = LabelledScene(gaussians, things=things, object_of=owners)
    if kind == "tiles3d":
        write_tiles3d(output, scene)
    elif kind != "read":
        write_scene(output, scene, spz_version=4 if kind == "spz4" else 3)


def write_tiled(source: Path, output: Path, kind: str) -> None:
    """Write a folder of tiles in a format that is made from a few tiles at a time."""
    from drsplat.formats.streamed_sog import write_streamed_sog
    from drsplat.formats.tiles import read_tiles
    from drsplat.formats.tiles3d_writing import write_tiles3d

    if kind == "tiles3d":
        write_tiles3d(output, read_tiles(source))
    else:
        write_streamed_sog(output / "lod-meta.json", read_tiles(source))


def make(path: Path, count: int, degree: int, seed: int = 0) -> None:
    """Write a made-up scene in a process of its own: the system counts what this one held as its children's memory."""
    measured([sys.executable, __file__, MAKE, path, count, degree, seed])


def measured(command: Sequence[object]) -> Measured:
    """Run a program to its end."""
    begin = time.perf_counter()
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{command[:3]} ended with {process.returncode}")
    return Measured(used.ru_utime + used.ru_stime, time.perf_counter() - begin, used.ru_maxrss / 1024)


def size_of(path: Path) -> float:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files) / 1e6


def row(name: str, program: str, result: Measured, output: Path) -> None:
    size = f"{size_of(output):.1f}" if output.exists() else ""
    print(
        f"| {name} | {program} | {result.cpu:.1f} | {result.clock:.1f} | {size} | {result.peak_mib:,.0f} |", flush=True
    )
    shutil.rmtree(output, ignore_errors=True)
    output.unlink(missing_ok=True)


def ours(source: Path, folder: Path, kind: str, num_objects: int) -> None:
    output = folder / f"ours.{kind.removesuffix('4')}"
    command = [sys.executable, __file__, CHILD, source, output, kind, num_objects]
    row(kind, "drsplat", measured(command), output)


def theirs(source: Path, folder: Path, kind: str) -> None:
    from foreign_programs import NODE, npm_package

    script = npm_package("@playcanvas/splat-transform") / "bin" / "cli.mjs"
    output = folder / f"theirs.{kind.removesuffix('4')}"
    options = ["--quiet", "--gpu", "cpu"] + (["--spz-version", "4"] if kind == "spz4" else [])
    row(kind, "splat-transform", measured([NODE, script, *options, source, output]), output)


def tiles(folder: Path, count: int, degree: int) -> None:
    """Cut a scene of so many Gaussians, half a million at a time, and write its tiles in each format."""
    paths = [folder / f"block_{number}.ply" for number in range(-(-count // BLOCK_ROWS))]
    for number, path in enumerate(paths):
        make(path, min(BLOCK_ROWS, count - number * BLOCK_ROWS), degree, number)
    measured([sys.executable, "-m", "drsplat", "tile", *paths, "--output", folder / "cut.tiles"])
    for path in paths:
        path.unlink()
    for kind in TILED:
        output = folder / f"ours.{kind}"
        command = [sys.executable, __file__, CHILD_OF_TILES, folder / "cut.tiles", output, kind]
        row(f"{kind} of {count:,} in tiles", "drsplat", measured(command), output)
    shutil.rmtree(folder / "cut.tiles")


def main() -> None:
    given = arguments(
        __doc__, gaussians=1_000_000, degree=3, objects=500, tiles=[2_000_000, 10_000_000],
        theirs=["ply", "spz", "spz4", "compressed.ply", "glb"], only=[*OURS],
    )  # fmt: skip
    print(f"{given.gaussians:,} Gaussians of degree {given.degree}, {given.objects} objects\n")
    print("| format | program | CPU s | s | MB | peak MiB |")
    print("|---|---|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = folder / "scene.ply"
        if given.only or given.theirs:
            make(source, given.gaussians, given.degree)
        for kind in given.only:
            ours(source, folder, kind, given.objects)
            if kind in given.theirs:
                theirs(source, folder, kind)
        for kind in given.theirs:
            if kind not in given.only:
                theirs(source, folder, kind)
        source.unlink(missing_ok=True)
        for count in given.tiles:
            tiles(folder, count, given.degree)


if __name__ == "__main__":
    if sys.argv[1:2] == [CHILD]:
        write(Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4], int(sys.argv[5]))
    elif sys.argv[1:2] == [CHILD_OF_TILES]:
        write_tiled(Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
    elif sys.argv[1:2] == [MAKE]:
        from drsplat import write_gaussians

        write_gaussians(sys.argv[2], scene_of(*map(int, sys.argv[3:])))
    else:
        main()
