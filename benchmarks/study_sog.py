"""SOG of drsplat beside that of splat-transform: seconds, size, and PSNR of the file to the scene that it is of.

    npm install --prefix tests/foreign
    python benchmarks/study_sog.py drsplat-demo [--photos 8] [--iterations 1 10]

The demo's scene, as PLY, in a process each that reads it and writes a SOG; splat-transform on the processor, with so
many --iterations of its palette of harmonics (10 are its default). PSNR is the mean over photos, evenly chosen, of our
picture of the file to our picture of the scene, where there is something in it.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import drsplat as ds
from benchmarks.bench_export import measured
from benchmarks.machine import arguments
from drsplat.scene.views import View
from foreign_programs import NODE, npm_package
from foreign_viewing import psnr

THERE = 0.01  # alpha from which on a pixel shows something


def commands(source: Path, folder: Path, iterations: Sequence[int]) -> Iterator[tuple[str, Path, list[object]]]:
    """Yield who writes, the file, and the command."""
    ours = folder / "ours.sog"
    yield "drsplat", ours, [sys.executable, "-m", "drsplat", "export", source, "--output", ours]
    script = npm_package("@playcanvas/splat-transform") / "bin" / "cli.mjs"
    for count in iterations:
        output = folder / f"theirs_{count}.sog"
        options = ["--quiet", "--gpu", "cpu", "--max-workers", "0", "--iterations", count]
        yield f"splat-transform, {count} iterations", output, [NODE, script, *options, source, output]


def likeness(path: Path, scene: ds.Gaussians, views: Sequence[View]) -> float:
    """Return the mean PSNR of pictures of a file to those of the scene."""
    read, values = ds.read_gaussians(path), []
    for view in views:
        whole = ds.render(scene, view)
        values.append(psnr(np.clip(ds.render(read, view).rgb, 0, 1), whole.rgb, whole.alpha > THERE))
    return float(np.mean(values))


def main() -> None:
    given = arguments(__doc__, "demo", photos=8, iterations=[1])
    scene = ds.read_gaussians(given.demo / "scene.compressed.ply")
    views = ds.read_views(given.demo)
    views = views[:: -(-len(views) // given.photos)]
    print(f"{len(scene):,} Gaussians of degree {scene.sh_degree}, {len(views)} photos\n")
    print("| written by | CPU s | MB | peak MiB | PSNR |")
    print("|---|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "scene.ply"
        ds.write_gaussians(source, scene)
        for writer, output, command in commands(source, Path(name), given.iterations):
            result = measured(command)
            near = likeness(output, scene, views)
            size = output.stat().st_size / 1e6
            print(f"| {writer} | {result.cpu:.1f} | {size:.2f} | {result.peak_mib:,.0f} | {near:.1f} |", flush=True)


if __name__ == "__main__":
    main()
