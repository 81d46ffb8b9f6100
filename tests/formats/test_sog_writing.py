"""SOG that we write: read back within the format's steps, objects and names with it, the same bytes each time."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import read_gaussians
from drsplat.errors import DrSplatError
from drsplat.formats.known import parse_gaussians, write_scene
from drsplat.formats.labels import labels_bytes, parse_labels
from drsplat.formats.sog import parse_sog, read_sog_labels
from drsplat.formats.sog_writing import codebook, harmonics_palette, sog_bytes, sog_files
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene, Thing
from drsplat.scene.morton import morton_order
from foreign_programs import needs_node, needs_packages, splat_transform
from labelled_scenes import labelled
from mutations import mutants, quota, seeded
from refusing import malformed, refused
from scene_files import random_gaussians, zip_bytes

BOX = {"center": np.array([0.5, 1, -2]), "axes": np.eye(3), "extent": np.array([1.0, 2, 3])}


def scene(count: int = 300, degree: int = 3, antialiased: bool = False) -> Gaussians:
    return replace(random_gaussians(default_rng(degree), count, degree), antialiased=antialiased)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 5, 300])
def test_what_is_written_is_read_within_the_formats_steps(count, degree):
    own = scene(count, degree, antialiased=bool(degree % 2))
    read = parse_sog(memoryview(sog_bytes(LabelledScene(own))))
    own = own.subset(morton_order(own.means))
    assert (read.antialiased, read.sh_degree) == (own.antialiased, degree)
    logs = [np.log1p(np.abs(g.means)) for g in (read, own)]
    assert_allclose(*logs, atol=2 * np.log1p(3) / 65535)
    assert_allclose(read.opacities, own.opacities, atol=0.5 / 255 + 1e-6)
    assert_allclose(read.scales, own.scales, atol=1 / 300)  # 900 numbers up to 0.37, 256 entries: finer where larger
    assert_allclose(np.log(read.scales), np.log(own.scales), atol=1 / 12)
    assert_allclose(read.sh[:, 0], own.sh[:, 0], atol=4 / 256)
    assert_allclose(read.sh[:, 1:], own.sh[:, 1:], atol=2.5 / 256)
    assert np.abs(np.einsum("ij,ij->i", read.quats, own.quats)).min() > 1 - 5e-5  # 8 bits a component


def test_objects_names_and_relevancy_come_back(tmp_path):
    own, path = labelled(300, 1), tmp_path / "room.sog"
    write_scene(path, own)
    read, order = read_gaussians(path), morton_order(own.gaussians.means)
    assert_array_equal(read.extra["object_id"], own.object_numbers[order])
    assert_allclose(read.extra["relevancy"], own.relevancy[order], atol=1 / 65535)
    labels = read_sog_labels(path)
    assert [(one.name, one.parent) for one in labels.things] == [(one.name, one.parent) for one in own.things]
    assert (labels.query, labels.groups[0].name) == (own.query, "dishes")
    assert_allclose(labels.things[3].axes, own.things[3].axes)


@pytest.mark.slow
def test_100_000_objects_come_back():
    count = 100_000
    things = tuple(Thing(f"object {number}", 0.5, **BOX) for number in range(count))
    own = LabelledScene(scene(count, 0), things=things, object_of=np.arange(count, dtype=np.int32)[::-1].copy())
    files = sog_files(own)
    read = parse_sog(memoryview(zip_bytes(files)))
    assert_array_equal(read.extra["object_id"], own.object_of[morton_order(own.gaussians.means)])
    assert parse_labels(files["drsplat_labels.json"], "labels").things[-1].name == "object 99999"


def test_a_scene_far_from_zero_keeps_its_place(tmp_path):
    own = replace(scene(), origin=np.array([5e5, 4e6, 100.0]))
    write_scene(tmp_path / "far.sog", LabelledScene(own))
    read = read_gaussians(tmp_path / "far.sog")
    assert_allclose(read.positions, own.positions[morton_order(own.means)], atol=2e-4)


def test_the_same_bytes_and_none_of_ours_without_objects():
    own = LabelledScene(scene())
    assert sog_bytes(own) == sog_bytes(own)
    assert not [name for name in sog_files(own) if "drsplat" in name]
    assert b"drsplat" not in sog_files(own)["meta.json"].replace(b'"generator":"drsplat"', b"")


def test_a_codebook_is_k_means():
    """Two hundred distinct numbers are kept; of many, each entry is the mean of its cell and no quantile grid."""
    few = np.repeat(np.arange(200, dtype=np.float32), 3)
    assert_array_equal(np.unique(codebook(few)), np.arange(200))
    many = default_rng(0).normal(size=50_000).astype(np.float32)
    book = codebook(many)
    nearest = np.searchsorted((book[1:] + book[:-1]) / 2, many.astype(np.float64))
    error = float(((book[nearest] - many) ** 2).mean())
    even = np.quantile(many, (np.arange(256) + 0.5) / 256)
    of_quantiles = even[np.searchsorted((even[1:] + even[:-1]) / 2, many)]
    assert error < 0.5 * float(((of_quantiles - many) ** 2).mean())


def test_a_codebook_is_finer_where_errors_weigh_more():
    """Of evenly spread numbers whose errors weigh w, the best codes are as dense as the cube root of w."""
    even = np.linspace(0, 9, 90_001, dtype=np.float32)
    book = codebook(even, lambda values: np.exp(2 * values))
    dense = np.exp(2 / 3 * book[:-1]) * np.diff(book)
    assert_allclose(dense[8:-8], np.median(dense), rtol=0.1)
    halved = np.interp([0.5], np.arange(256) / 255, book)  # half of the codes are above the value where e^(2x/3) is
    assert_allclose(halved, 1.5 * np.log((1 + np.exp(6)) / 2), rtol=0.01)


@pytest.mark.slow
def test_a_palette_of_many_rows_is_near_all_of_them():
    """70,000 rows about 500 points, as far apart as 1: entries are within the rows' own spread."""
    rng = default_rng(0)
    points = rng.normal(size=(500, 9)).astype(np.float32)
    rows = points[rng.integers(0, 500, 70_000)] + rng.normal(scale=0.01, size=(70_000, 9)).astype(np.float32)
    palette, labels = harmonics_palette(rows)
    assert len(palette) <= 65_536
    assert np.sqrt(((palette[labels] - rows) ** 2).mean()) < 0.01


