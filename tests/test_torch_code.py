"""Codes on torch's devices: the answers are those of the native scan."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("torch")

from drsplat.adapters import torch_code
from drsplat.adapters.torch_code import TorchCode
from drsplat.codes import Code, Codebook, Codes, PQCode, pq_code
from drsplat.encoders import EncoderIdentity
from drsplat.errors import InputError
from drsplat.kernels import reference_scan
from fields import unit_rows


def some_code(residual: bool, count: int = 700) -> PQCode:
    rng = np.random.default_rng(0)
    centroids = rng.normal(size=(6, 256, 4)).astype(np.float32)
    centroids[:, 0] = 0
    coarse = np.vstack([np.zeros((1, 24)), unit_rows(rng, 5, 24)]).astype(np.float32)
    codes = rng.integers(0, 256, (count, 6), np.uint8)
    ids = rng.integers(0, 6, count).astype(np.uint16)
    codes[3], ids[3] = 0, 0  # without direction
    book = Codebook(centroids, coarse if residual else None, EncoderIdentity("toy", 24))
    return pq_code(book, Codes(codes, ids if residual else None))


@pytest.mark.parametrize("residual", [False, True])
def test_answers_are_those_of_the_native_scan(
    residual: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch_code, "BLOCK", 256)  # the last block is smaller
    native, queries = some_code(residual), unit_rows(np.random.default_rng(1), 5, 24)
    code = TorchCode(native, "cpu")
    assert isinstance(code, Code)
    assert (len(code), code.dim, code.nbytes) == (700, 24, native.nbytes)
    scores = code.scores(queries)
    assert_allclose(scores, native.scores(queries), rtol=0, atol=1e-4)
    assert not scores[:, 3].any()
    floor = scores[1].copy()
    for given in (None, floor):
        margin = scores[0] if given is None else scores[0] - given
        found = code.select(queries[0], 0.1, given)
        sure = np.flatnonzero(margin > 0.1 + 1e-5)
        assert set(sure) <= set(found.rows) <= set(np.flatnonzero(margin > 0.1 - 1e-5))
        assert_allclose(found.scores, scores[0, found.rows], atol=1e-6)
    top = code.top(queries[0], 300)
    assert_allclose(top.scores, scores[0, reference_scan.top(scores[0], 300)], atol=1e-6)
    assert len(code.top(queries[0], 10_000).rows) == 700
    best = code.best(queries)
    for ours, theirs in zip(best, native.best(queries), strict=True):
        assert_allclose(ours, theirs, rtol=0, atol=1e-4)
    assert (code.best(queries[:1]).runner_up == -np.inf).all()
    some = np.array([5, 699])
    assert_array_equal(code.decode(some), native.decode(some))
    assert_allclose(code.rows(some).scores(queries), scores[:, some], atol=1e-6)
    assert set(code.tensors()) == set(native.tensors())


def test_what_cannot_be_asked_is_refused() -> None:
    code = TorchCode(some_code(False), "cpu")
    with pytest.raises(InputError, match="1 row or more"):
        code.top(np.ones(24, np.float32), 0)
    with pytest.raises(InputError, match="1 to 4096 queries"):
        code.best(np.empty((0, 24), np.float32))
    with pytest.raises(InputError, match="device"):
        TorchCode(some_code(False), "toaster")
