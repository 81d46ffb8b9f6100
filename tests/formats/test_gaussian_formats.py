"""Scene files: every format against writers of other hands, conventions pinned by geometry."""

import gzip
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

import scene_files
from drsplat.errors import DrSplatWarning
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.known import parse_gaussians
from drsplat.formats.scenes import read_gaussians
from drsplat.scene.gaussians import Gaussians
from refusing import malformed, refused
from scene_files import random_gaussians, sog_files, turned, zip_bytes

SPLATS = Path(__file__).resolve().parents[3] / "shared" / "data" / "splats"
no_splats = pytest.mark.skipif(not SPLATS.is_dir(), reason=f"no real captures at {SPLATS}")
seeds = st.integers(0, 2**32 - 1)
degrees = st.integers(0, 3)
quick = settings(derandomize=True, max_examples=25)


def parsed(data: bytes, suffix: str = "") -> Gaussians:
    return parse_gaussians(memoryview(data), suffix)


def assert_close(a: Gaussians, b: Gaussians, **tolerances: float) -> None:
    """tolerances: absolute; of scales that of their logarithm, of quats in radians."""
    assert a.sh.shape == b.sh.shape
    assert np.abs(a.means - b.means).max(initial=0) <= tolerances["means"]
    assert np.abs(np.log(a.scales / b.scales)).max(initial=0) <= tolerances["scales"]
    assert np.abs(a.opacities - b.opacities).max(initial=0) <= tolerances["opacities"]
    assert np.abs(a.sh - b.sh).max(initial=0) <= tolerances["sh"]
    assert angles(a, b).max(initial=0) <= tolerances["quats"]


def angles(a: Gaussians, b: Gaussians) -> np.ndarray:
    """Angle in radians between the rotations of each row; q and -q are the same."""
    qa, qb = a.quats.astype(np.float64), b.quats.astype(np.float64)
    qb = qb * np.sign(np.einsum("ni,ni->n", qa, qb))[:, None]
    return 4 * np.arcsin(np.clip(np.linalg.norm(qa - qb, axis=1) / 2, 0, 1))


def same(a: Gaussians, b: Gaussians) -> None:
    assert_close(a, b, means=0, scales=2e-6, opacities=2e-7, sh=0, quats=2e-6)


# 3DGS PLY


@quick
@given(seeds, degrees, st.sampled_from("<>a"), st.booleans())
def test_ply_of_any_order_type_and_encoding(seed, degree, order, doubles):
    rng = default_rng(seed)
    g = random_gaussians(rng, int(rng.integers(0, 40)), degree)
    columns = scene_files.ply_columns(g)
    columns |= {name: np.zeros(len(g), np.float32) for name in ("nx", "ny", "nz")}
    columns |= {"relevancy": rng.random(len(g)).astype(np.float32)}
    columns |= {"object_id": rng.integers(-9, 9, len(g)).astype(np.int32)}
    shuffled = {name: columns[name] for name in rng.permutation(list(columns))}
    if doubles:
        shuffled["x"] = shuffled["x"].astype(np.float64)
        shuffled["rot_2"] = shuffled["rot_2"].astype(np.float64)
    back = parsed(scene_files.ply_bytes(shuffled, order))
    same(back, g)
    assert set(back.extra) == {"relevancy", "object_id"}
    assert back.extra["object_id"].dtype == np.int32
    for name, column in back.extra.items():
        assert_array_equal(column, columns[name])


