"""The paper's studies of product quantisation (Sec. D) and what reconstruction cosine does not show.

    python benchmarks/study_pq.py [--points 1000000] [--repeats 100] [--output study_pq.json]
        [--scenes world/scenes/room_5 ...] [--skip search|codes] [--chart search.svg]

D.1: milliseconds for one query over all points, for 128, 64 and 32 sub-vectors: raw cosine (NumPy, float32),
FAISS IndexPQ (top 100) and ours (every score). Codes are random: time does not depend on them.
D.2: codes of 1/32, 1/16 and 1/8 of float32 by LSH (random projection), an autoencoder and PQ, all learnt on one
half of the features and measured on the other: mean cosine of reconstruction (Table S2), and for searches the
rms error of scores, the IoU of the best 2 % and how often the best of all queries is the same one.
Features: those of packed scenes, registered with the masks of `graph` and the embeddings of `mini`; queries are their
words. Of several scenes, codes are learnt and measured on each by itself, and means are printed with their intervals.
More codes on more features, without the paper's rivals: study_codes.py.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from drawn_embeddings import unit
from machine import arguments, describe, interleaved
from study_codes import mini_words, quality, scene_case

from drsplat import Codebook, EncoderIdentity, train_codebook
from drsplat.evaluation.metrics import mean, mean_interval
from drsplat.evaluation.svg import bars
from drsplat.field.codes import Codes, pq_code

SUBVECTORS = (128, 64, 32)
RATIOS = (32, 16, 8)
SCENE = Path(__file__).resolve().parent.parent / "world/scenes/room_5"
ROWS = 1 << 16
NUMBERS = ("cosine", "score_rms", "selection_iou", "argmax_agreement")
PAPER_SEARCH = {128: 2.0, 64: 6.6, 32: 14.1}
PAPER_COSINE = {
    "LSH": {32: 79.71, 16: 88.35, 8: 93.69},
    "autoencoder": {32: 82.58, 16: 84.03, 8: 85.18},
    "PQ": {32: 90.86, 16: 96.06, 8: 99.02},
}


def search_times(points: int, dim: int, repeats: int, threads: int) -> dict[str, dict[str, float]]:
    """Median milliseconds by engine."""
    rng = np.random.default_rng(0)
    query = unit(rng.normal(size=(1, dim)))[0]
    rivals: dict[str, Callable[[], object]] = {}
    features = np.empty((points, dim), np.float32)
    for start in range(0, points, 1 << 16):
        block = features[start : start + (1 << 16)]
        block[:] = rng.standard_normal(block.shape, np.float32)
    rivals["raw cosine"] = lambda: features @ query
    for parts in SUBVECTORS:
        centroids = rng.normal(size=(parts, 256, dim // parts)).astype(np.float32)
        codes = rng.integers(0, 256, (points, parts), np.uint8)
        book = Codebook(centroids, None, EncoderIdentity("random", dim))
        code = pq_code(book, Codes(codes), np.ones(points, np.float32))
        rivals[f"ours {parts}"] = lambda c=code: c.scores(query[None], threads=threads)
        index = faiss_index(centroids, codes, threads)
        if index is not None:
            rivals[f"FAISS {parts}"] = lambda i=index: i.search(query[None], 100)
    seconds = interleaved(rivals, repeats)
    return {
        name: {"median_ms": 1e3 * float(np.median(s)), "mean_ms": 1e3 * float(s.mean()), "min_ms": 1e3 * float(s.min())}
        for name, s in seconds.items()
    }  # fmt: skip


def faiss_index(centroids: np.ndarray, codes: np.ndarray, threads: int) -> object | None:
    """None where FAISS is not installed."""
    try:
        import faiss
    except ImportError:
        return None
    if threads:
        faiss.omp_set_num_threads(threads)
    parts, dim = len(centroids), len(centroids) * centroids.shape[2]
    index = faiss.IndexPQ(dim, parts, 8, faiss.METRIC_INNER_PRODUCT)
    faiss.copy_array_to_vector(centroids.ravel(), index.pq.centroids)
    faiss.copy_array_to_vector(codes.ravel(), index.codes)
    index.is_trained, index.ntotal = True, len(codes)
    return index


Reconstruct = Callable[[np.ndarray], np.ndarray]


def lsh(train: np.ndarray, num_bytes: int) -> Reconstruct:
    """Signs of random projections, a rotation where they are as many as the numbers of a feature."""
    count, dim = 8 * num_bytes, train.shape[1]
    drawn = np.random.default_rng(1).normal(size=(max(count, dim), min(count, dim)))
    frame = np.linalg.qr(drawn)[0].astype(np.float32)
    planes = frame if count >= dim else np.ascontiguousarray(frame.T)
    return lambda rows: np.where(rows @ planes.T > 0, 1, -1).astype(np.float32) @ planes


def product(train: np.ndarray, num_bytes: int) -> Reconstruct:
    book = train_codebook(train, num_bytes, encoder=EncoderIdentity("study", train.shape[1]))
    return lambda rows: book.decode(Codes(book.encode(rows).codes))


def autoencoder(train: np.ndarray, num_bytes: int, steps: int = 1000) -> Reconstruct | None:
    """Of a latent of num_bytes / 4 floats, as LangSplat's; None where torch is not installed."""
    try:
        import torch
    except ImportError:
        return None
    torch.manual_seed(0)
    torch.set_num_threads(1)  # batches this small lose more by waiting for each other
    dim, latent = train.shape[1], num_bytes // 4
    net = torch.nn.Sequential(
        torch.nn.Linear(dim, 256), torch.nn.GELU(), torch.nn.Linear(256, latent),
        torch.nn.Linear(latent, 256), torch.nn.GELU(), torch.nn.Linear(256, dim),
    )  # fmt: skip
    optimizer, rows = torch.optim.Adam(net.parameters(), 1e-3), torch.from_numpy(train)
    for step in range(steps):
        batch = rows[torch.randint(len(rows), (256,))]
        loss = 1 - torch.cosine_similarity(net(batch), batch).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        for group in optimizer.param_groups:
            group["lr"] = 1e-3 * (1 - step / steps)

    def reconstruct(given: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return net(torch.from_numpy(given)).numpy()

    return reconstruct


def code_study(features: np.ndarray, queries: np.ndarray) -> list[dict[str, object]]:
    train, test = features[::2].copy(), features[1::2].copy()
    found: list[dict[str, object]] = []
    for name, make in (("LSH", lsh), ("autoencoder", autoencoder), ("PQ", product)):
        for ratio in RATIOS:
            num_bytes = 4 * features.shape[1] // ratio
            reconstruct = make(train, num_bytes)
            if reconstruct is None:
                print(f"{name}: left out, its library is not installed")
                break
            numbers = quality(test, reconstruct(test), queries)
            found.append({"code": name, "ratio": ratio, "bytes": num_bytes, **numbers})
    return found


def show_search(times: dict[str, dict[str, float]]) -> None:
    raw = times["raw cosine"]["median_ms"]
    for name, numbers in times.items():
        parts = int(name.split()[-1]) if name[-1].isdigit() else None
        paper = f", paper {PAPER_SEARCH[parts]} x" if parts else ""
        ms = numbers["median_ms"]
        print(f"{name:<12} {ms:8.2f} ms (median), {raw / ms:5.1f} x raw cosine{paper}")


def show_codes(studies: list[list[dict[str, object]]]) -> None:
    """Means over scenes, the cosine with its interval."""
    print("| code | size | bytes | cosine % | paper | score rms | top-2 % IoU | argmax |")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for rows in zip(*studies, strict=True):
        row = rows[0]
        paper = PAPER_COSINE[str(row["code"])][int(str(row["ratio"]))]
        means = {key: mean([float(str(row[key])) for row in rows]) for key in NUMBERS}
        low, high = mean_interval([float(str(row["cosine"])) for row in rows])
        print(
            f"| {row['code']} | 1/{row['ratio']} | {row['bytes']} | {means['cosine']:.2f} [{low:.2f}, {high:.2f}] "
            f"| {paper:.2f} | {means['score_rms']:.5f} | {means['selection_iou']:.3f} "
            f"| {means['argmax_agreement']:.3f} |"
        )


def codes_of(folder: Path, threads: int) -> list[dict[str, object]]:
    case = scene_case(folder, "graph", ROWS, threads)
    features = case.evidence.features(0, len(case.evidence))
    return code_study(features, mini_words(features).queries)


def main() -> None:
    args = arguments(
        __doc__, points=1_000_000, dim=512, repeats=100, threads=0, scenes=[str(SCENE)], skip=("search", "codes"),
        output="study_pq.json", chart=str,
    )  # fmt: skip
    report: dict[str, object] = {"machine": describe(), "points": args.points, "repeats": args.repeats}
    if args.skip != "search":
        times = search_times(args.points, args.dim, args.repeats, args.threads)
        report["search"] = times
        show_search(times)
        if args.chart:
            rows = [(name, numbers["mean_ms"]) for name, numbers in times.items()]
            title = f"One query over {args.points:,} points"
            Path(args.chart).write_text(bars(rows, "ms", title), encoding="utf-8")
    if args.skip != "codes":
        studies = {folder: codes_of(Path(folder), args.threads) for folder in args.scenes}
        report["codes"] = studies
        show_codes(list(studies.values()))
    Path(args.output).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
