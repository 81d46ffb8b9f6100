"""Small evidence, codebooks and encoders for tests."""

from collections.abc import Sequence
from functools import lru_cache
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save
from scipy.sparse import csr_array, random_array

from drsplat.field import LanguageField, build_field
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from drsplat.formats.tensors import TENSORS, map_tensors
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.gaussians import Gaussians

OFFICIAL_INDEX = Path(__file__).resolve().parents[3] / "shared/data/official/pq_index.faiss"
TOY = EncoderIdentity("toy", 32, "w0")
SCENE = "600-0123456789abcdef"
SEED = "rng" if "rng" in signature(random_array).parameters else "random_state"  # before SciPy 1.15


def unit_rows(rng: np.random.Generator, count: int, dim: int) -> np.ndarray:
    rows = rng.standard_normal((count, dim)).astype(np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def with_flat_objects(field: LanguageField, gaussians: Gaussians, node_of: np.ndarray) -> LanguageField:
    """Return a field with objects that are no part of each other. node_of: the object of each registered row."""
    count = int(node_of.max()) + 1
    sizes = np.full(count, -1, np.int32), np.ones(count, np.uint8), np.ones(count, np.float32)
    return field.with_objects(describe(field, gaussians, Tree(node_of.astype(np.int32), *sizes)))


def random_weights(rng: np.random.Generator, rows: int, columns: int, density: float) -> csr_array:
    weights = random_array((rows, columns), density=density, format="csr", dtype=np.float32, **{SEED: rng})
    return csr_array(weights)


def random_evidence(rng: np.random.Generator, rows: int = 600, columns: int = 40, dim: int = 32) -> Evidence:
    """Sparse enough that some rows are empty."""
    views = np.sort(rng.integers(0, 3, columns)).astype(np.int32)
    masks = MaskIds(("a.jpg", "b.jpg", "c.jpg"), views, np.arange(columns, dtype=np.int32))
    weights = random_weights(rng, rows, columns, 2 / columns)
    return Evidence(weights, masks, unit_rows(rng, columns, dim))


@lru_cache
def toy_field(seed: int = 0) -> LanguageField:
    evidence = random_evidence(np.random.default_rng(seed))
    return build_field(evidence, SCENE, TOY)


class ToyEncoder:
    """Every text its own direction; counts how often it is asked."""

    def __init__(self, identity: EncoderIdentity = TOY) -> None:
        self.identity, self.asked = identity, 0

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        self.asked += len(texts)
        return np.concatenate([unit_rows(np.random.default_rng(list(t.encode())), 1, self.identity.dim) for t in texts])


def unchecked(patch: pytest.MonkeyPatch) -> None:
    """Compare no file of a field with its checksums, so that damage gets past them."""
    for name in ("check_checksums", "check_seal"):
        patch.setattr(f"drsplat.field.loading.{name}", lambda *_, **__: None)


def without_checksums(path: Path) -> None:
    """A safetensors file as the library safetensors writes it."""
    tensors, metadata = map_tensors(path)
    kept = {name: text for name, text in metadata.items() if not name.startswith(TENSORS)}
    path.write_bytes(save({name: np.array(array) for name, array in tensors.items()}, kept))
