"""Registration on a Ray cluster of two nodes while workers, a node and the driver are killed: the same bits.

    drsplat demo --output demo
    python benchmarks/check_ray.py demo [--rows 8192]

Both nodes are processes of this machine. After each kill the same command is given again until the field is there.
Printed: whether its files are those of a run without Ray, and how many views were computed more than once.
"""

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

PORT = 26379
RAY = [sys.executable, "-m", "ray.scripts.scripts"]


def command(tiles: Path, demo: Path, output: Path, *options: str) -> list[str]:
    features = ["--features", str(demo / "language_features"), "--output", str(output), "--threads", "1", "--json"]
    return [sys.executable, "-m", "drsplat", "register", str(tiles), str(demo), *features, *options]


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
    given = parser.parse_args()
    place, rng = Path(tempfile.mkdtemp(prefix="ray-")), random.Random(0)
    tiles = place / "demo.tiles"
    cut = [sys.executable, "-m", "drsplat", "tile", str(given.demo / "scene.compressed.ply"), "-o", str(tiles)]
    subprocess.run([*cut, "--rows", str(given.rows)], check=True, stdout=subprocess.DEVNULL)
    subprocess.run(command(tiles, given.demo, place / "plain.field"), check=True, stdout=subprocess.DEVNULL)
    with cluster() as (address, another):
        for victim in given.victims:
            output, parts = place / f"{victim.replace(' ', '_')}.field", place / f"{victim.replace(' ', '_')}.parts"
            run = command(tiles, given.demo, output, "--ray", address, "--parts", str(parts))
            made: Counter[str] = Counter()
            seen: dict[str, int] = {}
            tries, killed = 0, victim == "nobody"
            while not output.exists() and tries < 4:
                tries += 1
                process = subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                while process.poll() is None:
                    time.sleep(0.02)
                    for file in parts.glob("*.columns.safetensors"):
                        written = file.stat().st_mtime_ns
                        if seen.get(file.name) != written:
                            seen[file.name] = written
                            made[file.name] += 1
                    if not killed and len(seen) >= 5:
                        killed = True
                        kill(victim, process, rng)
                if victim == "a node" and tries == 1:
                    another()
            again = sum(count - 1 for count in made.values())
            same = output.exists() and files(output) == files(place / "plain.field")
            print(
                f"{victim} killed: same bits {same}, {len(made)} views, {again} computed again, {tries} runs",
                flush=True,
            )


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
