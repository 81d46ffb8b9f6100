"""The extension itself: whatever it is given, it answers or refuses; it never hangs and never leaves its arrays.

Run under the sanitizers by scripts/sanitize. Calls that once did not come back are made in a process of their own.
"""

import json
import os
import subprocess
import sys
import weakref

import numpy as np
import pytest
from numpy.random import default_rng

from drsplat import _native
from drsplat.kernels.mixture import Candidates, Dictionary, mixture_encode
from mutations import quota
from native_calls import refused_or_answered

CALLS = quota(600)


def in_own_process(code: str, seconds: float = 60) -> str:
    """What it prints; fails if it does not end by itself."""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=seconds, check=False)
    assert ended.returncode == 0, ended.stderr[-2000:]
    return ended.stdout


def test_rogue_calls_are_answered_or_refused():
    refused = {}
    for family, was_refused in map(refused_or_answered, range(CALLS)):
        refused.setdefault(family, []).append(was_refused)
    rates = {family: np.mean(ends) for family, ends in refused.items()}
    assert max(rates.values()) < 0.95, rates  # of a family that is always refused, little is tried
    assert np.mean(list(rates.values())) > 0.1


# Rounded to float32, every weight falls below zero when the last atom joins: found among random unit vectors.
ATOMS = [
    [10, -27, -21, -127], [127, 81, -23, 55], [37, -72, 127, -40], [-53, -127, 73, -16],
    [78, -86, 18, -127], [127, 28, 50, 62], [-62, 48, 127, -101], [-127, -111, 62, 9],
]  # fmt: skip
FEATURE = [0.5470661520957947, -0.2868238687515259, 0.14010317623615265, 0.7738357782363892]
ENCODE = f"""
import numpy as np
from drsplat.kernels.mixture import Candidates, Dictionary, mixture_encode
atoms = np.array({ATOMS}, np.int8)
scales = (1 / np.linalg.norm(atoms.astype(float), axis=1)).astype("f")
given = Candidates(np.array([0, 8]), np.arange(8, dtype=np.int32), np.empty((1, 0), np.int32))
found = mixture_encode(np.array([{FEATURE}], "f"), Dictionary(atoms, scales), given, 4, threads=1)
for part in found:
    print(part.tolist())
"""


def test_encoding_ends_where_every_atom_is_dropped():
    """One atom stays, as if it had been the only candidate.

    Which one is not compared with the twin: in a space of four dimensions every fourth atom explains all that is left,
    so that the last bit of the twin's BLAS chooses among them.
    """
    ids, weights, scales = (json.loads(line) for line in in_own_process(ENCODE).splitlines())
    assert (ids, weights) == ([ids[0][:1] * 4], [[255, 0, 0, 0]])
    assert np.dot(ATOMS[ids[0][0]], FEATURE) > 0
    assert scales[0] == pytest.approx(1 / 255, rel=1e-3)


def test_features_of_any_length_are_encoded():
    """Squares of these leave float32; nothing is promised but an end."""
    rng = default_rng(0)
    atoms = rng.integers(-127, 128, (8, 4)).astype(np.int8)
    given = Candidates(np.array([0, 8]), np.arange(8, dtype=np.int32), np.empty((1, 0), np.int32))
    for length in (1e-45, 1e-20, 1e20, 3e38):
        feature = np.full((1, 4), length, np.float32)
        found = mixture_encode(feature, Dictionary(atoms, np.full(8, 0.005, "f")), given, 4)
        assert np.isfinite(found.scales).all()


def training_pass(count: int) -> _native.TrainingPass:
    rng = default_rng(0)
    camera = np.zeros(17, np.float32)
    camera[[0, 4, 8]], camera[12:14], camera[14:] = 1, 60, (40, 30, 0.2)
    shapes = (count, 3), (count, 3), (count, 4), (count,), (count, 4, 3)
    arrays = [rng.uniform(-4, -1, shape).astype(np.float32) for shape in shapes]
    arrays[0][:, 2] += 8
    return _native.training_pass(*arrays, True, camera, 80, 60, 4, np.zeros(3, "f"), 1, "")