def test_what_sog_cannot_hold_is_refused():
    own = scene(5, 0)
    with refused(r"SOG: expected 1 to .* got 0"):
        sog_bytes(LabelledScene(own.subset(np.empty(0, np.int64))))
    broken = replace(own, means=np.where(np.arange(5)[:, None] == 3, np.nan, own.means).astype(np.float32))
    with refused(r"1 of 5 rows have positions .* the first is row 3"):
        sog_bytes(LabelledScene(broken))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (b"[]", "of version 1"),
        (b'{"format":"drsplat objects","version":1,"objects":[{"name":3}]}', "objects: 0: name: expected a text"),
        (b'{"format":"drsplat objects","version":1,"objects":{}}', "expected a list"),
        (b'{"format":"drsplat objects","version":1,"objects":[],"query":7}', "expected a text"),
        (
            b'{"format":"drsplat objects","version":1,"objects":[{"name":"a","parent":0,"score":1,"center":[0,0,0],'
            b'"extent":[1,1,1],"axes":[[1,0,0],[0,1,0],[0,0,1]]}]}',
            "parent: expected -1",
        ),
        (b"[" * 100_000, "expected JSON"),
    ],
)
def test_labels_that_are_none_are_refused(change, said):
    with malformed(said):
        parse_labels(change, "labels")


@pytest.mark.slow
def test_damaged_files_are_refused_or_read():
    rng, own = seeded(31), labelled(40)
    good, labels = sog_bytes(own), labels_bytes(own)
    for damaged in mutants(good, rng, quota(150)):
        with contextlib.suppress(DrSplatError):
            parse_gaussians(memoryview(damaged))
    for damaged in mutants(labels, rng, quota(300)):
        with contextlib.suppress(DrSplatError):
            parse_labels(damaged, "labels")
    for damaged in mutants(sog_files(own)["meta.json"], rng, quota(150)):
        with contextlib.suppress(DrSplatError):
            parse_gaussians(memoryview(zip_bytes({**sog_files(own), "meta.json": damaged})))


@pytest.mark.oracle
@needs_node
@needs_packages("@playcanvas/splat-transform")
@pytest.mark.parametrize("degree", [0, 3])
def test_splat_transform_reads_it_as_we_do(degree, tmp_path):
    own = labelled(300, degree)
    write_scene(tmp_path / "ours.sog", own)
    splat_transform(tmp_path / "ours.sog", tmp_path / "theirs.ply")
    ours, theirs = read_gaussians(tmp_path / "ours.sog"), read_gaussians(tmp_path / "theirs.ply")
    for name in ("means", "opacities", "sh", "scales"):
        assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-6)
    assert_allclose(np.abs(np.einsum("ij,ij->i", ours.quats, theirs.quats)), 1, atol=1e-6)
