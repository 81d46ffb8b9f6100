"""Features per Gaussian that other systems have on disk, for `drsplat evaluate --features`.

| file | what it is |
|---|---|
| `.npy`, `.safetensors` | (N, D): a row per Gaussian |
| `.npz` with `leaf_feat` and `leaf_ind` | OpenGaussian's `cluster_lang.npz`: features of leaves, and each one's leaf |
| `.pth`, `.pt`, `.ckpt` | PyTorch's (`weights_only`: nothing in it is run): a tensor of (N, D), or LangSplat's |

LangSplat's checkpoints hold three numbers per Gaussian; its autoencoder's checkpoint turns them into 512. Rows are
decoded a block at a time, when they are asked for.
"""

import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..base.arrays import Array, ArraysByName
from ..base.contents import open_file
from ..errors import DrSplatError, FormatError, InputError, MissingExtraError
from .npy import map_npy, read_npy
from .tensors import map_tensors

TORCH = (".pth", ".pt", ".ckpt")
FLOATS = (np.float16, np.float32)
MAX_NESTING = 4  # lists and dictionaries around a tensor
_LAYER = re.compile(r"(?:module\.)?decoder\.(\d+)\.weight")
CODE_DIM = 3  # of LangSplat's codes, one a Gaussian


@runtime_checkable
class Rows(Protocol):
    """(N, D) of float16 or float32, of which slices of rows can be had."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice) -> Array: ...


@dataclass(frozen=True, eq=False)
class Computed:
    """Rows that are computed when they are asked for."""

    shape: tuple[int, int]
    dtype: np.dtype[Any]
    rows: Callable[[slice], Array]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> Array:
        return self.rows(rows)


def read_peer_features(path: Path, decoder: Path | None = None) -> Rows:
    """Return the features of another system, a row per Gaussian.

    decoder: LangSplat's autoencoder, whose codes are in `path`.

    Raises: InputError: there is no such file, or it holds no features in a form that is known. FormatError: damaged.
    MissingExtraError: a file of PyTorch's where that is not installed.
    """
    found = _read(path)
    if found.dtype not in FLOATS or len(found.shape) != 2:
        raise InputError(
            f"{path}: expected float16 or float32 (N, D), one row per Gaussian; got {found.dtype} {found.shape}"
        )
    if decoder is not None:
        return _decoded(np.asarray(found[:]), _layers(decoder, found.shape[1]))
    if found.shape[1] == CODE_DIM:
        raise InputError(
            f"{path}: three numbers a Gaussian are codes of LangSplat's autoencoder: pass its checkpoint, decoder=FILE"
        )
    return found


def _read(path: Path) -> Rows:
    suffix = path.suffix.lower()
    if suffix == ".safetensors":
        return _only(map_tensors(path)[0], path)
    if suffix == ".npz":
        return _leaves(path)
    return _only(_torch(path), path) if suffix in TORCH else map_npy(path)


def _leaves(path: Path) -> Rows:
    """Read the features of OpenGaussian's clusters."""
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            parts = {Path(name).stem.removesuffix(".npy"): name for name in archive.namelist()}
            if not {"leaf_feat", "leaf_ind"} <= set(parts):
                raise InputError(f"{path}: expected the arrays leaf_feat and leaf_ind, found {sorted(parts)[:6]}")
            features, leaves = (
                read_npy(archive.read(parts[name]), f"{path}: {name}") for name in ("leaf_feat", "leaf_ind")
            )
    except DrSplatError:
        raise
    except (zipfile.BadZipFile, EOFError, OSError, NotImplementedError, RuntimeError, MemoryError) as error:
        raise FormatError(f"{path}: not a sound .npz: {error}") from error
    leaves = leaves.reshape(-1)
    if features.ndim != 2 or leaves.dtype.kind not in "iu" or features.dtype not in FLOATS:
        raise InputError(f"{path}: expected leaf_feat (L, D) of floats and leaf_ind (N) of integers")
    if len(leaves) and int(leaves.max()) >= len(features):
        raise FormatError(f"{path}: a Gaussian is of leaf {int(leaves.max())}, and there are {len(features)}")

    def rows(some: slice) -> Array:
        chosen = leaves[some]
        return np.where((chosen >= 0)[:, None], features[chosen], features.dtype.type(0))

    return Computed((len(leaves), features.shape[1]), features.dtype, rows)


