"""The rule's network learned from pairs: weighted cross-entropy, L-BFGS."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.optimize import minimize

from drsplat.photos.models.graph.segmenter import MergeRule

_DECAY = 3e-5


def first_rule(features: Float64[np.ndarray, "e f"], hidden: int) -> MergeRule:
    """One that knows nothing but how features are spread; always the same."""
    rng, count = np.random.default_rng(0), features.shape[1]
    weights = rng.normal(0, count**-0.5, (count, hidden)), rng.normal(0, 0.1, hidden)
    none = np.zeros(1)
    center, width = features.mean(0), features.std(0) + 1e-6
    return MergeRule(center, width, weights[0], np.zeros(hidden), weights[1], none, none + 0.5)


def learn_rule(
    rule: MergeRule,
    features: Float64[np.ndarray, "e f"],
    together: Bool[np.ndarray, " e"],
    weights: Float64[np.ndarray, " e"],
    steps: int,
) -> MergeRule:
    """The rule after more steps. together: that both regions of a pair belong to one thing.

    weights: of each pair's loss. Products are in single precision, which halves the time.
    """
    inputs = np.clip((features - rule.center) / rule.width, -5, 5).astype(np.float32)
    parts = [rule.hidden, rule.hidden_bias, rule.output, rule.output_bias]
    share, truth = (weights / weights.sum()).astype(np.float32), together.astype(np.float32)

    def loss(flat: Float64[np.ndarray, " p"]) -> tuple[float, Float64[np.ndarray, " p"]]:
        w1, b1, w2, b2 = _split(flat.astype(np.float32), parts)
        inner = np.tanh(inputs @ w1 + b1)
        logit = inner @ w2 + b2
        value = share @ (np.logaddexp(0, logit) - truth * logit)
        error = share * (1 / (1 + np.exp(-logit)) - truth)
        back = np.outer(error, w2) * (1 - inner**2)
        slopes = [inputs.T @ back, back.sum(0), inner.T @ error, error.sum(keepdims=True)]
        joined = np.concatenate([slope.ravel() for slope in slopes]).astype(np.float64)
        return float(value) + _DECAY * float(flat @ flat) / 2, joined + _DECAY * flat

    start = np.concatenate([part.ravel() for part in parts])
    best = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": steps})
    return MergeRule(rule.center, rule.width, *_split(best.x, parts), rule.threshold)


def padded(rule: MergeRule, count: int) -> MergeRule:
    """The same rule for so many features, of which it does not look at the last ones."""
    more = count - len(rule.center)
    center, width = np.append(rule.center, np.zeros(more)), np.append(rule.width, np.ones(more))
    return replace(rule, center=center, width=width, hidden=np.pad(rule.hidden, ((0, more), (0, 0))))


def both(first: MergeRule, second: MergeRule) -> MergeRule:
    """One rule whose logit is the mean of those of two, but for features that are further out than is looked at."""
    first = padded(first, len(second.center))
    inner = first.hidden * (second.width / first.width)[:, None]
    bias = first.hidden_bias + ((second.center - first.center) / first.width) @ first.hidden
    return replace(
        second,
        hidden=np.concatenate([inner, second.hidden], axis=1),
        hidden_bias=np.append(bias, second.hidden_bias),
        output=np.append(first.output, second.output) / 2,
        output_bias=(first.output_bias + second.output_bias) / 2,
    )


def _split(flat: Float32[np.ndarray, " p"] | Float64[np.ndarray, " p"], like: Sequence[np.ndarray]) -> list[np.ndarray]:
    ends = np.cumsum([part.size for part in like])
    pieces = np.split(flat, ends[:-1])
    return [piece.reshape(part.shape) for piece, part in zip(pieces, like, strict=True)]
