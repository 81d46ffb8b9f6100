"""The HTTP service under load on this machine: errors, waiting times, memory.

    python benchmarks/bench_serve.py [--points 1000000] [--workers 2] [--connections 32] [--seconds 60] [--at-once 1000]

A made-up room of things that are called by words, which each worker opens. Each connection asks one question after
the other: of ten, eight are a text to a selection (one scan of all Gaussians), one finds things (scan, groups, boxes),
one asks what is at a point. Clients run in this process, on the same cores. Memory is of all processes: resident, and
proportional (what is shared is divided by those who share it), every tenth of the time. Then --at-once connections ask
for a selection in the same moment.
"""

import argparse
import asyncio
import json
import re
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from machine import arguments, wait_for
from rooms import room

from drsplat import LanguageField, WordEncoder, train_codebook, write_gaussians
from drsplat.field.codes import Codes, pq_code

NAMES = [f"{color} {name}" for color in ("red", "blue", "green", "yellow") for name in (
    "mug", "chair", "lamp", "book", "vase", "bowl", "clock", "plant", "bottle", "basket", "cushion", "candle",
)]  # fmt: skip
VARIANTS = 64  # features of one thing
NOISE = 0.4
WARM_UP = 8

Times = dict[str, list[float]]


def write_scene(folder: Path, points: int) -> np.ndarray:
    """A scene and its field; returns one point of each thing."""
    rng, words = np.random.default_rng(0), WordEncoder()
    gaussians = room(points)
    seeds = rng.choice(points, len(NAMES), replace=False)
    distances = [((gaussians.means - gaussians.means[seed]) ** 2).sum(1) for seed in seeds]
    things = np.argmin(np.stack(distances), axis=0)
    vectors = np.repeat(words.encode_texts(NAMES), VARIANTS, axis=0)
    vectors = vectors + NOISE * rng.normal(size=vectors.shape) / np.sqrt(vectors.shape[1])
    features = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    codebook = train_codebook(features, 128, encoder=words.identity)
    codes, _ = codebook.encode(features)
    rows = things * VARIANTS + rng.integers(0, VARIANTS, points)
    code = pq_code(codebook, Codes(codes[rows], None))
    ids = np.arange(points, dtype=np.uint32)
    field = LanguageField(ids, code, words.identity, gaussians.fingerprint, points)
    folder.mkdir()
    write_gaussians(folder / "scene.ply", gaussians)
    field.save(folder / "room.field")
    return gaussians.means[seeds].astype(float)


class Client:
    """One connection that is kept open."""

    def __init__(self, port: int, seed: int, points: np.ndarray) -> None:
        self.port, self.points, self.rng = port, points, np.random.default_rng(seed)
        self.times: Times = {}
        self.statuses: Counter[int] = Counter()

    async def run(self, until: float) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        while time.perf_counter() < until:
            route, body = self.question()
            start = time.perf_counter()
            head = await exchange(reader, writer, route, body)
            self.times.setdefault(route, []).append(time.perf_counter() - start)
            self.statuses[status_of(head)] += 1
        writer.close()

    def question(self) -> tuple[str, dict[str, object]]:
        which, thing = self.rng.integers(10), self.rng.integers(len(NAMES))
        if which == 0:
            return "locate", {"text": NAMES[thing]}
        if which == 1:
            return "what-is", {"point": self.points[thing].tolist(), "names": NAMES}
        return "select", {"text": NAMES[thing]}


async def exchange(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, route: str, body: object) -> bytes:
    """The head of the answer."""
    data = json.dumps(body).encode()
    head = (
        f"POST /scenes/room/{route} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(data)}\r\n\r\n"
    )
    writer.write(head.encode() + data)
    answer = await reader.readuntil(b"\r\n\r\n")
    length = re.search(rb"content-length: (\d+)", answer, re.IGNORECASE)
    await reader.readexactly(int(length[1]) if length else 0)
    return answer


def status_of(head: bytes) -> int:
    return int(head.split(b" ", 2)[1])


