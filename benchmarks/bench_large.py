"""How large scenes open and move in the client without a graphics card: seconds, memory, sorts, pictures a second.

    python benchmarks/bench_large.py SCENE.ply [--rows 100000 1000000 10000000] [--chromium PROGRAM]

Scenes of so many Gaussians are made of SCENE.ply by copies that are jittered by a hundredth of its radius. A viewer of
each is opened, and turned for some seconds: by the client's rasteriser, and by its shaders with WebGL in software.
Memory is what all processes of the browser hold (proportional set size). Needs playwright and a
Chromium.
"""

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from bench_client import CARD, PANEL, PATIENCE_MS, SIZE, SOFTWARE, TURN
from playwright.sync_api import sync_playwright

from drsplat import open_scene
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.scenes import read_gaussians
from drsplat.fronts.viewing.bare import open_bare
from drsplat.fronts.viewing.live.service import Service, listening_socket
from drsplat.fronts.viewing.live.shared import Shared
from drsplat.fronts.viewing.saving import Saves
from drsplat.fronts.viewing.session import Session
from drsplat.fronts.viewing.shown import frame_of
from drsplat.scene.gaussians import Gaussians

JITTER, MEASURED_S = 0.1, 12  # in units of which the scene's radius has ten


def enlarged(gaussians: Gaussians, rows: int) -> Gaussians:
    """Return so many Gaussians: copies that are jittered, without harmonics that depend on the direction."""
    ids = np.arange(rows) % len(gaussians)
    jitter = np.random.default_rng(0).normal(0, JITTER / frame_of(gaussians).scale, (rows, 3)).astype(np.float32)
    jitter[: len(gaussians)] = 0
    return Gaussians(
        gaussians.means[ids] + jitter, gaussians.quats[ids], gaussians.scales[ids], gaussians.opacities[ids],
        gaussians.sh[ids, :1],
    )  # fmt: skip


def held(pids: list[int]) -> float:
    """Return the megabytes that processes hold; what they share counts once."""
    sums = 0
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/smaps_rollup").read_text()
        except OSError:  # it has ended
            continue
        sums += int(text.split("Pss:")[1].split()[0])
    return sums / 1000


def family(pid: int) -> list[int]:
    """Return a process and all that came from it."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def measured(opened: Any, address: str, card: bool) -> None:
    page = opened.new_page(viewport={"width": SIZE[0] + PANEL, "height": SIZE[1]})
    page.set_default_timeout(PATIENCE_MS)
    if card:
        page.add_init_script(CARD)
    begin = time.perf_counter()
    page.goto(address)
    page.wait_for_function("() => window.drsplat && drsplat.stage.frames > 0")
    first = time.perf_counter() - begin
    page.wait_for_function("() => drsplat.isWhole")
    whole = time.perf_counter() - begin
    page.evaluate(TURN)
    page.wait_for_timeout(4000)
    frames, begin, sorts = page.evaluate("() => drsplat.stage.frames"), time.perf_counter(), []
    while time.perf_counter() - begin < MEASURED_S:
        page.wait_for_timeout(500)
        sorts.append(page.evaluate("() => drsplat.stage.sorted"))
    rate = (page.evaluate("() => drsplat.stage.frames") - frames) / (time.perf_counter() - begin)
    share, rows = page.evaluate("() => [drsplat.stage.limit, drsplat.splats.count]")
    memory = held(family(os.getpid())[1:])
    print(
        f"  {'WebGL in software' if card else 'rasteriser':18} first picture {first:.1f} s, whole {whole:.1f} s;"
        f" turned {rate:.2f} pictures a second of {share:,} of {rows:,}, sort {median(sorts):.0f} ms; {memory:,.0f} MB",
        flush=True,
    )
    page.close()


def run(scene: Path, rows: int, chromium: str) -> None:
    session = Session(open_bare(scene), rows, edits_kept=False)
    with listening_socket("127.0.0.1", 0) as listening, sync_playwright() as driver:
        service = Service(Shared(Saves(None), open_scene), listening, "127.0.0.1")
        service.show(session)
        opened = driver.chromium.launch(executable_path=chromium, args=SOFTWARE)
        with service.running() as address:
            for card in (False, True):
                measured(opened, address, card)
        opened.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    given = parser.parse_args()
    for rows in given.rows:
        print(f"{rows:,} Gaussians", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder) / "large.ply"
            write_gaussians(scene, enlarged(read_gaussians(given.scene), rows))
            run(scene, rows, given.chromium)


if __name__ == "__main__":
    main()
