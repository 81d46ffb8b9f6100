"""How likely two touching regions belong to one thing: a network of one hidden layer, learned in `world/`."""

import hashlib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from ...arrays import Float64
from ...kernels.photo_regions import PairRule

DIGITS = 6  # that count: the last bits of a product depend on the processor


@dataclass(frozen=True, eq=False)
class MergeRule:
    """center, width: of each feature. threshold: pairs above it are merged."""

    center: Float64[np.ndarray, " f"]
    width: Float64[np.ndarray, " f"]
    hidden: Float64[np.ndarray, "f h"]
    hidden_bias: Float64[np.ndarray, " h"]
    output: Float64[np.ndarray, " h"]
    output_bias: Float64[np.ndarray, " 1"]
    threshold: Float64[np.ndarray, " 1"]

    @property
    def parts(self) -> PairRule:
        """All but the threshold, as the native code takes them."""
        return self.center, self.width, self.hidden, self.hidden_bias, self.output, self.output_bias

    def likelihood(self, features: Float64[np.ndarray, "e f"]) -> Float64[np.ndarray, " e"]:
        """0 to 1, rounded to DIGITS."""
        scaled = np.clip((features - self.center) / self.width, -5, 5)
        inner = np.tanh(scaled @ self.hidden + self.hidden_bias)
        logit = inner @ self.output + self.output_bias
        return np.asarray(np.round(1 / (1 + np.exp(-logit)), DIGITS))


def shipped_rule() -> tuple[MergeRule, str]:
    """The one in the package, and the BLAKE2b hash of its file."""
    data = (files(__package__) / "rule.safetensors").read_bytes()
    return read_rule(data), hashlib.blake2b(data, digest_size=8).hexdigest()


def read_rule(data: bytes) -> MergeRule:
    """From the bytes of a file as `world.segmenter.tuning` writes it."""
    from safetensors.numpy import load

    return MergeRule(**{name: array.astype(np.float64) for name, array in load(data).items()})