@quick
@given(seeds, degrees)
def test_written_scene_reads_back(tmp_path_factory, seed, degree):
    rng = default_rng(seed)
    g = random_gaussians(rng, int(rng.integers(0, 5000)), degree)
    g.opacities[: len(g) // 3] = rng.choice(np.float32([0, 1, 1e-30, 1 - 2**-24]), len(g) // 3)
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    ids = np.arange(len(g), dtype=np.int32)
    write_gaussians(path, Gaussians(g.means, g.quats, g.scales, g.opacities, g.sh, {"a": ids}), {"b": -ids})
    back = read_gaussians(path)
    same(back, g)
    assert back.fingerprint == g.fingerprint
    assert_array_equal(back.opacities == 1, g.opacities == 1)
    assert_array_equal(back.opacities == 0, g.opacities == 0)
    assert_array_equal(back.extra["a"], ids)
    assert_array_equal(back.extra["b"], -ids)


def test_infinite_logits_of_supersplat_are_opacity_one_and_zero():
    columns = scene_files.ply_columns(random_gaussians(default_rng(0), 3))
    columns["opacity"] = np.float32([np.inf, -np.inf, 0])
    assert parsed(scene_files.ply_bytes(columns)).opacities.tolist() == [1, 0, 0.5]


def test_normals_are_kept_unless_all_zero():
    columns = scene_files.ply_columns(random_gaussians(default_rng(0), 3))
    columns |= {name: np.zeros(3, np.float32) for name in ("nx", "ny", "nz")}
    assert not parsed(scene_files.ply_bytes(columns)).extra
    columns["nz"] = np.float32([0, 0, 1])
    assert set(parsed(scene_files.ply_bytes(columns)).extra) == {"nx", "ny", "nz"}


@pytest.mark.parametrize("order", ["<", ">", "a"])
def test_elements_in_front_are_stepped_over(order):
    g = random_gaussians(default_rng(1), 5)
    header = "element face 2\nproperty uchar tag\nproperty list uchar int vertex_indices\n"
    header += "element camera 2\nproperty double f"
    lists = {"a": b"7 3 0 1 2\n7 4 0 1 2 3\n1.5\n2.5\n"}
    for code in "<>":
        lists[code] = struct.pack(f"{code}BB3iBB4idd", 7, 3, 0, 1, 2, 7, 4, 0, 1, 2, 3, 1.5, 2.5)
    data = scene_files.ply_bytes(scene_files.ply_columns(g), order, lists[order], header)
    same(parsed(data), g)


def test_bytes_after_the_last_row_are_reported():
    data = scene_files.ply_bytes(scene_files.ply_columns(random_gaussians(default_rng(2))))
    with pytest.warns(DrSplatWarning, match="3 bytes after"):
        parsed(data + b"abc")


def test_crlf_header():
    g = random_gaussians(default_rng(3), 4)
    head, body = scene_files.ply_bytes(scene_files.ply_columns(g)).split(b"end_header\n")
    same(parsed((head + b"end_header\n").replace(b"\n", b"\r\n") + body), g)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("y", "rot_1", "scale_2", "f_rest_7", "f_dc_0") for value in (np.nan, np.inf)),
        ("x", -np.inf),
        *(("scale_0", value) for value in (-np.inf, 89, -120)),
        ("opacity", np.nan),
    ],
)
def test_rows_that_are_no_gaussians_are_counted_and_named(name, value):
    columns = scene_files.ply_columns(random_gaussians(default_rng(4), 30))
    columns[name] = columns[name].copy()
    columns[name][[17, 21, 29]] = value
    with malformed(r"3 of 30 rows .* first is row 17.*--filter-nan"):
        parsed(scene_files.ply_bytes(columns))


def test_quaternions_of_any_length_but_zero():
    g = random_gaussians(default_rng(6), 3)
    columns = scene_files.ply_columns(g)
    for i in range(4):
        columns[f"rot_{i}"] = g.quats[:, i] * np.float32([1e-30, 1e37, 0])
    with malformed(r"1 of 3 rows have rotations.* row 2"):
        parsed(scene_files.ply_bytes(columns))
    columns["rot_0"][2] = 1
    assert angles(parsed(scene_files.ply_bytes(columns)), g)[:2].max() < 1e-6


def test_ply_that_is_no_scene():
    points = {name: np.zeros(3, np.float32) for name in "xyz"}
    with malformed(r"vertex has x, y, z, and no f_dc_0.*no 3DGS PLY"):
        parsed(scene_files.ply_bytes(points))
    columns = scene_files.ply_columns(random_gaussians(default_rng(7), 3))
    del columns["f_rest_44"]
    with malformed("44 f_rest"):
        parsed(scene_files.ply_bytes(columns))


# write_gaussians and read_gaussians as functions of paths


