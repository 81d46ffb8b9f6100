"""A catalogue of many scenes on this machine: recall of its codes, times, sizes, and asking while others write.

    python benchmarks/bench_catalogue.py OFFICIAL [--scenes 1000] [--each 300] [--descriptors 0] [--thumbnail 4096]
        [--queries 200] [--compared 10] [--seconds 30] [--clients 16] [--keep FOLDER]

OFFICIAL is the authors' folder with `pq_index.faiss`: embeddings of objects and words are drawn with its statistics
(drawn_embeddings.py), an object as one of 5,000 kinds of things, a descriptor as one mask of it, which is noisier than
the mean that it is. --descriptors 0: 1 to 4 of an object, as often as in two real scenes; else so many of each.
--thumbnail: bytes of each, not compressible; 0 for none. Half of the queries are words, half are pictures of a kind.
--keep: use what an earlier run left there.

Exact answers, to --compared words and as many pictures, compare all descriptors; recall is the share of their first 10
that the codes find too, and of the first 256 objects that are ranked. Then --clients threads ask for --seconds, while
one writer adds, replaces and removes scenes of 50 objects: an answer is wrong where an object that is always there is
missing, or a scene that comes and goes is there in part.
"""

import resource
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from drawn_embeddings import CLIP, Drawn
from machine import arguments
from scipy.spatial.transform import Rotation

from drsplat import Query
from drsplat.formats.replacing import claimed_output
from drsplat.formats.vocabulary import VocabularyEncoder, write_vocabulary
from drsplat.query import Match
from drsplat.query.catalogue import Catalogue, Conditions, SceneEntry
from drsplat.query.catalogue.changes import replace_scene
from drsplat.query.catalogue.nearest import ANYWHERE, Search, nearest_objects
from drsplat.query.catalogue.rows import Kept, scene_arrays
from drsplat.query.catalogue.snapshot import Record
from drsplat.query.sketch import Packed, Sketch

KINDS, TOP = 5000, 10
OFTEN = (38, 64, 75, 48)  # objects of 1 to 4 descriptors, of the room of `drsplat demo` and of a phone's capture
MARKED = 50  # objects of a scene that comes and goes
RANKED = 256  # objects that a query ranks
LISTED, LISTED_QUERIES = 1000, 60  # words of a list, and of these that are asked


class Simulated:
    """Rows of scenes, and queries for them."""

    def __init__(self, official: Path, each: int, descriptors: int, thumbnail: int) -> None:
        self.drawn, self.each, self.descriptors, self.thumbnail = Drawn(official), each, descriptors, thumbnail
        self.kinds = self.drawn.things(KINDS)
        self.rng = self.drawn.rng

    def counts(self, number: int) -> np.ndarray:
        if self.descriptors:
            return np.full(number, self.descriptors)
        return self.rng.choice(4, number, p=np.array(OFTEN) / sum(OFTEN)) + 1

    def scene(self) -> tuple[list[np.ndarray], list[bytes]]:
        """Descriptors and thumbnails of the objects of a scene."""
        counts = self.counts(self.each)
        vectors = self.drawn.masks(np.repeat(self.kinds[self.rng.integers(0, KINDS, self.each)], counts, axis=0))
        thumbnails = [self.rng.bytes(self.thumbnail) for _ in range(self.each)]
        return np.split(vectors, np.cumsum(counts)[:-1]), thumbnails

    def queries(self, count: int) -> np.ndarray:
        kinds = self.kinds[self.rng.choice(KINDS, count, replace=False)]
        half = count // 2
        return np.concatenate([self.drawn.texts(kinds[:half]), self.drawn.masks(kinds[half:])])


def add(path: Path, name: str, parts: list[np.ndarray], thumbnails: list[bytes]) -> None:
    """Add a scene of objects of these descriptors."""
    number = len(parts)
    rng = np.random.default_rng(number)
    centers, extents = rng.uniform(-5, 5, (number, 3)), rng.uniform(0.05, 1, (number, 3))
    axes, gaussians = Rotation.random(number, rng).as_matrix(), np.zeros(5, np.int64)
    matches = [Match(centers[k], axes[k], extents[k], 1.0, gaussians, object_id=k) for k in range(number)]
    kept = [
        Kept(match, own, Record(0, 40 + 9 * k, 2 + k % 40, rng.random(), None, f"word {k}", f"{k:05d}.jpg", k), data)
        for k, (match, own, data) in enumerate(zip(matches, parts, thumbnails, strict=True))
    ]
    arrays = scene_arrays(kept, CLIP.dim, sketch(parts).to_bytes())
    entry = SceneEntry(name, number, number, datetime.now(UTC), "0" * 32, "", "unknown")
    with claimed_output(path, 60.0):
        replace_scene(path, entry, arrays, CLIP)


