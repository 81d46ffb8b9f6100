"""CPU seconds of `drsplat register` by stage, and the error of the code that it makes.

    python benchmarks/bench_register.py DEMO [--statistics FOLDER] [--before PYTHON] [--rounds 3] [--json out.json]

DEMO: a folder that `drsplat demo` wrote. Scenes: that of the demo with the masks and embeddings in it, and, with
--statistics (a folder with a CLIP codebook, see drawn_embeddings.py), the same with embeddings drawn like CLIP's, and a
made room (rooms.py) of 137,000 Gaussians that are seen. All with one thread. --before: the interpreter of another
environment with another version of the package; both take turns, in a process of their own each. Seconds are minima
over the rounds. Score rms, top-2 % IoU and the winner of 200 queries are of every third row.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from drawn_embeddings import Drawn, unit
from machine import describe
from rooms import mask_map, room, room_views

from drsplat import MiniEncoder, ViewFeatures, read_features, read_gaussians, read_views, register
from drsplat.field.codes.mixture import encode_mixture, learn_scene_atoms
from drsplat.field.codes.mixture.scene_atoms import spherical_kmeans
from drsplat.field.evidence.evidence import Evidence
from drsplat.kernels.mixture import nearest_centres
from drsplat.photos.models.mini.lexicon import COLORS, NAMES

MEASURED = 3  # every third row
CLUSTERS = 150  # of masks, where things are not known
QUERIES, TOP_SHARE = 200, 0.02
VIEWS, MASKS, THINGS, GAUSSIANS = 24, 80, 200, 200_000  # of the made room


def demo(folder: Path) -> tuple[Evidence, float]:
    """Return what the views of the demo say, and the CPU seconds that this took."""
    gaussians, held_out = read_gaussians(folder / "scene.compressed.ply"), held_out_of(folder)
    views = [view for view in read_views(folder) if view.name not in held_out]
    features = read_features(folder / "language_features", level="large", encoder=MiniEncoder().identity)
    start = process_time()
    found = register(gaussians, views, features, threads=1)
    return found.evidence, process_time() - start


def held_out_of(folder: Path) -> list[str]:
    names: list[str] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["held_out"]
    return names


def made_room(drawn: Drawn) -> tuple[Evidence, np.ndarray, float]:
    """Return what views of a room with masks at random say, queries, and the CPU seconds that this took."""
    rng, views, things = np.random.default_rng(5), room_views(VIEWS), drawn.things(THINGS)
    features = {}
    for number, view in enumerate(views):
        ids = mask_map(view.width, view.height, MASKS, seed=number)
        features[view.name] = ViewFeatures(ids, drawn.masks(things[rng.integers(0, THINGS, ids.max() + 1)]))
    start = process_time()
    found = register(room(GAUSSIANS), views, features, threads=1)
    return found.evidence, drawn.texts(things), process_time() - start


def scenes(folder: Path, statistics: Path | None) -> Iterator[tuple[str, Evidence, np.ndarray, float]]:
    evidence, seconds = demo(folder)
    yield "demo, mini", evidence, mini_words(), seconds
    if statistics is None:
        return
    drawn = Drawn(statistics)
    clusters = spherical_kmeans(evidence.embeddings, min(CLUSTERS, len(evidence.embeddings)), 0, 1)
    things = drawn.things(QUERIES)
    like_clip = drawn.masks(things[nearest_centres(evidence.embeddings, clusters, threads=1)])
    yield "demo, drawn", replace(evidence, embeddings=like_clip), drawn.texts(things), seconds
    yield "made room, drawn", *made_room(drawn)


def mini_words() -> np.ndarray:
    texts = [*NAMES, *[f"{color} {name}" for name in NAMES for color in COLORS][::2]]
    return MiniEncoder().encode_texts(texts[:QUERIES])


def quality(features: np.ndarray, decoded: np.ndarray, queries: np.ndarray) -> dict[str, float]:
    decoded = unit(decoded)
    exact, got = features @ queries.T, decoded @ queries.T
    kept = max(1, round(TOP_SHARE * len(features)))
    best = [np.argpartition(-scores, kept - 1, axis=0)[:kept].T for scores in (exact, got)]
    common = [len(np.intersect1d(*pair)) for pair in zip(*best, strict=True)]
    return {
        "cosine": 100 * float((features * decoded).sum(axis=1).mean()),
        "score_rms": float(np.sqrt(((exact - got) ** 2).mean())),
        "selection_iou": float(np.mean([c / (2 * kept - c) for c in common])),
        "argmax_agreement": float((exact.argmax(axis=1) == got.argmax(axis=1)).mean()),
    }


def measured(evidence: Evidence, queries: np.ndarray) -> dict[str, float]:
    seen = evidence.rows(np.flatnonzero(np.diff(evidence.weights.indptr) > 0))
    start = process_time()
    atoms = learn_scene_atoms(seen, threads=1)
    learnt = process_time()
    code = encode_mixture(seen, scene_atoms=atoms, threads=1)
    coded = process_time()
    rows = np.arange(0, len(seen), MEASURED)
    exact = seen.rows(rows).features(0, len(rows), threads=1)
    return {"learning": learnt - start, "coding": coded - learnt, **quality(exact, code.decode(rows), queries)}


def measure(folder: Path, statistics: Path | None) -> dict[str, dict[str, float]]:
    return {
        name: {"views": seconds, **measured(evidence, queries)}
        for name, evidence, queries, seconds in scenes(folder, statistics)
    }


def in_process_of(python: str, args: argparse.Namespace) -> dict[str, dict[str, float]]:
    statistics = ["--statistics", str(args.statistics)] if args.statistics else []
    command = [python, __file__, str(args.demo), *statistics, "--alone"]
    found: dict[str, dict[str, float]] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return found


def least(rounds: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Of every number the least; errors do not differ."""
    return {scene: {key: min(r[scene][key] for r in rounds) for key in rounds[0][scene]} for scene in rounds[0]}


def show(version: str, found: dict[str, dict[str, float]]) -> None:
    for scene, n in found.items():
        seconds = " | ".join(f"{n[stage]:.2f}" for stage in ("views", "learning", "coding"))
        print(f"| {scene} | {version} | {seconds} | {n['cosine']:.3f} | "
              f"{n['score_rms']:.5f} | {n['selection_iou']:.3f} | {n['argmax_agreement']:.3f} |")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("--statistics", type=Path)
    parser.add_argument("--before", metavar="PYTHON")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.alone:
        print(json.dumps(measure(args.demo, args.statistics)))
        return
    print(describe())
    pythons = {"now": sys.executable} | ({"before": args.before} if args.before else {})
    rounds = [{name: in_process_of(python, args) for name, python in pythons.items()} for _ in range(args.rounds)]
    found = {name: least([turn[name] for turn in rounds]) for name in pythons}
    print("| scene | version | views, CPU s | learning | coding | cosine % | score rms | top-2 % IoU | argmax of 200 |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in reversed(pythons):
        show(name, found[name])
    if args.json:
        args.json.write_text(json.dumps({"machine": describe(), **found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
