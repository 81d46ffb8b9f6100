"""Likelihood that two touching regions belong to one object: a network of one hidden layer, trained in `world/`."""

import hashlib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from ....base.arrays import Float64
from ....kernels.photo_regions import PairRule

LIKELIHOOD_DECIMALS = 6  # a product's last bits depend on the processor


@dataclass(frozen=True, eq=False)
class MergeRule:
    """Rule for merging regions. center, width: of each feature. threshold: pairs above it are merged."""

    center: Float64[np.ndarray, " f"]
    width: Float64[np.ndarray, " f"]
    hidden: Float64[np.ndarray, "f h"]
    hidden_bias: Float64[np.ndarray, " h"]
    output: Float64[np.ndarray, " h"]
    output_bias: Float64[np.ndarray, " 1"]
    threshold: Float64[np.ndarray, " 1"]

    @property
    def parts(self) -> PairRule:
        """All fields but the threshold, in the order of the native code."""
        return self.center, self.width, self.hidden, self.hidden_bias, self.output, self.output_bias

    def likelihood(self, features: Float64[np.ndarray, "e f"]) -> Float64[np.ndarray, " e"]:
        """Return the likelihood of each pair, 0 to 1, rounded to LIKELIHOOD_DECIMALS."""
        scaled = np.clip((features - self.center) / self.width, -5, 5)
        inner = np.tanh(scaled @ self.hidden + self.hidden_bias)
        logit = inner @ self.output + self.output_bias
        return np.asarray(np.round(1 / (1 + np.exp(-logit)), LIKELIHOOD_DECIMALS))


def shipped_rule() -> tuple[MergeRule, str]:
    """Return the rule in the package and the BLAKE2b hash of its file."""
    data = (files(__package__) / "rule.safetensors").read_bytes()
    return read_rule(data), hashlib.blake2b(data, digest_size=8).hexdigest()


def read_rule(data: bytes) -> MergeRule:
    """Parse the bytes of a file that `world.segmenter.tuning` wrote."""
    from safetensors.numpy import load

    return MergeRule(**{name: array.astype(np.float64) for name, array in load(data).items()})
