"""KSPLAT: what was stored comes back, level by level; headers that do not fit the file are refused."""

import base64
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from command_line import answer_of
from drsplat.errors import FormatError
from drsplat.formats.known import parse_gaussians
from mutations import COUNTS
from refusing import malformed
from scene_files import C0, ksplat_bytes, random_gaussians

LEVELS = (0, 1, 2)
SECTION = 4096  # where the first section's header begins


def scene(degree: int = 2, n: int = 45) -> ds.Gaussians:
    return random_gaussians(np.random.default_rng(degree), n, degree)


def read(data: bytes) -> ds.Gaussians:
    return parse_gaussians(memoryview(data), ".ksplat")


def assert_close(found: ds.Gaussians, g: ds.Gaussians, level: int) -> None:
    """Half a step of 16 bits, of half floats, and of a byte; the rest to the bit."""
    k = g.sh.shape[1]
    assert_allclose(found.means, g.means, rtol=0, atol=7 / 65534 if level else 0)
    assert_allclose(found.quats, g.quats, rtol=0, atol=5e-4 if level else 2e-7)
    assert_allclose(found.scales, g.scales, rtol=2**-11 if level else 0)
    assert_allclose(found.opacities, g.opacities, rtol=0, atol=0.501 / 255)
    colour = np.clip(g.sh[:, 0] * C0 + 0.5, 0, 1)
    assert_allclose(found.sh[:, 0] * C0 + 0.5, colour, rtol=0, atol=0.501 / 255)
    step = (0, 2**-12, 0.501 * 1.8 / 255)[level]
    assert_allclose(found.sh[:, 1:k], g.sh[:, 1:], rtol=0, atol=step)
    assert not found.sh[:, k:].any()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("degree", range(3))
def test_a_scene_comes_back(level, degree):
    found = read(ksplat_bytes([scene(degree)], level))
    assert found.sh_degree == degree
    assert_close(found, scene(degree), level)


@pytest.mark.parametrize("level", LEVELS)
def test_sections_follow_each_other(level):
    """Of other sizes and degrees, one without a row and one without a full bucket."""
    parts = [scene(1, 13), scene(0, 0), scene(2, 40), scene(0, 5)]
    found = read(ksplat_bytes(parts, level))
    assert found.sh_degree == 2
    assert len(found) == 58
    starts = np.cumsum([0, *map(len, parts)])
    for start, part in zip(starts, parts, strict=False):
        rows = slice(start, start + len(part))
        piece = ds.Gaussians(
            found.means[rows], found.quats[rows], found.scales[rows], found.opacities[rows], found.sh[rows]
        )
        assert_close(piece, part, level)


def test_harmonics_are_channel_by_channel_within_a_degree():
    """The bytes of one row, counted from 0, as GaussianSplats3D 0.4.7 lays them out."""
    data = bytearray(ksplat_bytes([scene(2, 1)], 0))
    struct.pack_into("<24f", data, SECTION + 1024 + 44, *range(24))
    expected = np.array(
        [[0, 3, 6], [1, 4, 7], [2, 5, 8], [9, 14, 19], [10, 15, 20], [11, 16, 21], [12, 17, 22], [13, 18, 23]]
    )  # fmt: skip
    assert_array_equal(read(bytes(data)).sh[0, 1:], expected)


def test_numbers_that_a_header_leaves_out():
    """0 stands for 32767 steps and for harmonics from -1.5 to 1.5."""
    data = bytearray(ksplat_bytes([scene(1)], 2))
    known = read(bytes(data))
    struct.pack_into("<2f", data, 36, 0, 0)
    struct.pack_into("<I", data, SECTION + 24, 0)
    struct.pack_into("<9B", data, len(data) - 9, *[0, 255] * 4, 0)
    found = read(bytes(data))
    assert_array_equal(found.means, known.means)
    assert set(found.sh[-1, 1:].ravel().tolist()) == {-1.5, 1.5}


def test_a_scale_too_small_for_half_floats():
    """Flat Gaussians stay what they are; in float32 0 is no scale."""
    g = scene(0)
    g.scales[3, 1] = 1e-9
    assert_array_equal(read(ksplat_bytes([g], 1)).scales[3, 1], 2.0**-25)
    g.scales[3, 1] = 0
    with malformed(r"1 of 45 rows have scales .* row 3"):
        read(ksplat_bytes([g], 0))


