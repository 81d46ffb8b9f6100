"""What each code keeps of features that were registered: bytes, cosine, scores, selections, winners.

    python benchmarks/study_codes.py --scenes world/scenes/room_5 [--masks true,graph]
        [--fields plush.field] [--statistics FOLDER] [--rows 65536] [--output study_codes.json]

Features are rows of real registration matrices: packed scenes, registered here, and fields that were saved with
their evidence (`drsplat register`). Embeddings: of the built-in encoder as they are; and, with --statistics (a
folder with a CLIP codebook, see drawn_embeddings.py), drawn for each mask from the statistics of CLIP, a direction
for every true thing, or for every cluster of masks where the truth is not known.

Codes with "generic" codebooks were trained on other embeddings (masks of a scene that is not measured, or draws
of other things), "scene" ones on other rows of the same scene.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from drawn_embeddings import CLIP, Drawn, unit
from machine import describe

from benchmarks.suite.scenes import BenchScene, read_scene
from drsplat import EncoderIdentity, MiniEncoder, ViewFeatures, load_field, register, train_codebook
from drsplat.field.codes.mixture import encode_mixture, train_scene_atoms
from drsplat.field.codes.mixture.scene_atoms import spherical_kmeans
from drsplat.field.evidence.evidence import Evidence
from drsplat.kernels.mixture import nearest_centres
from drsplat.photos.models.mini.lexicon import COLORS, NAMES

TOP_SHARE = 0.02
CLUSTERS = 150  # of masks, where things are not known
SCENE_ATOMS = 4096
QUERIES = 200
GENERIC_POINTS = 16_384
Reconstruct = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Case:
    """evidence: rows to measure, all with a feature. things: of each column. scene_rows: of the whole scene."""

    name: str
    evidence: Evidence
    things: np.ndarray
    scene_rows: int


@dataclass(frozen=True, eq=False)
class Words:
    """What is searched, with embeddings of the same encoder that codebooks may be trained on."""

    name: str
    encoder: EncoderIdentity
    queries: np.ndarray
    generic: np.ndarray


def sample(evidence: Evidence, rows: int) -> tuple[Evidence, int]:
    """Up to `rows` rows with a feature, and how many there are in all."""
    seen = np.flatnonzero(np.diff(evidence.weights.indptr) > 0)
    chosen = np.random.default_rng(1).choice(seen, min(rows, len(seen)), replace=False)
    return evidence.rows(np.sort(chosen)), len(seen)


def scene_case(folder: Path, masks: str, rows: int, threads: int) -> Case:
    from benchmarks.suite.masks import features_of  # bench_register runs without it with older versions

    scene = read_scene(folder)
    features = features_of(scene, masks, MiniEncoder())
    found = register(scene.gaussians, scene.views, features, threads=threads)
    evidence, total = sample(found.evidence, rows)
    return Case(f"{scene.name}, {masks}", evidence, true_things(scene, features, found.evidence), total)


def true_things(scene: BenchScene, features: dict[str, ViewFeatures], evidence: Evidence) -> np.ndarray:
    """What most pixels of each mask show."""
    masks, views = evidence.masks, {view.name: view for view in scene.views}
    of_view = {}
    for name in masks.view_names:
        ids, maps = scene.ids(views[name]), features[name].mask_ids
        ids = ids[tuple(np.ix_(*(np.arange(m) * i // m for m, i in zip(maps.shape, ids.shape, strict=True))))]
        counts = np.zeros((maps.max() + 1, ids.max() + 2), np.int64)
        np.add.at(counts, (maps[maps >= 0], ids[maps >= 0] + 1), 1)
        of_view[name] = counts.argmax(axis=1)
    return np.array([of_view[masks.view_names[v]][i] for v, i in zip(masks.views, masks.ids, strict=True)])


def field_case(path: Path, rows: int) -> Case:
    evidence = load_field(path).evidence
    if evidence is None:
        raise SystemExit(f"{path} was saved without evidence")
    clusters = spherical_kmeans(evidence.embeddings, min(CLUSTERS, len(evidence.embeddings)), 0, 1)
    part, total = sample(evidence, rows)
    return Case(path.stem, part, nearest_centres(evidence.embeddings, clusters, threads=1), total)


def mini_words(generic: np.ndarray) -> Words:
    encoder = MiniEncoder()
    texts = [*NAMES, *[f"{color} {name}" for name in NAMES for color in COLORS][::2]]
    return Words("mini", encoder.identity, encoder.encode_texts(texts[:QUERIES]), generic)


def with_drawn(case: Case, folder: Path) -> tuple[Case, Words]:
    """The same weights with drawn embeddings, and texts for the things (and some that are not there)."""
    drawn = Drawn(folder)
    ids, of_column = np.unique(case.things, return_inverse=True)
    things = drawn.things(max(QUERIES, len(ids)))
    evidence = replace(case.evidence, embeddings=drawn.masks(things[of_column]))
    generic = drawn.masks(drawn.things(GENERIC_POINTS))
    return replace(case, evidence=evidence), Words("drawn CLIP", CLIP, drawn.texts(things[:QUERIES]), generic)


def product(points: np.ndarray, parts: int, words: Words, threads: int) -> Reconstruct:
    book = train_codebook(points, parts, encoder=words.encoder, threads=threads)
    return lambda rows: book.decode(book.encode(rows, threads=threads))


def scalar(points: np.ndarray) -> Reconstruct:
    """One byte per number, between the extremes of that number."""
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum(high - low, 1e-9) / 255
    return lambda rows: np.rint(np.clip((rows - low) / step, 0, 255)) * step + low


def typical(points: np.ndarray, count: int, threads: int) -> Reconstruct:
    centres = spherical_kmeans(points, min(count, len(points)), 0, threads)
    return lambda rows: centres[nearest_centres(rows, centres, threads=threads)]


def rebuilt(
    case: Case, words: Words, features: np.ndarray, training: np.ndarray, threads: int
) -> Iterator[tuple[str, int, np.ndarray]]:
    """(name, bytes per row, what is decoded) of every code."""
    for kind, points in (("generic", words.generic), ("scene", training)):
        for parts in (32, 64, 128):
            yield f"PQ {kind}", parts, product(points, parts, words, threads)(features)
    yield "SQ8 scene", features.shape[1], scalar(training)(features)
    for count in (1024, 4096):
        yield f"scene atoms alone, {count}", 2, typical(training, count, threads)(features)
    most = min(SCENE_ATOMS, case.scene_rows // 16)
    mixed = case.evidence.rows(np.arange(1, len(case.evidence), 2))
    for count in (0, 1024, most):
        scene = train_scene_atoms(training, count, threads=threads) if count else 0
        for per_row in (2, 4, 6, 8):
            code = encode_mixture(mixed, per_row, scene_atoms=scene, threads=threads)
            name = f"mixture K={per_row}, {count} scene atoms"
            yield name, code.row_bytes, code.decode(slice(None))


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


def study(case: Case, words: Words, threads: int) -> list[dict[str, object]]:
    """Codebooks learn from every other row, and all codes are measured on the rest."""
    features = case.evidence.features(0, len(case.evidence), threads=threads)
    training, measured = features[::2].copy(), features[1::2].copy()
    entries = len(case.evidence.weights.data) / len(case.evidence)
    print(f"\n{case.name}, {words.name}: {case.scene_rows} rows, {len(case.things)} masks, "
          f"{entries:.1f} masks per row; {len(measured)} rows measured, {len(words.queries)} queries")  # fmt: skip
    print("code                            bytes  cosine  score rms  of PQ128  top-2% IoU  argmax")
    found: list[dict[str, object]] = []
    reference = None
    for name, size, decoded in rebuilt(case, words, measured, training, threads):
        numbers = quality(measured, decoded, words.queries)
        if (name, size) == ("PQ scene", 128):
            reference = numbers["score_rms"]
        ratio = f"{numbers['score_rms'] / reference:8.2f}" if reference else " " * 8
        print(f"{name:<31} {size:>5}  {numbers['cosine']:6.2f}  {numbers['score_rms']:.5f}   {ratio}   "
              f"{numbers['selection_iou']:.3f}       {numbers['argmax_agreement']:.3f}", flush=True)  # fmt: skip
        found.append({"case": case.name, "embeddings": words.name, "code": name, "bytes": size, **numbers})
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", type=Path, default=[])
    parser.add_argument("--masks", default="true,graph")
    parser.add_argument("--fields", nargs="*", type=Path, default=[])
    parser.add_argument(
        "--generic", type=Path, default=Path("world/scenes/table_1"),
        help="scene whose masks are the generic embeddings of mini",
    )  # fmt: skip
    parser.add_argument("--statistics", type=Path)
    parser.add_argument("--rows", type=int, default=65_536)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("study_codes.json"))
    args = parser.parse_args()
    print(describe())
    generic = scene_case(args.generic, "graph", 1000, args.threads).evidence.embeddings
    cases = [field_case(path, args.rows) for path in args.fields]
    cases += [scene_case(f, m, args.rows, args.threads) for f in args.scenes for m in args.masks.split(",")]
    found = []
    for case in cases:
        found += study(case, mini_words(generic), args.threads)
        if args.statistics:
            found += study(*with_drawn(case, args.statistics), args.threads)
    args.output.write_text(json.dumps({"machine": describe(), "codes": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
