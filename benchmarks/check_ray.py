"""Registration and objects on a Ray cluster of two nodes while workers, a node and the driver are killed: same bits.

    drsplat demo --output demo
    python benchmarks/check_ray.py demo [--rows 8192]

Both nodes are processes of this machine. After each kill the same command is given again until the field is there.
The kill comes when some photos are registered, when some votes are weighed (by the aggregator robust), when a part of
the codebook is trained, when some blocks have their nodes, when some are compared, and when some nodes are added up;
runs and blocks are made small, so that there are several. Printed: whether the field's files are those of a run
without Ray, and how many files of tasks were written more than once.
"""

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

PORT = 26379
MANIFEST = "field.json"  # names all files of the field, and so objects
RAY = [sys.executable, "-m", "ray.scripts.scripts"]


SMALL = """
import sys
from drsplat.cli import main
from drsplat.field.objects import describing, finding
from drsplat.field.tiles import transposing
finding.MAX_WEIGHTS, finding.BLOCK_WEIGHTS, transposing.RUN_BYTES = 0, 500_000, 4 << 20
describing.ROWS_SUMMED_AT_ONCE = 1 << 14
sys.exit(main(sys.argv[1:]))
"""


class Stage(NamedTuple):
    """arguments: of drsplat. done: file of the field that is there at the end. kill: after so many files of a name."""

    name: str
    arguments: list[str]
    done: str
    kill: tuple[str, int]


def stages(tiles: Path, demo: Path, field: Path) -> list[Stage]:
    features = ["--features", str(demo / "language_features"), "--output", str(field), "--threads", "1", "--json"]
    register = ["register", str(tiles), str(demo), *features, "--aggregator", "robust", "--code", "pq"]
    objects = ["objects", str(field), "--scene", str(tiles), "--threads", "1", "--json"]
    return [
        Stage("photos", register, "field.json", ("*.columns.safetensors", 5)),
        Stage("votes", register, "field.json", ("made/*.weighing.safetensors", 3)),
        Stage("codebook", register, "field.json", ("made/*.centroids.safetensors", 1)),
        Stage("blocks", objects, "objects.safetensors", ("objects/*.nodes.safetensors", 1)),
        Stage("comparing", objects, "objects.safetensors", ("objects/*.sharing.safetensors", 1)),
        Stage("describing", objects, "objects.safetensors", ("objects/*.summing.safetensors", 1)),
    ]


def command(arguments: list[str], *options: str) -> list[str]:
    return [sys.executable, "-c", SMALL, *arguments, *options]


def children(name: str) -> list[int]:
    """Processes of Ray of a kind, by what they are called."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if name in words and "check_ray" not in words:
                found.append(int(entry.name))
    return found


@contextmanager
def cluster() -> Iterator[tuple[str, Callable[[], None]]]:
    """Two nodes: their address, and what starts a further one."""
    start = [*RAY, "start", "--disable-usage-stats", "--num-cpus=1", "--object-store-memory=100000000"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    head = [*start, "--head", f"--port={PORT}", "--include-dashboard=false"]
    told = subprocess.run(head, check=True, capture_output=True, text=True)
    address = re.findall(r"--address='([^']+)'", told.stdout + told.stderr)[0]

    def another() -> None:
        subprocess.run([*start, f"--address={address}"], check=True, **quiet)

    another()
    try:
        yield address, another
    finally:
        subprocess.run([*RAY, "stop", "--force"], check=False, **quiet)


def files(field: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in field.iterdir()}


def main() -> None:
    os.environ["RAY_AUTH_MODE"] = "disabled"  # nobody else is on this machine's port
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--rows", type=int, default=8192)
    parser.add_argument("--victims", nargs="+", default=["nobody", "a worker", "a node", "the driver"])
    parser.add_argument("--stages", nargs="+", default=[stage.name for stage in stages(Path(), Path(), Path())])
    given = parser.parse_args()
    place, rng = Path(tempfile.mkdtemp(prefix="ray-")), random.Random(0)
    tiles, plain = place / "demo.tiles", place / "plain.field"
    cut = [sys.executable, "-m", "drsplat", "tile", str(given.demo / "scene.compressed.ply"), "-o", str(tiles)]
    subprocess.run([*cut, "--rows", str(given.rows)], check=True, stdout=subprocess.DEVNULL)
    registered = place / "registered.field"
    first, *_, last = stages(tiles, given.demo, plain)
    subprocess.run(command(first.arguments), check=True, stdout=subprocess.DEVNULL)
    shutil.copytree(plain, registered)
    subprocess.run(command(last.arguments), check=True, stdout=subprocess.DEVNULL)
    with cluster() as (address, another):
        for victim in given.victims:
            for stage in stages(tiles, given.demo, field := place / "ray.field"):
                if stage.name not in given.stages:
                    continue
                parts = place / "parts"
                shutil.rmtree(field, ignore_errors=True)
                shutil.rmtree(parts, ignore_errors=True)
                if stage.done != MANIFEST:
                    shutil.copytree(registered, field)
                run = command(stage.arguments, "--ray", address, "--parts", str(parts))
                told = watched(run, stage, field, parts, victim, another, rng)
                same = all(files(plain)[name] == content for name, content in files(field).items() if name != MANIFEST)
                print(f"{victim} killed, {stage.name}: same bits {same}, {told}", flush=True)


def watched(
    run: list[str], stage: Stage, field: Path, parts: Path, victim: str, another: Callable[[], None],
    rng: random.Random,
) -> str:  # fmt: skip
    """Give a command until it is done, and kill somebody once. What was done."""
    made: Counter[str] = Counter()
    seen: dict[str, int] = {}
    tries, killed = 0, victim == "nobody"
    pattern, count = stage.kill
    while not (field / stage.done).exists() and tries < 4:
        tries += 1
        process = subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None:
            time.sleep(0.02)
            look(parts, seen, made)
            if not killed and len(list(parts.glob(pattern))) >= count:
                killed = True
                kill(victim, process, rng)
        if victim == "a node" and tries == 1:
            another()
    look(parts, seen, made)
    return f"{len(made)} files, {sum(made.values()) - len(made)} written again, {tries} runs"


def look(parts: Path, seen: dict[str, int], made: Counter[str]) -> None:
    """Count what was written since; embeddings are what tasks are given."""
    for file in parts.rglob("*.safetensors"):
        try:
            written = file.stat().st_mtime_ns
        except OSError:  # it has its name in a moment
            continue
        if ".embeddings." not in file.name and seen.get(str(file)) != written:
            seen[str(file)] = written
            made[str(file)] += 1


def kill(victim: str, driver: subprocess.Popen[bytes], rng: random.Random) -> None:
    if victim == "the driver":
        driver.kill()
        return
    found = children("ray::_of_shared") if victim == "a worker" else sorted(children("--raylet_socket_name"))[1:]
    if found:
        os.kill(rng.choice(found), signal.SIGKILL)
    print(f"  ({victim}: {len(found)} to choose from)", flush=True)


if __name__ == "__main__":
    main()
