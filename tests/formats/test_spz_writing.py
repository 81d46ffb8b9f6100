"""SPZ that we write: read back within the format's own steps, the same bytes each time, refused where it cannot be."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import read_gaussians
from drsplat.errors import DrSplatError
from drsplat.formats.known import parse_gaussians
from drsplat.formats.spz import parse_spz, read_spz_labels
from drsplat.formats.spz_writing import spz4_bytes, spz_bytes
from drsplat.scene.gaussians import SH_COEFFICIENTS, Gaussians
from drsplat.scene.labelled import LabelledScene, Thing
from foreign_programs import needs_node, needs_packages, splat_transform
from labelled_scenes import NAMES, labelled
from mutations import mutants, quota, seeded
from refusing import refused


def scene(count: int, degree: int, seed: int, size: float = 3.0, antialiased: bool = False) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Gaussians(
        (size * rng.normal(size=(count, 3))).astype(np.float32),
        quats,
        np.exp(rng.uniform(-9, 2, (count, 3))).astype(np.float32),
        rng.uniform(0, 1, count).astype(np.float32),
        rng.uniform(-0.95, 0.95, (count, SH_COEFFICIENTS[degree], 3)).astype(np.float32),
        antialiased=antialiased,
    )


@given(st.integers(1, 40), st.integers(0, 3), st.integers(0, 999), st.sampled_from([1e-3, 1.0, 5e5]), st.booleans())
def test_what_is_written_is_read_within_the_formats_steps(count, degree, seed, size, antialiased):
    own = scene(count, degree, seed, size, antialiased)
    read = parse_spz(memoryview(spz_bytes(own)))
    assert read.antialiased == antialiased
    assert read.sh_degree == degree
    farthest = float(np.abs(own.means).max())
    assert np.abs(read.means - own.means).max() <= max(farthest * 2.0**-22, 2.0**-24)  # half a step of 23 bits
    assert np.abs(read.opacities - own.opacities).max() <= 0.5 / 255 + 1e-6
    assert np.abs(np.log(read.scales) - np.log(own.scales)).max() <= 0.5 / 16 + 1e-4
    assert np.abs(read.sh[:, 0] - own.sh[:, 0]).max() <= 0.5 / 255 / 0.15 + 1e-5
    assert np.abs(read.sh[:, 1:] - own.sh[:, 1:]).max(initial=0) <= 0.5 / 128 + 1e-5
    cosines = np.abs(np.einsum("ij,ij->i", read.quats, own.quats))
    assert cosines.min() > 1 - 3e-6  # 9 bits a component


def test_a_lower_degree_leaves_the_rest_out_and_bytes_are_the_same():
    own = scene(9, 3, 0)
    assert parse_spz(memoryview(spz_bytes(own, 1))).sh_degree == 1
    assert spz_bytes(own) == spz_bytes(own)


def test_what_spz_cannot_hold_is_refused():
    own = scene(5, 1, 0)
    with refused("degree: expected 0 to 1"):
        spz_bytes(own, 2)
    with refused("positions within 8,388,607 units"):
        spz_bytes(scene(5, 0, 0, size=1e8))
    with refused("got 0 Gaussians"):
        spz_bytes(own.subset(np.empty(0, np.int64)))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_version_4_is_version_3_with_objects(degree, tmp_path):
    own, path = labelled(50, degree), tmp_path / "s.spz"
    path.write_bytes(spz4_bytes(own))
    read, plain = read_gaussians(path), parse_spz(memoryview(spz_bytes(own.gaussians)))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert_array_equal(getattr(read, name), getattr(plain, name))
    assert_array_equal(read.extra["object_id"], own.object_numbers)
    assert_array_equal(read.extra["relevancy"], own.relevancy)
    labels = read_spz_labels(path)
    assert [thing.name for thing in labels.things] == list(NAMES)
    assert labels.query == own.query


@pytest.mark.parametrize("encode", [lambda one: spz_bytes(one.gaussians), spz4_bytes], ids=["3", "4"])
def test_columns_that_are_all_alike_are_no_bomb(encode):
    """Harmonics are zero where a scene has none, and everything may be one object: such bytes are hardly any."""
    own = scene(300_000, 3, 0)
    own.sh[:, 1:] = 0
    things = (Thing("all", 0.5, np.zeros(3), np.eye(3), np.ones(3)),)
    labelled = LabelledScene(own, things=things, object_of=np.zeros(len(own), np.int32))
    read = parse_spz(memoryview(encode(labelled)))
    assert_array_equal(read.sh[:, 1:], 0)
    assert len(read) == len(own)


def test_names_that_would_be_taken_for_a_bomb_are_refused():
    own = labelled(30, 0)
    long = [replace(thing, name=thing.name + "a" * 2_000_000) for thing in own.things]
    with refused(r"long and alike.*shorten them, or write GLB"):
        spz4_bytes(replace(own, things=tuple(long)))


def test_version_4_without_objects_has_no_extension():
    content = spz4_bytes(LabelledScene(scene(9, 1, 0)))
    assert content[:8] == b"NGSP\x04\0\0\0"
    assert parse_spz(memoryview(content)).extra == {}
    assert content == spz4_bytes(LabelledScene(scene(9, 1, 0)))


def test_damaged_objects_are_refused_or_read():
    good = spz4_bytes(labelled(30, 0))
    for damaged in mutants(good, seeded(41), quota(300)):
        with contextlib.suppress(DrSplatError):
            parse_gaussians(memoryview(damaged))


@pytest.mark.oracle
@needs_node
@needs_packages("@playcanvas/splat-transform")
def test_splat_transform_reads_version_4_and_steps_over_objects(tmp_path):
    (tmp_path / "ours.spz").write_bytes(spz4_bytes(labelled(50, 3)))
    splat_transform(tmp_path / "ours.spz", tmp_path / "theirs.ply")
    ours, theirs = read_gaussians(tmp_path / "ours.spz"), read_gaussians(tmp_path / "theirs.ply")
    for name in ("means", "opacities", "sh", "scales"):
        assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-6)