def sketch(parts: list[np.ndarray]) -> Sketch:
    """A scene whose Gaussians are as the descriptors of their objects are."""
    vectors = np.concatenate(parts)
    numbers = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part) for part in parts])
    solid = np.full(len(parts), 40, np.int32)
    pictures = vectors[:128] / np.linalg.norm(vectors[:128], axis=1, keepdims=True)
    features, shown, words = (Packed.of(some) for some in (vectors, pictures, vectors[:0]))
    return Sketch(features, np.full(len(vectors), 40, np.int32), numbers, shown, words, solid, {})


def add_marked(path: Path, name: str, vector: np.ndarray) -> None:
    add(path, name, [vector[None]] * MARKED, [b""] * MARKED)


@contextmanager
def timed(what: str) -> Iterator[None]:
    start, cpu = time.perf_counter(), time.process_time()
    yield
    print(f"{what}: {time.perf_counter() - start:.1f} s, {time.process_time() - cpu:.1f} s of processor", flush=True)


def filled(path: Path, simulated: Simulated, scenes: int) -> Catalogue:
    there = len(Catalogue.open(path).scenes())
    print(f"{there} scenes are there already")
    for number in range(there, scenes):
        add(path, f"scene {number:05d}", *simulated.scene())
    return Catalogue.open(path)