def test_a_scene_that_the_viewer_loaded_bit_by_bit():
    """The section still has the count of the first part; what the viewer shows is all rows."""
    data = bytearray(ksplat_bytes([scene()], 0))
    struct.pack_into("<I", data, SECTION, 7)
    assert_close(read(bytes(data)), scene(), 0)


# Five Gaussians, written at levels 1 and 2 by GaussianSplats3D 0.4.7 in buckets of two, sides of 3; zlib, base 85.
OF_THE_VIEWER = {
    1: (
    "c-rmQy-wRu6bJBsK;0@aG2=)K72+cw*Ur5OQqBevvn4h%uypIvnbWCKh6;(TOFb}@h(aKC;+w_y8F+%c30&JSls9N~e)"
    "iwCuC05|@n)j|_`S-9*Ob?PJ1%^N5JCtcgb+dqA;drF?VEqiXT2IB`sk0(7r<qs9&fzf7ef4B>VJK1_%20#zNEM7coT?"
    "YDC|IOn2peH_V)b8kotjj3(RnfeHR9LWGLeYTyx7QD2`Y=lUOWWjs>TfR<i&td_ve%P2E(T<<Xa)Td=%9h6xTxk!G{9c"
    "<|4)5pvH(iC!7Dlqb2HQ;K`+#PQAKW`YR2=o}7!C-syjr{B(2I_Q(7InVG19S)(9bB0I!_G|8Om!gqQ44GiL%4y-!=c1"
    "}dV-KzIU_2Xlfvc0R7w9>SKIc3~ifwLFII=<RGJf<m-uYF#h)BC$U}#y^Ue4lUu#eq?L6H^hqWyjP`4_3GdRtarcT{(R"
    "Ic9Yy+;L&qB~1A)UjW6&ipl"
    ),
    2: (
    "c-muNWMBXyFlL2fCI)oiu^))-8Aib<7zLwX6pVsVFbYP&C>RB!U=)mkQ7|L{a-W|WEaKq610?^~GcZUnLc|%djtPu{Q7"
    "{UII$#8o2kg=Ceh59m0mcp$Wnc&mWiVmTVld&i<TnMvooiD1?Ei}yM3?sMy8PBNxn|n>6$fvB;bE1t2+RhnW?(R2&|ol"
    "CG*PrrG%?!cUNB2u(%7eb;;L)!+0*K0ZaQ=1?st9-MXQk9_R!Fkt5&XJFk{eRFtV{`V7O#*Y0H9$#`s5nMC>Dr=54>I>"
    "z+_Gxo7GA8=qb=$(Z{8-w!t5f<c$Tpv$^zbC)p#!({K$`eP4%D%*xN&E6`g?GjgB(7AZewR0~RB#l9;f!LBkk3mP@djH"
    "n_hWicMH)PIVb>uF)q7~3FK!-R*10Awp*QPU1|BC?tspM+z"
    ),
}  # fmt: skip


def five() -> ds.Gaussians:
    i = np.arange(5, dtype=np.float32)
    quats = np.stack([i + 1, 2 - i, i * 0 + 1, i - 3], 1)
    return ds.Gaussians(
        np.stack([i * i / 4, 1 - i, i % 3], 1),
        quats / np.linalg.norm(quats, axis=1, keepdims=True).astype(np.float32),
        np.stack([(i + 1) / 8, (i + 2) / 64, (5 - i) / 16], 1),
        (i + 1) / 8,
        ((np.arange(135).reshape(5, 9, 3) * 37 % 101 - 50) / 64).astype(np.float32),
    )