def test_writing_refuses_what_it_must(tmp_path):
    g = random_gaussians(default_rng(8), 3)
    path = tmp_path / "scene.ply"
    write_gaussians(path, g)
    before = path.read_bytes()
    refusals = [
        (path, {}, "overwrite=True"),
        (tmp_path / "scene.spz", {}, "suffix .ply"),
        (tmp_path / "no" / "scene.ply", {}, "no folder"),
        (tmp_path / "a.ply", {"x": np.zeros(3, np.float32)}, "column 'x'"),
        (tmp_path / "a.ply", {"f_rest_45": np.zeros(3, np.float32)}, "f_rest_45"),
        (tmp_path / "a.ply", {"relevancy": np.zeros(4, np.float32)}, "expected shape"),
        (tmp_path / "a.ply", {"object_id": np.zeros(3, np.int64)}, "int64"),
        (tmp_path / "a.ply", {"two words": np.zeros(3, np.int32)}, "cannot name"),
    ]
    for target, columns, message in refusals:
        with refused(message):
            write_gaussians(target, g, columns)
    broken = Gaussians(g.means, g.quats, -g.scales, g.opacities, g.sh)
    with refused("3 of 3 rows have scales"):
        write_gaussians(tmp_path / "a.ply", broken)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["scene.ply"]
    write_gaussians(path, g.subset(np.array([0])), overwrite=True)
    assert len(read_gaussians(path)) == 1


def test_model_folder_gives_its_highest_iteration(tmp_path):
    for iteration, n in ((7000, 2), (30000, 3), (9999, 4)):
        folder = tmp_path / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        write_gaussians(folder / "point_cloud.ply", random_gaussians(default_rng(9), n))
    assert len(read_gaussians(tmp_path)) == 3
    with refused("expected a scene"):
        read_gaussians(tmp_path / "point_cloud")
    with refused("no such file"):
        read_gaussians(tmp_path / "missing.ply")


def test_format_is_told_by_content_not_by_name(tmp_path):
    g = random_gaussians(default_rng(10), 5, 0)
    for name, data in {
        "a.splat": scene_files.ply_bytes(scene_files.ply_columns(g)),
        "b.ply": scene_files.spz_bytes(turned(g), 3),
        "c.zip": scene_files.spz_bytes(turned(g), 4),
        "d": scene_files.compressed_ply_bytes(g),
        "e.SPLAT": scene_files.splat_bytes(g),
        "k.ply": scene_files.ksplat_bytes([g], 1),
    }.items():
        (tmp_path / name).write_bytes(data)
        assert np.abs(read_gaussians(tmp_path / name).means - g.means).max() < 4e-3
    (tmp_path / "f.ply").write_bytes(b"KS\3\4 and so on")
    with malformed(r"f\.ply: no scene format .*splat-transform"):
        read_gaussians(tmp_path / "f.ply")
    (tmp_path / "g.ply").write_bytes(b"")
    with malformed("empty"):
        read_gaussians(tmp_path / "g.ply")


# compressed PLY, .splat and SPZ against writers that work row by row


@quick
@given(seeds, degrees, st.integers(1, 600))
def test_compressed_ply(seed, degree, n):
    g = random_gaussians(default_rng(seed), n, degree)
    back = parsed(scene_files.compressed_ply_bytes(g))
    dc_step = np.ptp(g.sh[:, 0]) / 255 * 0.51
    assert_close(back, g, means=0.51 * 6 / 1023, scales=0.51 * 5 / 1023, opacities=0.0021,
                 sh=max(dc_step, 8 / 256 * 0.51), quats=6e-3)  # fmt: skip


def test_compressed_ply_of_the_first_kind_has_no_colour_bounds():
    g = random_gaussians(default_rng(11), 10, 0)
    g.sh[:] = np.clip(g.sh, -1, 1)
    data = scene_files.compressed_ply_bytes(g)
    low, high = ((g.sh[:, 0] * scene_files.C0 + 0.5).min(0), (g.sh[:, 0] * scene_files.C0 + 0.5).max(0))
    head, body = data.split(b"end_header\n")
    lines = [line for line in head.split(b"\n") if line[-2:] not in (b"_r", b"_g", b"_b")]
    old = b"\n".join([*lines[:-1], b"end_header\n"]) + body[:48] + body[72:]
    fraction = ((g.sh[:, 0] * scene_files.C0 + 0.5) - low) / (high - low)
    assert_allclose(parsed(old).sh[:, 0] * scene_files.C0 + 0.5, fraction, atol=0.003)