def told(path: Path, catalogue: Catalogue) -> None:
    sizes = {file.name: file.stat().st_size for file in path.glob("*.safetensors")}
    size, indexed = sum(sizes.values()), sum(size for name, size in sizes.items() if name.startswith("codes"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"{len(catalogue):,} objects: {size / 1e9:.2f} GB, {size / len(catalogue):,.0f} bytes an object, of which the "
        f"codes {indexed / len(catalogue):,.0f}, in {len(sizes)} files; this process has held {peak:.1f} GB", flush=True
    )  # fmt: skip


def measured(catalogue: Catalogue, queries: np.ndarray, exact: bool, where: Conditions, said: str) -> list[list[tuple]]:
    """What is found first, and the times of it."""
    found, seconds, cpu = [], [], time.process_time()
    catalogue.answer(Query(vector=queries[0], threshold=-1.0), where, top=TOP, exact=exact)  # opens and warms
    for query in queries:
        start = time.perf_counter()
        entries = catalogue.ask(Query(vector=query, threshold=-1.0), where, top=TOP, exact=exact)
        seconds.append(time.perf_counter() - start)
        found.append([(entry.scene, entry.object_id) for entry in entries])
    p50, p99 = np.percentile(seconds, (50, 99)) * 1000
    each = (time.process_time() - cpu) / (len(queries) + 1) * 1000
    print(f"{said}: median {p50:.0f} ms, 99 of 100 within {p99:.0f} ms, {each:.0f} ms of processor", flush=True)
    return found


def listed(path: Path, simulated: Simulated, file: Path) -> None:
    """Texts whose objects have to fit better than the other words of a list, here and in their scenes."""
    words = [f"word {number}" for number in range(LISTED)]
    vectors = simulated.drawn.texts(simulated.kinds[:LISTED])
    write_vocabulary(file, VocabularyEncoder(CLIP, words, vectors), overwrite=True)
    catalogue, seconds, cpu = Catalogue.open(path, vocabulary=str(file)), [], 0.0
    for word in words[: LISTED_QUERIES + 1]:
        start, before = time.perf_counter(), time.process_time()
        catalogue.ask(word, top=TOP)
        seconds.append(time.perf_counter() - start)
        cpu += time.process_time() - before
    p50, p99 = np.percentile(seconds[1:], (50, 99)) * 1000
    print(
        f"texts against a list of {LISTED:,} words: median {p50:.0f} ms, 99 of 100 within {p99:.0f} ms, "
        f"{cpu / len(seconds) * 1000:.0f} ms of processor; the first {seconds[0]:.1f} s", flush=True
    )  # fmt: skip


def recall(found: list[list[tuple]], exact: list[list[tuple]]) -> str:
    shares = [len(set(a) & set(b)) / max(len(b), 1) for a, b in zip(found, exact, strict=True)]
    half = len(shares) // 2
    firsts = [a[:1] == b[:1] for a, b in zip(found, exact, strict=True)]
    return (
        f"of the first {TOP}: words {np.mean(shares[:half]):.3f}, pictures {np.mean(shares[half:]):.3f}; "
        f"the best is the best in {np.mean(firsts):.3f}"
    )


def ranked(catalogue: Catalogue, queries: np.ndarray) -> None:
    """How many of the first 10 and the first 256 are found by codes, in milliseconds of processor."""
    snapshot, half, shares = catalogue._snapshot(coded=True), len(queries) // 2, []
    for count in (TOP, RANKED):
        exact = [first(snapshot, query, count, True) for query in queries]
        first(snapshot, queries[0], RANKED, False)
        cpu = time.process_time()
        found = [first(snapshot, query, RANKED, False)[:count] for query in queries]
        took = (time.process_time() - cpu) / len(queries) * 1000
        each = [len(set(a) & set(b)) / count for a, b in zip(found, exact, strict=True)]
        shares += [np.mean(each[:half]), np.mean(each[half:])]
    print(
        f"by codes: of the first {TOP} words {shares[0]:.3f}, pictures {shares[1]:.3f}; of {RANKED} {shares[2]:.3f}, "
        f"{shares[3]:.3f}; {took:.0f} ms of processor", flush=True
    )  # fmt: skip


def first(snapshot: object, query: np.ndarray, count: int, exact: bool) -> list[int]:
    """The rows that are nearest, best first."""
    rows, described, _ = nearest_objects(snapshot, Search(query, ANYWHERE, count, 0), exact)
    order: list[int] = rows[np.argsort(-described.cosines(query), kind="stable")].tolist()
    return order


def under_load(path: Path, catalogue: Catalogue, clients: int, seconds: float) -> None:
    """Threads ask for what one scene has and others have at times, while one writer changes these."""
    vector = -catalogue._surroundings(catalogue._snapshot()).usual.mean(axis=0)  # like nothing that is there
    vector = (vector / np.linalg.norm(vector)).astype(np.float32)
    add_marked(path, "stays", vector)
    done, times, wrong, writes = threading.Event(), [], [], []

    def ask() -> None:
        while not done.is_set():
            start = time.perf_counter()
            entries = catalogue.ask(Query(vector=vector, threshold=0.9), top=3 * MARKED)
            times.append(time.perf_counter() - start)
            counts = {name: sum(entry.scene == name for entry in entries) for name in {e.scene for e in entries}}
            if counts.get("stays") != MARKED or any(number != MARKED for number in counts.values()):
                wrong.append(counts)

    def write() -> None:
        number = 0
        while not done.is_set():
            name, start = f"comes {number % 2}", time.perf_counter()
            if number % 3 == 2 and any(one.scene == name for one in catalogue.scenes()):
                catalogue.remove(name)
                writes.append(("remove", time.perf_counter() - start))
            else:
                add_marked(path, name, vector)
                writes.append(("add", time.perf_counter() - start))
            number += 1

    threads = [threading.Thread(target=ask) for _ in range(clients)] + [threading.Thread(target=write)]
    for thread in threads:
        thread.start()
    time.sleep(seconds)
    done.set()
    for thread in threads:
        thread.join()
    tell_load(f"{clients} clients for {seconds:.0f} s", times, wrong, writes)


def tell_load(who, times, wrong, writes) -> None:
    """Print how long answers and changes took. writes: pairs of a kind and its seconds."""
    p50, p99 = np.percentile(times, (50, 99))
    print(
        f"{who}: {len(times)} answers of {MARKED} to {3 * MARKED} objects, median "
        f"{p50:.2f} s, 99 of 100 within {p99:.2f} s; {len(wrong)} wrong: {wrong[:3]}"
    )
    for kind in ("add", "remove"):
        some = [took for one, took in writes if one == kind]
        print(f"  {len(some)} times {kind}: median {np.median(some or [0]):.2f} s, at most {max(some or [0]):.2f} s")


def main() -> None:
    given = arguments(
        __doc__, "official", scenes=1000, each=300, descriptors=0, thumbnail=4096, queries=200, compared=10,
        seconds=30.0, clients=16, keep=Path,
    )  # fmt: skip
    folder = given.keep or Path(tempfile.mkdtemp(prefix="drsplat-catalogue-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        simulated, path = Simulated(given.official, given.each, given.descriptors, given.thumbnail), folder / "many"
        with timed("fill"):
            catalogue = filled(path, simulated, given.scenes)
        told(path, catalogue)
        queries, everywhere = simulated.queries(given.queries), Conditions()
        each = min(given.compared, len(queries) // 2)
        ends = [*range(each), *range(len(queries) - each, len(queries))]  # some words, some pictures
        some = queries[ends]
        exact = measured(catalogue, some, True, everywhere, "all compared")
        with timed("index"):
            catalogue.build_index()
        told(path, catalogue)
        found = measured(catalogue, queries, False, everywhere, "by codes")
        print(recall([found[at] for at in ends], exact))
        measured(catalogue, queries[:50], False, Conditions(scenes=("scene 00001",)), "one scene")
        listed(path, simulated, folder / "words.safetensors")
        ranked(catalogue, some)
        under_load(path, catalogue, given.clients, given.seconds)
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
