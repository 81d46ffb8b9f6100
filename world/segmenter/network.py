"""The rule's network learned from pairs: weighted cross-entropy, L-BFGS."""

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import minimize

from drsplat.graph.rule import MergeRule


def learn_rule(
    features: Float64[np.ndarray, "e f"],
    together: Bool[np.ndarray, " e"],
    weights: Float64[np.ndarray, " e"],
    hidden: int = 24,
    steps: int = 300,
) -> MergeRule:
    """together: that both regions of a pair belong to one thing. weights: of each pair's loss."""
    center, width = features.mean(0), features.std(0) + 1e-6
    inputs = np.clip((features - center) / width, -5, 5)
    count = inputs.shape[1]
    shapes = [(count, hidden), (hidden,), (hidden,), (1,)]
    rng = np.random.default_rng(0)
    start = np.concatenate(
        [
            rng.normal(0, count**-0.5, count * hidden),
            np.zeros(hidden),
            rng.normal(0, 0.1, hidden),
            [0],
        ]
    )
    share = weights / weights.sum()

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        w1, b1, w2, b2 = _split(flat, shapes)
        inner = np.tanh(inputs @ w1 + b1)
        logit = inner @ w2 + b2
        value = share @ (np.logaddexp(0, logit) - together * logit)
        error = share * (1 / (1 + np.exp(-logit)) - together)
        back = np.outer(error, w2) * (1 - inner**2)
        slopes = [inputs.T @ back, back.sum(0), inner.T @ error, error.sum(keepdims=True)]
        decay = 1e-5 * flat
        return value + flat @ decay / 2, np.concatenate([s.ravel() for s in slopes]) + decay

    best = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": steps})
    w1, b1, w2, b2 = _split(best.x, shapes)
    return MergeRule(center, width, w1, b1, w2, b2, np.array([0.5]))


def _split(flat: np.ndarray, shapes: list[tuple[int, ...]]) -> list[np.ndarray]:
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    return [p.reshape(s) for p, s in zip(np.split(flat, ends[:-1]), shapes, strict=True)]