def workers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    commands = {int(one): Path(f"/proc/{one}/cmdline").read_bytes() for one in children}
    return [one for one, command in commands.items() if b"drsplat.fronts.serving.worker" in command] + [pid]


def memory(pids: list[int]) -> tuple[float, float]:
    """MiB of all: resident, proportional."""
    sums = {"Rss": 0, "Pss": 0}
    for pid in pids:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        for line in lines:
            name = line.split(":")[0]
            if name in sums:
                sums[name] += int(line.split()[1])
    return sums["Rss"] / 1024, sums["Pss"] / 1024


async def load(port: int, pids: list[int], given: argparse.Namespace, points: np.ndarray) -> None:
    warm = [Client(port, 1000 + seed, points) for seed in range(given.connections)]
    await asyncio.gather(*(client.run(time.perf_counter() + WARM_UP) for client in warm))
    clients = [Client(port, seed, points) for seed in range(given.connections)]
    start = time.perf_counter()
    until = start + given.seconds
    running = [asyncio.create_task(client.run(until)) for client in clients]
    print(f"{'seconds':>8} {'resident MiB':>13} {'proportional MiB':>17}")
    for step in range(11):
        await asyncio.sleep(max(0, start + step * given.seconds / 10 - time.perf_counter()))
        print(f"{time.perf_counter() - start:8.0f} {memory(pids)[0]:13.0f} {memory(pids)[1]:17.0f}")
    await asyncio.gather(*running)
    report(clients, time.perf_counter() - start)


async def flood(port: int, count: int) -> None:
    """`count` connections, and as many requests when all are open."""
    lines = await asyncio.gather(*(asyncio.open_connection("127.0.0.1", port) for _ in range(count)))
    start = time.perf_counter()
    asked = (exchange(*line, "select", {"text": NAMES[n % len(NAMES)]}) for n, line in enumerate(lines))
    heads = await asyncio.gather(*asked, return_exceptions=True)
    seconds = time.perf_counter() - start
    cut = sum(isinstance(head, BaseException) for head in heads)
    statuses = Counter(status_of(head) for head in heads if isinstance(head, bytes))
    told = sum(isinstance(head, bytes) and b"\r\nretry-after:" in head.lower() for head in heads)
    print(
        f"{count:,} requests at once: {dict(statuses)}, {told} with Retry-After, {cut} cut off, within {seconds:.1f} s"
    )
    for _, writer in lines:
        writer.close()


def report(clients: list[Client], seconds: float) -> None:
    statuses: Counter[int] = sum((client.statuses for client in clients), Counter())
    errors = sum(count for status, count in statuses.items() if status != 200)
    total = sum(statuses.values())
    print(f"{total} answers in {seconds:.1f} s, {total / seconds:.1f} per second; {errors} errors; {dict(statuses)}")
    routes = sorted({route for client in clients for route in client.times})
    for route in [*routes, "all"]:
        mine = [route] if route != "all" else routes
        times = np.array([t for c in clients for r in mine for t in c.times.get(r, [])]) * 1e3
        low, high = np.percentile(times, (50, 99))
        print(f"{route:>8}: {len(times):6d} answers, p50 {low:6.0f} ms, p99 {high:6.0f} ms, most {times.max():6.0f} ms")


def main() -> None:
    given = arguments(__doc__, points=1_000_000, workers=2, connections=32, at_once=1000, seconds=60.0)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    with tempfile.TemporaryDirectory() as folder:
        points = write_scene(Path(folder) / "room", given.points)
        size = sum(path.stat().st_size for path in Path(folder).glob("room/room.field/*")) / 2**20
        print(
            f"{given.points:,} Gaussians, a field of {size:.0f} MiB, {given.workers} workers, {given.connections} "
            "connections"
        )
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        options = ["--port", str(port), "--workers", str(given.workers), "--threads", "1"]
        command = [sys.executable, "-m", "drsplat", "serve", folder, *options]
        server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            wait_for(port)
            asyncio.run(load(port, workers_of(server.pid), given, points))
            asyncio.run(flood(port, given.at_once))
        finally:
            server.terminate()
            print(f"stopped with {server.wait(60)}")


if __name__ == "__main__":
    main()
