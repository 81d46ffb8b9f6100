"""Scene files as splat-transform reads and writes them, against our readers: every attribute of every row.

Both decode the same bytes, so they may differ by roundings of float32 and by nothing else.
"""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import scene_files
from drsplat.errors import FormatError
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.scenes import read_gaussians
from drsplat.scene.gaussians import Gaussians
from foreign_programs import needs_node, needs_packages, splat_transform

pytestmark = [pytest.mark.oracle, needs_node, needs_packages("@playcanvas/splat-transform")]
ROUNDING = 1e-6


def made(degree: int, rows: int = 300) -> Gaussians:
    return scene_files.random_gaussians(np.random.default_rng(degree), rows, degree)


def assert_same(ours: Gaussians, theirs: Gaussians, quats: float = ROUNDING) -> None:
    """Compare row by row: positions, log scales, opacities, rotations up to sign, and all harmonics."""
    assert len(ours) == len(theirs)
    assert ours.sh.shape == theirs.sh.shape
    signs = np.sign((ours.quats * theirs.quats).sum(1, keepdims=True))
    assert_allclose(ours.positions, theirs.positions, rtol=0, atol=ROUNDING)
    assert_allclose(np.log(ours.scales), np.log(theirs.scales), rtol=0, atol=ROUNDING)
    assert_allclose(ours.opacities, theirs.opacities, rtol=0, atol=ROUNDING)
    assert_allclose(ours.quats * signs, theirs.quats, rtol=0, atol=quats)
    assert_allclose(ours.sh, theirs.sh, rtol=0, atol=ROUNDING)


def decoded(path: Path) -> Gaussians:
    """Return the scene as their decoder reads the file: through a PLY, which stores all numbers as they are."""
    copy = path.with_name(f"{path.name}.copy.ply")
    splat_transform(path, copy)
    return read_gaussians(copy)


@pytest.mark.parametrize("degree", [0, 3])
def test_what_we_write_is_read_to_the_bit(degree, tmp_path):
    path = tmp_path / "ours.ply"
    write_gaussians(path, made(degree))
    ours, theirs = read_gaussians(path), decoded(path)
    for name in ("means", "scales", "opacities", "sh", "quats"):
        assert_array_equal(getattr(ours, name), getattr(theirs, name))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "degree"),
    [
        ("a.compressed.ply", (), 0),
        ("a.compressed.ply", (), 3),
        ("a.spz", ("--spz-version", "3"), 3),
        ("a.spz", ("--spz-version", "4"), 3),
        ("a.sog", (), 1),
    ],
)
def test_what_they_write_is_decoded_alike(name, options, degree, tmp_path):
    source, path = tmp_path / "ours.ply", tmp_path / name
    write_gaussians(source, made(degree))
    splat_transform(*options, source, path)
    assert_same(read_gaussians(path), decoded(path))


@pytest.mark.parametrize("level", [0, 1, 2])
def test_ksplat_is_decoded_alike(level, tmp_path):
    path = tmp_path / "a.ksplat"
    path.write_bytes(scene_files.ksplat_bytes([made(2)], level))
    assert_same(read_gaussians(path), decoded(path))


def test_splat_is_decoded_alike_but_for_the_zero_of_a_rotation(tmp_path):
    """The format's first viewer writes round(128 q + 128), so that 128 is zero. Theirs takes bytes as [-1, 1]."""
    path = tmp_path / "a.splat"
    path.write_bytes(scene_files.splat_bytes(made(0)))
    ours, theirs = read_gaussians(path), decoded(path)
    assert_same(ours, theirs, quats=0.01)
    stored = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, 32)[:, 28:].astype(np.float64)
    for gaussians, quats in ((ours, stored - 128), (theirs, stored / 127.5 - 1)):
        unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
        signs = np.sign((unit * gaussians.quats).sum(1, keepdims=True))
        assert_allclose(gaussians.quats, unit * signs, rtol=0, atol=ROUNDING)


def test_positions_far_from_zero_stay_as_exact_as_they_were_written(tmp_path):
    scene, path = made(0), tmp_path / "far.ply"
    origin = np.array([500_000.0, 4_000_000.0, 100.0])
    write_gaussians(path, Gaussians(scene.means, scene.quats, scene.scales, scene.opacities, scene.sh, {}, origin))
    assert_allclose(decoded(path).positions, scene.means + origin, rtol=0, atol=1e-5)


def test_a_saved_column_selects_what_was_found(tmp_path):
    """The filter that docs/neighbours.md shows for what `drsplat select --save` wrote."""
    scene, path, cut = made(1), tmp_path / "found.ply", tmp_path / "cut.ply"
    selected = np.arange(len(scene)) % 7 == 0
    relevancy = np.linspace(0, 1, len(scene), dtype=np.float32)
    write_gaussians(path, scene, {"relevancy": relevancy, "selected": selected.astype(np.uint8)})
    splat_transform(path, "-V", "selected,eq,1", cut)
    assert_array_equal(read_gaussians(cut).means, scene.means[selected])
    splat_transform(path, "-V", "relevancy,gt,0.5", cut)
    assert_array_equal(read_gaussians(cut).means, scene.means[relevancy > 0.5])


def test_the_cure_that_a_message_names_works(tmp_path):
    scene, path, mended = made(0), tmp_path / "broken.ply", tmp_path / "mended.ply"
    columns = scene_files.ply_columns(scene)
    columns["x"] = columns["x"].copy()
    columns["x"][[3, 200]] = np.nan
    path.write_bytes(scene_files.ply_bytes(columns))
    with pytest.raises(FormatError, match=r"2 of 300 rows .*splat-transform --filter-nan"):
        read_gaussians(path)
    splat_transform(path, "--filter-nan", mended)
    assert_array_equal(read_gaussians(mended).means, np.delete(scene.means, [3, 200], axis=0))


@pytest.mark.slow
def test_what_gsply_compresses_is_decoded_as_they_do(tmp_path):
    """Its columns of integers are no floats, which gsply 0.4.6 takes all rows for: it gets a PLY without any."""
    gsply = pytest.importorskip("gsply")
    source, path = tmp_path / "ours.ply", tmp_path / "theirs.compressed.ply"
    write_gaussians(source, made(3))
    gsply.plywrite(str(path), gsply.plyread(str(source)), compressed=True)
    assert_same(read_gaussians(path), decoded(path))