def test_no_backward_pass_before_a_forward_pass():
    """Its memory would be that of another pass, which was larger or smaller."""
    image = np.ones((60, 80, 3), np.float32)
    training_pass(700).forward()
    small = training_pass(2)
    with pytest.raises(ValueError, match="forward pass before"):
        small.backward(image, image)
    small.forward()
    with pytest.raises(ValueError, match=r"\(H, W, 3\)"):
        small.backward(image[:30], image[:30])
    assert small.backward(image, image)[0].shape == (2, 3)
    with pytest.raises(ValueError, match="one backward pass"):
        small.backward(image, image)


def test_rows_of_no_numbers_are_refused_however_many():
    """2^60 rows take no memory; their codes would, and their number leaves 64 bits."""
    features, centroids = np.empty((2**60, 0), np.float32), np.empty((16, 256, 0), np.float32)
    with pytest.raises(ValueError, match="above 0"):
        _native.pq_encode(features, centroids, 1, "")


FEW_THREADS = """
import resource, sys
import numpy as np
from drsplat import _native
rng = np.random.default_rng(0)
arrays = rng.standard_normal((4000, 64)).astype("f"), rng.standard_normal((300, 64)).astype("f")
expected = _native.nearest_centres(*arrays, 1, "")
kilobytes = next(int(line.split()[1]) for line in open("/proc/self/status") if "VmSize" in line)
room = (kilobytes << 10) + (40 << 20)  # for a stack or two
resource.setrlimit(resource.RLIMIT_AS, (room, room))
assert (_native.nearest_centres(*arrays, 200, "") == expected).all()
"""


@pytest.mark.skipif("san" in os.environ.get("LD_PRELOAD", ""), reason="sanitizers need the room")
def test_a_system_without_more_threads_takes_longer():
    """The process was ended, by threads that were not joined."""
    in_own_process(FEW_THREADS)


class Lent:
    """Lends its numbers, and wipes them when they are given back."""

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers = numbers.copy()

    def __dlpack__(self, **_: object) -> object:
        view = self.numbers.view()
        weakref.finalize(view, self.numbers.fill, 0)
        return view.__dlpack__()

    def __dlpack_device__(self) -> tuple[int, int]:
        return 1, 0


def lent(parts: tuple) -> tuple:
    return tuple(Lent(part) for part in parts)


def test_what_a_scan_reads_is_held_until_its_end():
    rng = default_rng(0)
    codes, ids = rng.integers(0, 256, (2, 8, 256), np.uint8), rng.integers(0, 9, 500, np.uint16)
    rows = codes, rng.random(500, np.float32) + 1, ids
    tables = rng.random((3, 8, 256), np.float32), rng.random((3, 9), np.float32)
    how = 1e-4, 0, 1, ""
    expected = _native.scan_scores(rows, tables, how)
    assert expected.all()
    np.testing.assert_array_equal(_native.scan_scores(lent(rows), lent(tables), how), expected)


def test_what_a_mixture_scan_reads_is_held_until_its_end():
    rng = default_rng(0)
    ids, weights = (rng.integers(0, 20, (3, 4, 64), np.uint16), rng.integers(1, 256, (3, 4, 64), np.uint8))
    scales = rng.uniform(1, 2, 150).astype(np.float16).view(np.uint16)
    parts = ids, weights, scales, rng.integers(1, 100, (20, 6), np.int8), np.ones(20, np.float32)
    queries = rng.random((2, 6), np.float32)
    expected = _native.mixture_scores(parts, queries, 1, "")
    assert expected.all()
    np.testing.assert_array_equal(_native.mixture_scores(lent(parts), queries, 1, ""), expected)
