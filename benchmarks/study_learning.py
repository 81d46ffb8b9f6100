"""What it costs a code to be learnt from some of a scene's views instead of all: cosine and error of its features.

    python benchmarks/study_learning.py [--gaussians 100000] [--views 120] [--learnt 64 32] [--noise 0.3 0.8 1.5]

A room of Gaussians (rooms.py), each seen in about 13 of the views, which see a third of the room each. Masks are cells
of a grid; an embedding is that of its cell's kind and noise of a length, as encoders give of one thing in many photos.
"""

import numpy as np
from machine import arguments
from rooms import room, unit_rows
from scipy.sparse import csr_array

from drsplat import PQ, EncoderIdentity, Gaussians, Mixture, Registration
from drsplat.field import learning
from drsplat.field.evidence.evidence import Evidence, MaskIds

SEEN, SIDE, DIM, TWICE = 13, 5, 512, 0.15
KINDS = SIDE**3
ALL = 1_000_000


def weights(gaussians: Gaussians, views: int, rng: np.random.Generator) -> csr_array:
    count, low, high = len(gaussians), gaussians.means.min(0), gaussians.means.max(0)
    places, columns = (gaussians.means - low) / (high - low), []
    for _ in range(SEEN):
        view = ((places[:, 0] * views * 0.7).astype(np.int64) + rng.integers(0, int(views * 0.3), count)) % views
        shift = np.stack([np.sin(view + axis) for axis in range(3)], axis=1) * 0.03
        cell = np.clip((places + shift) * SIDE, 0, SIDE - 1e-3).astype(np.int64)
        columns.append(view * KINDS + np.ravel_multi_index(tuple(cell.T), (SIDE,) * 3))
        other = view * KINDS + rng.integers(0, KINDS, count)
        columns.append(np.where(rng.random(count) < TWICE, other, columns[-1]))
    rows = np.tile(np.arange(count), len(columns))
    entries = rng.random(len(rows), np.float32) + np.float32(0.1)
    w = csr_array((entries, (rows, np.concatenate(columns))), shape=(count, views * KINDS))
    w.sum_duplicates()
    w.sort_indices()
    return csr_array(w)


def embeddings(kinds: np.ndarray, views: int, noise: float, rng: np.random.Generator) -> np.ndarray:
    rows = np.tile(kinds, (views, 1)) + noise * unit_rows(rng, views * KINDS, DIM)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), np.float32)


def main() -> None:
    args = arguments(__doc__, gaussians=100_000, views=120, learnt=[ALL, 64, 32], noise=[0.3, 0.8, 1.5])
    rng = np.random.default_rng(0)
    gaussians, kinds = room(args.gaussians), unit_rows(rng, KINDS, DIM)
    w = weights(gaussians, args.views, rng)
    numbers = np.divmod(np.arange(args.views * KINDS, dtype=np.int32), np.int32(KINDS))
    masks = MaskIds(tuple(f"{view:05d}.jpg" for view in range(args.views)), *numbers)
    print("| noise | code | learnt from | cosine | lowest hundredth | rms of scores |\n|---|---|---|---|---|---|")
    for noise in args.noise:
        evidence = Evidence(w, masks, embeddings(kinds, args.views, noise, rng))
        registration = Registration(evidence, gaussians.fingerprint, EncoderIdentity("drawn", DIM))
        for code in (Mixture(), PQ()):
            for learning.MAX_LEARNING_VIEWS in args.learnt:
                field = registration.to_field(code)
                some = np.arange(0, len(field), 17)
                exact = evidence.rows(field.gaussian_ids[some].astype(np.int64)).features(0, len(some))
                cosines = np.einsum("nd,nd->n", exact, field.feature(some))
                errors = (exact - field.feature(some)) @ kinds.T
                few = "all" if args.views <= learning.MAX_LEARNING_VIEWS else f"{learning.MAX_LEARNING_VIEWS}"
                print(
                    f"| {noise} | {field.code.kind} | {few} | {cosines.mean():.4f} | {np.quantile(cosines, 0.01):.4f} "
                    f"| {np.sqrt((errors**2).mean()):.5f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