@quick
@given(seeds)
def test_splat(seed):
    g = random_gaussians(default_rng(seed), 30, 0)
    back = parsed(scene_files.splat_bytes(g), ".splat")
    assert_close(back, g, means=0, scales=0, opacities=0.0021, sh=0.0021 / scene_files.C0, quats=0.025)


@quick
@given(seeds, degrees, st.sampled_from([2, 3, 4]))
def test_spz_comes_back_in_the_axes_of_a_ply(seed, degree, version):
    g = random_gaussians(default_rng(seed), 30, degree)
    if version == 2:  # w is recovered from the rest, so coarsely where it is small
        g.quats[:, 0] = np.sign(g.quats[:, 0]) + g.quats[:, 0]
        g.quats[:] /= np.linalg.norm(g.quats, axis=1, keepdims=True)
    back = parsed(scene_files.spz_bytes(turned(g), version))
    assert_close(back, g, means=1.3e-4, scales=0.032, opacities=0.0021, sh=0.0135,
                 quats=0.04 if version == 2 else 6e-3)  # fmt: skip


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(
    ("system", "signs"), [(6, (1, 1, 1)), (4, (1, -1, -1)), (7, (-1, -1, 1)), (1, (-1, 1, -1)), (8, (1, -1, 1))]
)
def test_spz_that_names_its_axes_is_believed(version, system, signs):
    g = random_gaussians(default_rng(12), 8)
    unknown = struct.pack("<II3s", 0x12340001, 3, b"abc")
    axes = unknown + struct.pack("<III", 0xADBE0003, 4, system)
    back = parsed(scene_files.spz_bytes(turned(g, signs), version, 2, axes))
    assert_close(back, g, means=1.3e-4, scales=0.032, opacities=0.0021, sh=0.0135, quats=6e-3)


def test_turning_the_axes_leaves_a_scene_looking_the_same():
    """The flip of SPZ's axes, checked on covariances and on colours seen along turned rays."""
    g = random_gaussians(default_rng(13), 12)
    signs = np.array([1, -1, -1])
    stored = parsed(scene_files.spz_bytes(g, 4))  # g's numbers read as RUB
    flipped = g.covariances() * (signs[:, None] * signs)[np.triu_indices(3)]
    size = flipped[:, [0, 3, 5]].sum(1, keepdims=True)
    assert (np.abs(stored.covariances() - flipped) / size).max() < 0.07  # scales in steps of 1/16
    rays = default_rng(14).normal(size=(20, 3))
    basis = scene_files.sh_basis(rays)
    seen = np.einsum("rk,nkc->nrc", scene_files.sh_basis(rays * signs), stored.sh)
    error = np.abs(seen - np.einsum("rk,nkc->nrc", basis, g.sh)).max(axis=(0, 2))
    assert (error < np.abs(basis).sum(1) * 0.0135).all()


def test_spz_of_degree_four_says_what_it_leaves_out():
    g = random_gaussians(default_rng(15), 5)
    planes = scene_files.spz_planes(g, 4)
    rest = np.frombuffer(planes[5], np.uint8).reshape(5, 45)
    planes[5] = np.concatenate([rest, np.zeros((5, 27), np.uint8)], 1).tobytes()
    data = struct.pack("<4sIIBBB", b"NGSP", 4, 5, 4, 12, 0) + scene_files.v4_body(planes)
    with pytest.warns(DrSplatWarning, match="degree 4"):
        back = parsed(data)
    assert_close(turned(back), g, means=1.3e-4, scales=0.032, opacities=0.0021, sh=0.0135, quats=6e-3)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        ({"version": 1}, "version 1"),
        ({"version": 5}, "version 5"),
        ({"flags": 0x80}, "level-of-detail"),
        ({"count": 7}, "more than 7 Gaussians"),
        ({"count": 9}, "truncated"),
        ({"count": 2**31}, "plausible"),
        ({"degree": 5}, "SH degree 5"),
        ({"fraction": 30}, "30 fractional bits"),
        ({"tail": b"more"}, "4 bytes more"),
    ],
)
def test_spz_headers_that_do_not_fit(edit, message):
    fields = {"version": 3, "count": 8, "degree": 3, "fraction": 12, "flags": 0, "tail": b""} | edit
    tail = fields.pop("tail")
    planes = b"".join(scene_files.spz_planes(random_gaussians(default_rng(16), 8), 3))
    data = struct.pack("<4sIIBBBx", b"NGSP", *fields.values()) + planes + tail
    with malformed(message):
        parsed(gzip.compress(data))


