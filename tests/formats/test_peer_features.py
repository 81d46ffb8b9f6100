"""Features that other systems have on disk, as `drsplat evaluate --features` reads them."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from drsplat.errors import DrSplatError, FormatError, InputError
from drsplat.formats.peer_features import read_peer_features
from drsplat.formats.tensors import write_tensors
from mutations import bounded_allocations, mutants, quota, seeded

ROWS = np.random.default_rng(0).normal(size=(50, 16)).astype(np.float32)


def written(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    if path.suffix == ".npy":
        np.save(path, next(iter(arrays.values())))
    else:
        write_tensors(path, arrays)
    return path


@pytest.mark.parametrize(
    ("name", "arrays", "said"),
    [
        ("a.npy", {"": ROWS}, None),
        ("a.npy", {"": ROWS.astype(np.float16)}, None),
        ("a.safetensors", {"codes": ROWS}, None),
        ("a.safetensors", {"means": ROWS[:, :3], "language_features": ROWS}, None),
        ("a.safetensors", {"one": ROWS, "two": ROWS}, r"expected one array .* found one \(50, 16\), two \(50, 16\)"),
        ("a.safetensors", {"whole": ROWS.astype(np.int32)}, "expected one array .* found none"),
        ("a.npy", {"": ROWS[0]}, r"expected float16 or float32 \(N, D\)"),
        ("a.npy", {"": ROWS.astype(np.float64)}, r"expected float16 or float32 \(N, D\)"),
        ("a.npy", {"": ROWS.astype(np.int32)}, r"expected float16 or float32 \(N, D\)"),
    ],
)
def test_one_array_of_rows_is_read(name: str, arrays: dict[str, np.ndarray], said: str | None, tmp_path: Path) -> None:
    path = written(tmp_path / name, arrays)
    if said is None:
        np.testing.assert_allclose(read_peer_features(path), ROWS, rtol=1e-2, atol=1e-2)
    else:
        with pytest.raises(InputError, match=said):
            read_peer_features(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [("a.npy", "no such file"), ("a.safetensors", "no such file"), ("a.pth", "numpy.save"), ("a.npz", "numpy.save")],
)
def test_what_is_not_there_or_would_run_code_is_refused(name: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        read_peer_features(tmp_path / name)


def test_damaged_arrays(tmp_path: Path) -> None:
    good = written(tmp_path / "good.npy", {"": ROWS}).read_bytes()
    with bounded_allocations(1 << 20):
        for data in mutants(good, seeded(3), quota(150)):
            (tmp_path / "x.npy").write_bytes(data)
            with suppress(DrSplatError):
                read_peer_features(tmp_path / "x.npy")
    (tmp_path / "x.npy").write_bytes(b"nothing")
    with pytest.raises(FormatError):
        read_peer_features(tmp_path / "x.npy")
