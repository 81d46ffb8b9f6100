"""Training a codebook: our k-means beside FAISS's, same points, same number of iterations; and a mixture's scene atoms.

    python benchmarks/bench_codebook.py [--points 16384] [--dim 512] [--subvectors 128] [--rounds 3]

FAISS is only a rival here (pip install faiss-cpu). Points are clusters on the unit sphere. Atoms: as many as a scene of
any size has at most, of as many points.
"""

import numpy as np
from machine import arguments, interleaved

from drsplat import Codebook, EncoderIdentity, train_codebook
from drsplat.field.codes.mixture.encoding import MAX_SCENE_ATOMS
from drsplat.field.codes.mixture.scene_atoms import POINTS_PER_ATOM, train_scene_atoms
from drsplat.kernels.kmeans import KMEANS_STEPS


def clusters(rng: np.random.Generator, count: int, dim: int) -> np.ndarray:
    """Unit rows about 300 centres, at a cosine of about 0.8 to them."""
    rows = rng.normal(size=(300, dim))[rng.integers(0, 300, count)]
    rows = rows + 0.75 * rng.normal(size=(count, dim))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def train_faiss(points: np.ndarray, subvectors: int, encoder: EncoderIdentity) -> Codebook:
    import faiss

    quantizer = faiss.ProductQuantizer(points.shape[1], subvectors, 8)
    quantizer.cp.niter, quantizer.cp.min_points_per_centroid = KMEANS_STEPS, 1
    quantizer.train(points)
    centroids = faiss.vector_to_array(quantizer.centroids).reshape(subvectors, 256, -1)
    return Codebook(centroids.copy(), None, encoder)


def main() -> None:
    args = arguments(__doc__, points=16384, dim=512, subvectors=128, rounds=3)
    rng, encoder = np.random.default_rng(0), EncoderIdentity("benchmark", args.dim)
    rows = clusters(rng, args.points + 2000, args.dim)
    points, unseen = rows[: args.points], rows[args.points :]
    trained: dict[str, Codebook] = {}

    def ours() -> None:
        trained["drsplat"] = train_codebook(points, args.subvectors, encoder=encoder)

    def theirs() -> None:
        trained["FAISS"] = train_faiss(points, args.subvectors, encoder)

    seconds = interleaved({"drsplat": ours, "FAISS": theirs}, args.rounds)
    print(f"{args.points:,} points of {args.dim} numbers, {args.subvectors} sub-vectors of 256")
    for name, book in trained.items():
        codes = book.encode(unseen)
        decoded = book.decode(codes)
        cosines = (unseen * decoded).sum(1) * book.inverse_norms(codes)
        times = seconds[name]
        print(
            f"{name:<8} {np.median(times):6.2f} s (median; {times.min():.2f} to {times.max():.2f}), "
            f"mean cosine of unseen rows {cosines.mean():.4f}"
        )
    some = clusters(rng, POINTS_PER_ATOM * MAX_SCENE_ATOMS, args.dim)
    times = interleaved({"atoms": lambda: train_scene_atoms(some, MAX_SCENE_ATOMS)}, args.rounds)["atoms"]
    print(f"{MAX_SCENE_ATOMS:,} scene atoms of {len(some):,} points: {np.median(times):.2f} s (median)")


if __name__ == "__main__":
    main()