# Real files and another implementation


@pytest.fixture(scope="module")
def biker() -> tuple[Gaussians, Gaussians]:
    """The same scene as compressed PLY and as SPZ, the second's rows matched to the first's."""
    packed, spz = (read_gaussians(SPLATS / "biker.compressed.ply"), read_gaussians(SPLATS / "biker.spz"))
    assert len(packed) == len(spz) == 152_746
    _, nearest = cKDTree(spz.means).query(packed.means)
    return packed, spz.subset(nearest)


@pytest.mark.data
@no_splats
@pytest.mark.parametrize("version", [1, 2])
def test_a_sog_of_a_real_capture_is_that_of_its_compressed_ply(biker, version):
    """As coarse as its 256 steps: the bulk of a real capture, colours included."""
    packed = biker[0].subset(np.arange(0, len(biker[0]), 7))
    solid = packed.subset((packed.opacities > 0.02) & (packed.opacities < 0.98))
    sog = parse_gaussians(memoryview(zip_bytes(sog_files(solid, version))))
    assert len(sog) > 1000
    extent = 2 * np.log1p(np.abs(solid.means)).max()
    assert_allclose(sog.means, solid.means, atol=extent / 65535 * (1 + np.abs(solid.means).max()))
    assert_allclose(np.abs(np.einsum("ni,ni->n", sog.quats, solid.quats)), 1, atol=1e-4)
    for values, truth in ((np.log(sog.scales), np.log(solid.scales)), (sog.sh[:, 0], solid.sh[:, 0])):
        assert_allclose(values, truth, atol=0.51 * np.ptp(truth) / 255)
    assert_allclose(sog.opacities, solid.opacities, atol=0.02 if version == 1 else 0.003)


@pytest.mark.data
@no_splats
def test_biker_is_the_same_as_compressed_ply_and_as_spz(biker):
    a, b = biker
    assert np.abs(a.means - b.means).max() < 2**-12
    matched = np.abs(a.opacities - b.opacities) < 1e-6  # nearest is another row for coincident points
    assert matched.mean() > 0.997
    assert np.percentile(np.abs(np.log(a.scales / b.scales))[matched], 99.9) < 1 / 32 + 1e-3
    assert np.percentile(np.abs(a.sh - b.sh)[matched], 99.9) < 0.5 / 255 / 0.15 + 1e-3
    assert np.percentile(angles(a, b)[matched], 99.9) < 5e-3


