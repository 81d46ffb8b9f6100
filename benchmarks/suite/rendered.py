"""The rival that rendering-based methods are: features that are right when they are rendered, looked up in 3D.

LangSplat and LEGaussians optimise features per Gaussian so that their alpha-blended rendering is the
embedding of the mask at each pixel. Here that is the least-squares problem min |A F - E|^2, A the blending
weights of pixels x Gaussians, E the masks' embeddings, solved by conjugate gradients from zero. There is no
autoencoder: features are in the span of the embeddings' leading directions, far more than LangSplat's three.
What is asked of the features is asked as of all others: per Gaussian, by cosine.

One step from zero is along the weighted mean that registration takes, on the same coarse pixels: the
control that tells what the fitting does from what the coarseness does.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32
from scipy.sparse import csr_array, vstack

from drsplat import Gaussians, MiniEncoder, View, ViewFeatures
from drsplat.evaluation.scorers import COSINE_SWEEP, Scorer
from drsplat.kernels import splat_arrays

from .blending import blending_of

RENDERED, ONE_STEP = "rendered", "rendered-one-step"
WIDTH = 128  # pixels of what is rendered
CONTRIBUTORS = 16  # of a pixel
DIRECTIONS = 16
STEPS = {RENDERED: 30, ONE_STEP: 1}
"""Of conjugate gradients, by method."""


def rendered_scorer(
    name: str, gaussians: Gaussians, seen: Mapping[View, ViewFeatures], encoder: MiniEncoder, threads: int
) -> Scorer:
    """Cosines with features that were fitted by rendering; NaN where no photo sees a Gaussian."""
    splats, embeddings = splat_arrays(gaussians), []
    parts = []
    for view, features in seen.items():
        parts.append(blending_of(splats, view, features, WIDTH, CONTRIBUTORS, threads))
        embeddings.append(features.embeddings[parts[-1].masks])
    weights = csr_array(vstack([part.weights for part in parts], format="csr"))
    targets, basis = _leading(np.concatenate(embeddings))
    fitted = least_squares(weights, targets, STEPS[name])
    norms = np.linalg.norm(fitted, axis=1)
    norms[norms == 0] = np.nan

    def scores(text: str) -> Float32[np.ndarray, " N"]:
        query = basis @ encoder.encode_texts([text])[0]
        return np.asarray(fitted @ query / norms, np.float32)

    about = {"directions": DIRECTIONS, "steps": STEPS[name], "width": WIDTH, "measure": "cosine"}
    names = tuple(view.name for view in seen)
    return Scorer(name, len(gaussians), scores, encoder.threshold, COSINE_SWEEP, about, names)


def least_squares(weights: csr_array, targets: Float32[np.ndarray, "p r"], steps: int) -> Float32[np.ndarray, "n r"]:
    """Conjugate gradients on the normal equations, from zero. All columns share their steps, so that the
    first one keeps the directions of weights^T targets.

    Source: Hestenes and Stiefel 1952 (CGLS).
    """
    transposed = csr_array(weights.T)
    found = np.zeros((weights.shape[1], targets.shape[1]), np.float32)
    residual = targets.copy()
    gradient = transposed @ residual
    direction, size = gradient.copy(), _square(gradient)
    for _ in range(steps):
        moved = weights @ direction
        length = _square(moved)
        if not length > 0:
            break
        step = np.float32(size / length)
        found += direction * step
        residual -= moved * step
        gradient = transposed @ residual
        before, size = size, _square(gradient)
        direction = gradient + direction * np.float32(size / before)
    return found


def _leading(embeddings: Float32[np.ndarray, "p d"]) -> tuple[Float32[np.ndarray, "p r"], Float32[np.ndarray, "r d"]]:
    """The embeddings along their leading directions, and these."""
    squares = embeddings.T.astype(np.float64) @ embeddings
    _, vectors = np.linalg.eigh(squares)
    basis = np.ascontiguousarray(vectors[:, ::-1][:, :DIRECTIONS].T, np.float32)
    return embeddings @ basis.T, basis


def _square(values: Float32[np.ndarray, "n r"]) -> float:
    return float(np.square(values).sum(dtype=np.float64))
