"""Damaged moving scenes: a sound one, or a precise error."""

import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drsplat.errors import DrSplatError, DrSplatWarning, FormatError
from drsplat.formats.moving_scenes import FORMAT, MOTION, SHAPES, read_moving, write_moving
from drsplat.formats.tensors import map_tensors, row_checksums, write_tensors
from moving_scenes import drifting
from mutations import bounded_allocations, quota, seeded, survivors

MUTANTS = quota(600)
ALLOWANCE = 48 << 20


def read_all(path: Path) -> None:
    """What is read is sound at every time."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        moving = read_moving(path)
        for time in (*moving.times[[0, -1]].tolist(), float(moving.times.mean())):
            at = moving.at(time)
            assert len(at) == len(moving)
            assert np.isfinite(at.means).all()
            assert np.isfinite(at.quats).all()
            assert ((at.opacities >= 0) & (at.opacities <= 1)).all()


def judged(folder: Path, file: Path) -> None:
    survived = survivors(file, lambda _: read_all(folder), seeded(*file.name.encode()), MUTANTS)
    assert survived < MUTANTS * 3 / 4


@pytest.mark.slow
def test_damaged_motion(tmp_path, bounded_memory):
    write_moving(tmp_path / "a.motion", drifting(12))
    judged(tmp_path / "a.motion", tmp_path / "a.motion" / MOTION)


@pytest.mark.slow
def test_damaged_frames(tmp_path, bounded_memory):
    write_moving(tmp_path / "frames", drifting(12))
    judged(tmp_path / "frames", tmp_path / "frames" / "frame0002.ply")


Change = Callable[[dict[str, np.ndarray], dict[str, str]], None]


def _set(name: str, value: np.ndarray) -> Change:
    return lambda tensors, _: tensors.__setitem__(name, value)


def _drop(name: str) -> Change:
    return lambda tensors, _: tensors.__delitem__(name)


def _nan(tensors: dict[str, np.ndarray], _: dict[str, str]) -> None:
    tensors["means"] = tensors["means"].copy()
    tensors["means"][:, 3] = np.nan


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("times", np.array([0.0, 1, 1, 2, 3])), "increase; number 2 is 1"),
        (_set("times", np.array([0.0, 1, np.nan, 2, 3])), "increase; number 2 is nan"),
        (_set("times", np.array([0.0, 1.0])), "expected t = 2, got 5"),
        (_set("means", np.zeros((5, 13, 3), np.float32)), "expected n = 13, got 12"),
        (_set("quats", np.zeros((5, 12, 4), np.float32)), "rotations .* zero"),
        (_set("opacities", np.full((5, 12), 2, np.float32)), r"opacities that are not a number in \[0, 1\]"),
        (_set("scales", np.zeros((5, 12, 3), np.float32)), "scales"),
        (_set("origin", np.full(3, np.nan)), "origin: expected three finite"),
        (_drop("means"), "means: expected float32"),
        (_nan, "frame 0: 1 of 12 rows have positions"),
        (lambda _, metadata: metadata.update(version="2"), "version '2'"),
        (lambda _, metadata: metadata.update(scene="12-0"), "moves the Gaussians '12-0'"),
        (lambda _, metadata: metadata.pop("format"), f"expected '{FORMAT}'"),
    ],
)
def test_what_does_not_fit_is_said(tmp_path, change, message):
    write_moving(tmp_path / "a.motion", drifting(12))
    file = tmp_path / "a.motion" / MOTION
    tensors, metadata = map_tensors(file)
    tensors, metadata = dict(tensors), dict(metadata)
    change(tensors, metadata)
    sums = row_checksums({name: tensors[name] for name in SHAPES if name in tensors})  # the right ones
    write_tensors(file, tensors, metadata | sums, overwrite=True)
    with pytest.raises(DrSplatError, match=message):
        read_all(tmp_path / "a.motion")


def test_a_count_in_the_header_allocates_nothing(tmp_path):
    write_moving(tmp_path / "a.motion", drifting(12))
    file = tmp_path / "a.motion" / MOTION
    raw = file.read_bytes()
    length = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + length])
    header["means"]["shape"] = [1 << 40, 1 << 6, 3]
    header.pop("__metadata__")
    text = json.dumps(header).encode()
    file.write_bytes(len(text).to_bytes(8, "little") + text + raw[8 + length :])
    with bounded_allocations(ALLOWANCE), pytest.raises(FormatError):
        read_all(tmp_path / "a.motion")


def test_a_frame_that_vanishes_is_said(tmp_path):
    write_moving(tmp_path / "frames", drifting(12))
    moving = read_moving(tmp_path / "frames")
    shutil.rmtree(tmp_path / "frames")
    with pytest.raises(DrSplatError, match=r"frame0004\.ply"):
        moving.at(4)