@pytest.mark.oracle
def test_gsply_reads_what_we_write(tmp_path):
    gsply = pytest.importorskip("gsply", reason="gsply is not installed (dev extra)")
    for degree in range(4):
        g = random_gaussians(default_rng(degree), 50, degree)
        write_gaussians(tmp_path / f"{degree}.ply", g)
        theirs = gsply.plyread(str(tmp_path / f"{degree}.ply"))
        assert_array_equal(theirs.means, g.means)
        assert_allclose(theirs.scales, np.log(g.scales), atol=1e-6)
        assert_allclose(1 / (1 + np.exp(-theirs.opacities.ravel())), g.opacities, atol=1e-6)
        assert_allclose(theirs.quats, g.quats, atol=1e-6)
        assert_array_equal(theirs.sh0.reshape(-1, 3), g.sh[:, 0])
        if degree:
            assert_array_equal(np.asarray(theirs.shN).reshape(50, -1, 3), g.sh[:, 1:])


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["biker.spz", "biker.compressed.ply", "guitar.compressed.ply"])
@pytest.mark.data
@no_splats
def test_gsply_agrees_on_real_files(name):
    gsply = pytest.importorskip("gsply", reason="gsply is not installed (dev extra)")
    ours = read_gaussians(SPLATS / name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = (gsply.read_spz if name.endswith("spz") else gsply.plyread)(str(SPLATS / name))
    signs = (1, -1, -1) if name.endswith("spz") else (1, 1, 1)  # gsply leaves the axes of SPZ as stored
    g = turned(
        Gaussians(
            np.asarray(theirs.means, np.float32),
            np.asarray(theirs.quats / np.linalg.norm(theirs.quats, axis=1, keepdims=True), np.float32),
            np.exp(np.asarray(theirs.scales, np.float32)),
            (1 / (1 + np.exp(-np.asarray(theirs.opacities, np.float32).ravel()))),
            np.asarray(theirs.sh0, np.float32).reshape(-1, 1, 3),
        ),
        signs,
    )
    assert_close(ours, g, means=1e-5, scales=1e-4, opacities=1e-4, sh=1e-4, quats=2e-3)


@pytest.mark.oracle
def test_spz_written_by_gsply(tmp_path):
    gsply = pytest.importorskip("gsply", reason="gsply is not installed (dev extra)")
    g = random_gaussians(default_rng(20), 60, 2)
    write_gaussians(tmp_path / "g.ply", turned(g))  # gsply stores the numbers it is given as if RUB
    for version in (3, 4):
        gsply.write_spz(str(tmp_path / f"{version}.spz"), gsply.plyread(str(tmp_path / "g.ply")), version=version)
        back = read_gaussians(tmp_path / f"{version}.spz")
        assert_close(back, g, means=2.6e-4, scales=0.064, opacities=0.0042, sh=0.07, quats=6e-3)


# What the viewer of 3DGS reads


def read_as_sibr(data: bytes) -> tuple[int, np.ndarray]:
    """Line 1 and 2 are not looked at, line 3 is the count, then anything up to end_header, then rows of 62 floats:
    position, normal, 3 + 45 harmonics, opacity, 3 scales, 4 of a rotation."""
    head, rows = data.split(b"end_header\n", 1)
    lines = head.split(b"\n")
    assert lines[:2] == [b"ply", b"format binary_little_endian 1.0"]
    _, _, count = lines[2].split()
    wanted = int(count) * 62 * 4
    assert len(rows) >= wanted
    return int(count), np.frombuffer(rows[:wanted], "<f4").reshape(-1, 62)


@pytest.mark.parametrize(("degree", "filled"), [(3, None), (1, 3), (0, 3)])
def test_what_is_written_is_what_the_viewer_of_3dgs_reads(tmp_path, degree, filled):
    g = random_gaussians(default_rng(0), 50, degree)
    write_gaussians(tmp_path / "scene.ply", g, sh_degree=filled)
    count, rows = read_as_sibr((tmp_path / "scene.ply").read_bytes())
    assert count == 50
    assert_array_equal(rows[:, :3], g.means)
    assert not rows[:, 3:6].any()
    assert_array_equal(rows[:, 6:9], g.sh[:, 0])
    rest = rows[:, 9:54].reshape(50, 3, 15).transpose(0, 2, 1)
    assert_array_equal(rest[:, : g.sh.shape[1] - 1], g.sh[:, 1:])
    assert not rest[:, g.sh.shape[1] - 1 :].any()
    assert_allclose(1 / (1 + np.exp(-rows[:, 54])), g.opacities, atol=1e-6)
    assert_allclose(np.exp(rows[:, 55:58]), g.scales, rtol=1e-5)
    assert_array_equal(rows[:, 58:], g.quats)
    assert read_gaussians(tmp_path / "scene.ply").extra == {}


def test_harmonics_are_not_cut(tmp_path):
    g = random_gaussians(default_rng(0), 5, 2)
    for degree in (1, 4):
        with refused("sh_degree: expected 2"):
            write_gaussians(tmp_path / "scene.ply", g, sh_degree=degree)