@pytest.mark.parametrize("level", OF_THE_VIEWER)
def test_what_the_viewer_wrote(level):
    """Its bytes and half floats are cut off, not rounded; it sorts by distance, then by bucket."""
    found = read(zlib.decompress(base64.b85decode(OF_THE_VIEWER[level])))
    g, order = five(), np.array([1, 0, 2, 3, 4])
    assert_allclose(found.means, g.means[order], rtol=0, atol=1.5 / 65534 * 1.01)
    assert_allclose(found.quats, g.quats[order], rtol=0, atol=2**-10)
    assert_allclose(found.scales, g.scales[order], rtol=2**-10)
    assert_array_equal(found.opacities, (g.opacities[order] * 255 // 1) / np.float32(255))
    lost = np.clip(g.sh[order, 0] * C0 + 0.5, 0, 1) * 255 - (found.sh[:, 0] * C0 + 0.5) * 255
    assert -0.001 < lost.min() <= lost.max() < 1.001
    assert_allclose(found.sh[:, 1:], g.sh[order, 1:], rtol=0, atol=(2**-10, 1.6 / 255)[level - 1])


NO_GAUSSIANS = [(level, 1, np.inf, "scales") for level in LEVELS]
NO_GAUSSIANS += [(level, 2, np.nan, "rotations") for level in LEVELS]


@pytest.mark.parametrize(("level", "field", "value", "said"), [(0, 0, np.nan, "positions"), *NO_GAUSSIANS])
def test_rows_that_are_no_gaussians_are_named(level, field, value, said):
    widths = (6, 6, 8, 4) if level else (12, 12, 16, 4)
    data = bytearray(ksplat_bytes([scene(0)], level))
    start = len(data) - 2 * sum(widths) + sum(widths[:field])
    struct.pack_into("<e" if level else "<f", data, start, value)
    with malformed(rf"1 of 45 rows have {said} .* row 43"):
        read(bytes(data))


def planted(level: int, at: int, code: str, *values: float) -> bytes:
    data = bytearray(ksplat_bytes([scene(), scene(1)], level))
    struct.pack_into("<" + code, data, at, *values)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "truncated: 0 bytes"),
        (b"\0\1\0\0", "truncated: 4 bytes"),
        (planted(0, 0, "B", 1), r"version 1\.1"),
        (planted(0, 1, "B", 0), r"version 0\.0"),
        (planted(1, 20, "H", 3), "level 0, 1 or 2, got 3"),
        (planted(1, 4, "I", 2**32 - 1), "headers of 4294967295 sections"),
        (planted(0, 4, "I", 1), "are 45 Gaussians .* expected 90 Gaussians"),
        (planted(1, 16, "I", 89), "89 of its 90 Gaussians had been loaded"),
        (planted(1, 12, "2I", 2**32 - 1, 2**32 - 1), "expected 4294967295 Gaussians"),
        (planted(1, SECTION + 4, "I", 2**32 - 1), "section 0 of 4294967295 Gaussians"),
        (planted(1, SECTION + 4, "I", 44), "hold 45 rows; expected 12 bytes and 44"),
        (planted(0, SECTION + 4, "I", 44), "89 Gaussians and end at byte"),
        (planted(1, SECTION + 8, "I", 2**32 - 1), "hold 21474836480 rows"),
        (planted(1, SECTION + 12, "I", 2**32 - 1), "in 4294967295 buckets"),
        (planted(1, SECTION + 12, "I", 5), "other buckets of 5"),
        (planted(1, SECTION + 20, "H", 11), "centres of 11 bytes"),
        (planted(1, SECTION + 32, "I", 4), "4 full and 2 other buckets of 7"),
        (planted(1, SECTION + 36, "I", 2**32 - 1), "truncated: section 0"),
        (planted(1, SECTION + 2048, "I", 4), "hold 46 rows"),
        (planted(0, SECTION + 40, "H", 3), "degree 0 to 2, got 3"),
        (planted(0, SECTION + 1024 + 40, "H", 0), "end at byte"),
        (planted(1, SECTION + 16, "f", np.nan), "45 of 90 rows have positions"),
        (planted(2, 36, "f", np.inf), "90 of 90 rows have colours"),
        (ksplat_bytes([scene()], 2)[:-1], "truncated: section 0"),
        (ksplat_bytes([scene()], 2) + b"\0", "end at byte"),
    ],
)
def test_what_does_not_fit_is_refused(data, said):
    tracemalloc.start()
    try:
        with malformed(said):
            read(data)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_any_number_in_any_field(level):
    """Sound Gaussians or an error, and never the room that a number asks for."""
    fields = [*range(4, 24, 4), *range(SECTION, SECTION + 44, 4)]
    values = {value % 2**32 for value in COUNTS}
    tracemalloc.start()
    try:
        for at in fields:
            for value in values:
                try:
                    found = read(planted(level, at, "I", value))
                except FormatError:
                    continue
                assert len(found) == 90
                assert np.isfinite(found.means).all()
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_a_file_is_told_by_its_beginning_and_serves_as_a_scene(tmp_path, capsys):
    for name in ("a.ksplat", "a.ply", "a.splat"):
        (tmp_path / name).write_bytes(ksplat_bytes([scene()], 1))
        assert len(ds.read_gaussians(tmp_path / name)) == 45
    assert answer_of(capsys, "inspect", tmp_path / "a.ksplat")["kind"] == "scene"
    (tmp_path / "b.ksplat").write_bytes(b"no" * 2048)
    with malformed(r"b\.ksplat: KSPLAT version 110\.111"):
        ds.read_gaussians(tmp_path / "b.ksplat")