def _torch(path: Path) -> ArraysByName:
    """Return the tensors of a PyTorch file, by their place in it."""
    with open_file(path) as file:
        try:
            import torch
        except ImportError:
            raise MissingExtraError(f"{path}: a file of PyTorch's needs it: pip install torch") from None
        try:
            loaded = torch.load(file, map_location="cpu", weights_only=True)
        except Exception as error:  # of any kind, by what is in the file
            first = str(error).strip().split("\n")[0][:200]
            raise FormatError(
                f"{path}: not a file of tensors that PyTorch reads without running what is in it ({first}); save its "
                "features as .npy"
            ) from error
    return {name: tensor.detach().numpy() for name, tensor in _tensors(loaded, "", torch.Tensor)}


def _tensors(value: Any, name: str, tensor: type, depth: int = 0) -> Iterator[tuple[str, Any]]:
    if isinstance(value, tensor):
        yield name, value
    elif depth < MAX_NESTING and isinstance(value, Mapping):
        for key, part in value.items():
            yield from _tensors(part, f"{name}.{key}".lstrip("."), tensor, depth + 1)
    elif depth < MAX_NESTING and isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for number, part in enumerate(value):
            yield from _tensors(part, f"{name}.{number}".lstrip("."), tensor, depth + 1)


def _only(arrays: ArraysByName, path: Path) -> Array:
    """Return the only array that can be features; in LangSplat's checkpoints that is the last of its width."""
    wide = {name: array for name, array in arrays.items() if array.ndim == 2 and array.dtype in FLOATS}
    named = [array for name, array in wide.items() if "feature" in name.lower()]
    if len(named) == 1:
        return named[0]
    if len(wide) == 1:
        return next(iter(wide.values()))
    checkpoint = wide.get("0.7")
    if checkpoint is not None and checkpoint.shape[1] == CODE_DIM and "0.1" in wide:
        return checkpoint  # (parameters, iteration) as 3DGS saves them: position is 0.1, LangSplat's codes are 0.7
    listed = ", ".join(f"{name or 'it'} {array.shape}" for name, array in list(wide.items())[:6]) or "none"
    raise InputError(f"{path}: expected one array of (N, D) floats, or one whose name has 'feature'; found {listed}")


def _decoded(codes: Array, layers: Sequence[tuple[Array, Array]]) -> Rows:
    """Return codes of an autoencoder, decoded: linear layers with ReLU between, then unit length."""

    def rows(some: slice) -> Array:
        found = codes[some].astype(np.float32)
        lengths = np.linalg.norm(found, axis=1, keepdims=True)
        found = found / np.maximum(lengths, 1e-9)
        for number, (weight, bias) in enumerate(layers):
            found = (np.maximum(found, 0) if number else found) @ weight.T + bias
        norms = np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
        return np.where(lengths > 0, found / norms, np.float32(0))

    return Computed((len(codes), len(layers[-1][1])), np.dtype(np.float32), rows)


def _layers(path: Path, width: int) -> tuple[tuple[Array, Array], ...]:
    arrays = map_tensors(path)[0] if path.suffix == ".safetensors" else _torch(path)
    numbers = sorted((int(known[1]), name) for name in arrays if (known := _LAYER.fullmatch(name)))
    layers = []
    for _, name in numbers:
        weight, bias = arrays[name], arrays.get(name.replace("weight", "bias"))
        if weight.ndim != 2 or bias is None or bias.shape != weight.shape[:1] or weight.shape[1] != width:
            raise FormatError(f"{path}: {name}: expected a layer of {width} inputs with its bias, got {weight.shape}")
        layers.append((weight.astype(np.float32), bias.astype(np.float32)))
        width = len(bias)
    if not layers:
        raise InputError(f"{path}: expected layers decoder.0.weight and so on, as LangSplat's autoencoder has them")
    return tuple(layers)
