"""Photos on the raster of their pinhole: lens, remap, transparency, damaged files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from drsplat.formats.captures import read_views
from drsplat.scene.lens import distort_points, fold_radius2, undistort_points
from drsplat.scene.photos import load_image, photo_size, undistort_ids
from drsplat.scene.views import View
from refusing import malformed, refused

PLUSH = Path(__file__).resolve().parents[3] / "shared" / "data" / "plush"
needs_plush = pytest.mark.skipif(not PLUSH.is_dir(), reason="the shared plush capture is absent")

MILD = (0.06, -0.02, 0.002, -0.003)


def camera(distortion=MILD, width=200, height=150, path: Path | None = None) -> View:
    K = np.array([[160.0, 0, 97.0], [0, 165.0, 78.5], [0, 0, 1]])
    return View("a.png", K, np.eye(4), width, height, path, distortion)


def saved(path: Path, pixels: np.ndarray) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def pixel_centres(view: View) -> np.ndarray:
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    return np.stack([x, y], -1)


# The lens


def test_distortion_by_hand():
    """One point of f = 100: x/z = 0.5, y/z = -0.2, r^2 = 0.29."""
    view = View("a", np.diag([100.0, 100, 1]), np.eye(4), 9, 9, None, (0.1, 0.2, 0.01, 0.02))
    radial = 1 + 0.1 * 0.29 + 0.2 * 0.29**2
    x = 0.5 * radial + 2 * 0.01 * 0.5 * -0.2 + 0.02 * (0.29 + 2 * 0.25)
    y = -0.2 * radial + 0.01 * (0.29 + 2 * 0.04) + 2 * 0.02 * 0.5 * -0.2
    got = distort_points(view, np.array([[50.0, -20.0]]))
    assert_allclose(got, [[100 * x, 100 * y]], rtol=1e-14)


@settings(derandomize=True, max_examples=100)
@given(st.tuples(*[st.floats(-0.08, 0.08)] * 2, *[st.floats(-0.005, 0.005)] * 2), st.floats(0, 200), st.floats(0, 150))
def test_undistort_inverts_distort(distortion, x, y):
    view, pixel = camera(distortion), np.array([[x, y]])
    assert_allclose(distort_points(view, undistort_points(view, pixel)), pixel, atol=1e-6)
    assert_allclose(undistort_points(view, distort_points(view, pixel)), pixel, atol=1e-6)


@pytest.mark.parametrize("k1", [-0.3, -1.0])
def test_beyond_the_fold_there_is_no_light(k1):
    """r (1 + k1 r^2) turns at r^2 = -1/(3 k1); a pixel further out has no place on the photo."""
    assert fold_radius2((k1, 0.0, 0.0, 0.0)) == pytest.approx(-1 / (3 * k1))
    view = View("a", np.diag([100.0, 100, 1]), np.eye(4), 9, 9, None, (k1, 0.0, 0.0, 0.0))
    turn = 100 * np.sqrt(-1 / (3 * k1))
    inside, outside = distort_points(view, np.array([[turn * 0.99, 0.0], [turn * 1.01, 0.0]]))
    assert np.isfinite(inside).all()
    assert np.isnan(outside).all()
    furthest = turn * (1 + k1 * turn**2 / 1e4)
    reachable, beyond = undistort_points(view, np.array([[furthest * 0.9, 0], [furthest * 1.1, 0]]))
    assert np.isfinite(reachable).all()
    assert np.isnan(beyond).all()


@pytest.mark.parametrize(
    ("k1", "k2", "expected"),
    [(0.1, 0.0, np.inf), (0.0, 0.0, np.inf), (0.0, -0.2, 1.0), (-1.0, 0.25, 0.4), (-0.1, 0.5, np.inf)],
)
def test_fold_radius(k1, k2, expected):
    s = fold_radius2((k1, k2, 0.0, 0.0))
    assert s == pytest.approx(expected)
    if np.isfinite(s):
        assert 1 + 3 * k1 * s + 5 * k2 * s * s == pytest.approx(0, abs=1e-12)


def test_without_distortion_nothing_moves():
    pixels = np.array([[1.0, 2.0], [3.0, 4.0]])
    for move in (distort_points, undistort_points):
        assert_array_equal(move(camera(None), pixels), pixels)
    with refused(r"\(\.\.\., 2\)"):
        distort_points(camera(), np.zeros((4, 3)))


# The remap


def ramp(at: np.ndarray) -> np.ndarray:
    """A colour that is linear in the place, which bilinear interpolation reproduces exactly."""
    x, y = at[..., 0], at[..., 1]
    return np.stack([x, y, 0.5 * x + 0.5 * y], -1)


def test_undistortion_of_a_ramp_is_exact(tmp_path):
    """The photo is ramp(place): undistorted, each pixel shows ramp(distorted place)."""
    view = camera(path=tmp_path / "a.png")
    saved(view.image_path, np.floor(ramp(pixel_centres(view))).astype(np.uint8))
    source = distort_points(view, pixel_centres(view))
    inside = ((source > 1) & (source < (view.width - 1, view.height - 1))).all(-1)
    assert inside.mean() > 0.9
    error = load_image(view)[inside] - (ramp(source)[inside] - 0.5)
    # stored and returned values are rounded to whole numbers, by at most half a step each
    assert np.abs(error).max() < 1.01
    assert np.abs(error.mean(0)).max() < 0.3


def test_a_bent_line_becomes_straight(tmp_path):
    """Paint the photo of a straight line through the lens, undistort, fit: it is straight."""
    view = camera((0.12, 0.0, 0.0, 0.0), path=tmp_path / "a.png")
    back = undistort_points(view, pixel_centres(view))  # where each pixel of the photo looks
    brightness = 255 * np.exp(-(((back[..., 1] - 40) / 2.0) ** 2))
    saved(view.image_path, np.repeat(np.nan_to_num(brightness)[..., None], 3, -1).astype(np.uint8))

    def ridge(pixels):
        weights = pixels[:70, 12:-12, 0].astype(float) ** 2
        return (weights * (np.arange(70)[:, None] + 0.5)).sum(0) / weights.sum(0)

    photo = np.asarray(Image.open(view.image_path))
    assert np.ptp(ridge(photo)) > 1.0
    assert_allclose(ridge(load_image(view)), 40, atol=0.02)


def test_outside_the_photo_is_black(tmp_path):
    view = camera((0.3, 0.0, 0.0, 0.0), path=tmp_path / "a.png")
    saved(view.image_path, np.full((150, 200, 3), 200, np.uint8))
    pixels, source = load_image(view), distort_points(view, pixel_centres(view))
    inside = ((source >= 0) & (source < (view.width, view.height))).all(-1)
    assert 0 < inside.mean() < 1
    assert (pixels[inside] == 200).all()
    assert (pixels[~inside] == 0).all()


def test_resizing_keeps_places(tmp_path):
    """At a quarter of the size, the same lens bends the same places."""
    view = camera(path=tmp_path / "a.png", width=200, height=160)
    saved(view.image_path, np.floor(ramp(pixel_centres(view))).astype(np.uint8))
    small = view.resized(50, 40)
    pixels = load_image(small)
    assert pixels.shape == (40, 50, 3)
    expected = ramp(distort_points(view, pixel_centres(small) * 4)) - 0.5
    assert_allclose(pixels[3:-3, 3:-3], expected[3:-3, 3:-3], atol=1.5)


def test_label_maps_follow_the_photo():
    view = camera()
    rng = np.random.default_rng(0)
    ids = rng.integers(-1, 9, (150, 200)).astype(np.int32)
    got = undistort_ids(view, ids)
    assert got.dtype == np.int32
    source = distort_points(view, pixel_centres(view))
    for y, x in rng.integers((0, 0), (150, 200), (500, 2)):
        u, v = np.floor(source[y, x]).astype(int)
        expected = ids[v, u] if 0 <= u < 200 and 0 <= v < 150 else -1
        assert got[y, x] == expected
    assert undistort_ids(replace(view, distortion=None), ids) is ids


def test_label_maps_have_their_own_raster():
    """A checkerboard of half the size, undistorted as it is and at full size, agrees."""
    view, half = camera(), np.add.outer(np.arange(75) // 15, np.arange(100) // 20).astype(np.int32)
    full = np.kron(half, np.ones((2, 2), np.int32))
    agreement = np.kron(undistort_ids(view, half), np.ones((2, 2), np.int32)) == undistort_ids(view, full)
    assert agreement.mean() > 0.95


# Files


def test_orientation_of_exif_is_not_applied(tmp_path):
    path = tmp_path / "a.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6  # rotate by 90 degrees to show
    Image.new("RGB", (20, 10), (9, 9, 9)).save(path, exif=exif)
    assert photo_size(path) == (20, 10)
    assert load_image(camera(None, 20, 10, path)).shape == (10, 20, 3)


def test_transparency_is_composited_on_black(tmp_path):
    rgba = np.zeros((4, 6, 4), np.uint8)
    rgba[...] = (200, 100, 50, 128)
    rgba[0, 0, 3] = 0
    pixels = load_image(camera(None, 6, 4, saved(tmp_path / "a.png", rgba)))
    assert (pixels[0, 0] == 0).all()
    assert_allclose(pixels[1, 1], np.array([200, 100, 50]) * 128 / 255, atol=1)


def test_grey_palette_and_16_bit(tmp_path):
    grey = np.arange(24, dtype=np.uint8).reshape(4, 6) * 10
    expected = np.repeat(grey[..., None], 3, -1)
    wide = grey.astype(np.uint16) * 256 + 77
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey).convert("P").save(tmp_path / "palette.png")
    Image.fromarray(wide).save(tmp_path / "wide.png")
    for name in ("grey", "palette", "wide"):
        view = camera(None, 6, 4, tmp_path / f"{name}.png")
        assert_array_equal(load_image(view), expected)


def test_a_view_without_photo():
    with refused("has no photo"):
        load_image(camera())


def test_a_photo_that_vanished(tmp_path):
    with refused("no such photo"):
        load_image(camera(path=tmp_path / "gone.png"))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_truncated_photo(tmp_path, suffix):
    noise = np.random.default_rng(0).integers(0, 255, (150, 200, 3)).astype(np.uint8)
    path = saved(tmp_path / f"a{suffix}", noise)
    path.write_bytes(path.read_bytes()[:3000])
    assert photo_size(path) == (200, 150)
    with malformed("cannot be read as a photo"):
        load_image(camera(path=path))


def test_a_photo_that_claims_to_be_huge(tmp_path):
    path = saved(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    content = bytearray(path.read_bytes())
    content[16:24] = (60000).to_bytes(4, "big") * 2  # IHDR
    path.write_bytes(content)
    with malformed(r"a\.png"):
        photo_size(path)


def test_a_program_is_not_a_photo(tmp_path):
    """PostScript would start an interpreter: only decoders of photos are tried."""
    path = tmp_path / "a.png"
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\n")
    with malformed("JPEG/PNG"):
        photo_size(path)


@pytest.mark.data
@needs_plush
def test_the_plush_photos():
    view = read_views(PLUSH)[0]
    pixels = load_image(view)
    assert pixels.shape == (756, 1008, 3)
    original = np.asarray(Image.open(view.image_path)).astype(float)
    centre = np.s_[338:418, 464:544]  # the lens hardly moves the middle
    assert np.abs(pixels[centre].astype(float) - original[centre]).mean() < 2.0
    corner = distort_points(view, np.array([[0.5, 0.5]])) - 0.5
    x, y = (0.5 - 504) / 819.228928244, (0.5 - 378) / 819.228928244
    factor = 1 + 0.032123238578 * (x * x + y * y)
    assert_allclose(corner[0], [504 + (0.5 - 504) * factor - 0.5, 378 + (0.5 - 378) * factor - 0.5])
    grid = np.stack(np.meshgrid(np.arange(0, 1008, 31.0), np.arange(0, 756, 31.0)), -1)
    again = distort_points(view, undistort_points(view, grid))
    assert np.abs(again - grid).max() < 1e-3
