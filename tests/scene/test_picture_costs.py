"""Pictures that would cost more than they show are refused before they are decoded."""

import io
import struct
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from drsplat.scene.masks.crops import MAX_PADDED_PIXELS, crop
from drsplat.scene.photos import (
    MAX_SCANS_OF_LARGE,
    MAX_SCANS_OF_SMALL,
    decoded_picture,
    jpeg_scans,
    load_image,
    most_scans,
)
from drsplat.scene.views import View
from refusing import malformed, refused

RNG = np.random.default_rng(0)


def jpeg(size: tuple[int, int] = (64, 48), **options: object) -> bytes:
    pixels = RNG.integers(0, 256, (size[1], size[0], 3), np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", **options)
    return buffer.getvalue()


def segment(marker: int, body: bytes) -> bytes:
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def scanned_again(picture: bytes, times: int) -> bytes:
    """The last scan of a progressive JPEG, sent over and over."""
    last = picture.rindex(b"\xff\xda")
    return picture[:-2] + picture[last:-2] * times + b"\xff\xd9"


def test_scans_are_counted():
    plain, progressive = jpeg(), jpeg(progressive=True)
    assert jpeg_scans(plain) == 1
    assert 5 <= jpeg_scans(progressive) <= 12
    assert jpeg_scans(scanned_again(progressive, 40)) == jpeg_scans(progressive) + 40
    preview = plain[:2] + segment(0xE1, b"Exif\0\0" + jpeg((8, 8), progressive=True)) + plain[2:]
    assert jpeg_scans(preview) == 1
    assert jpeg_scans(plain + progressive) == 1  # a decoder stops at the first end
    for length in range(0, len(progressive), 7):  # cut anywhere
        assert jpeg_scans(progressive[:length]) <= jpeg_scans(progressive)


def test_small_jpegs_may_have_more_scans():
    assert [most_scans(n) for n in (1, 10_000, 1 << 19, 1 << 20, 16_000_000)] == [
        MAX_SCANS_OF_SMALL,
        MAX_SCANS_OF_SMALL,
        2 * MAX_SCANS_OF_LARGE,
        MAX_SCANS_OF_LARGE,
        MAX_SCANS_OF_LARGE,
    ]


def test_a_jpeg_of_many_scans_is_refused_wherever_it_is_opened(tmp_path):
    ordinary = jpeg(progressive=True)
    assert decoded_picture(io.BytesIO(ordinary)).shape == (48, 64, 3)
    bomb = scanned_again(ordinary, 1000)
    with refused(r"64x48 pixels in 10\d\d scans"):
        decoded_picture(io.BytesIO(bomb))
    path = tmp_path / "photo.jpg"
    path.write_bytes(bomb)
    with refused("scans"):
        decoded_picture(path)
    view = View("photo.jpg", np.eye(3), np.eye(4), 64, 48, path)
    with malformed(r"photo\.jpg: a JPEG of .* scans"):
        load_image(view)
    path.write_bytes(ordinary)
    assert load_image(replace(view, width=32, height=24)).shape == (24, 32, 3)


def test_a_bitmap_of_runs_is_refused():
    """One run may say 255 rows, and a row may say that it is 16 million pixels long."""
    header = struct.pack("<IiiHHIIiiII", 40, 15_000_000, 1, 1, 8, 1, 6, 0, 0, 256, 0)
    data = b"\0\2\0\xff" * 4
    start = 14 + 40 + 1024
    bomb = b"BM" + struct.pack("<IHHI", start + len(data), 0, 0, start) + header
    with refused("RLE"):
        decoded_picture(io.BytesIO(bomb + bytes(1024) + data), 16_000_000)


def tiled(side: int) -> bytes:
    """A TIFF of one pixel in one tile."""
    body = zlib.compress(bytes(side * side))
    tags = [
        (256, 3, 1),
        (257, 3, 1),
        (258, 3, 8),
        (259, 3, 8),
        (262, 3, 1),
        (277, 3, 1),
        (322, 4, side),
        (323, 4, side),
    ]
    end = 8 + 2 + 12 * (len(tags) + 2) + 4
    tags += [(324, 4, end), (325, 4, len(body))]
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4) + body


def test_a_tiff_of_huge_tiles_is_refused():
    assert decoded_picture(io.BytesIO(tiled(256))).shape == (1, 1, 3)
    with refused("tiles"):
        decoded_picture(io.BytesIO(tiled(4096)))


@pytest.mark.parametrize("mode", ["1", "L", "RGB", "P", "LA", "RGBA", "CMYK", "I;16"])
def test_pictures_of_all_modes_are_as_they_were(mode):
    """The short way for opaque pictures against compositing on black."""
    picture = Image.fromarray(RNG.integers(0, 256, (9, 7, 3), np.uint8))
    coded = Image.new(mode, (7, 9)) if mode == "I;16" else picture.convert(mode)
    buffer = io.BytesIO()
    coded.save(buffer, "TIFF" if mode == "CMYK" else "PNG")
    with Image.open(buffer) as again:
        rgba = again.convert("RGBA")
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    expected = np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))
    np.testing.assert_array_equal(decoded_picture(buffer), expected)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 25_000), (25_000, 1), (3, 5_000_000)])
def test_a_thin_picture_is_scaled_before_it_is_padded(shape):
    picture = np.full((*shape, 3), 200, np.uint8)
    height, width = shape
    tracemalloc.start()
    square = crop(picture, np.ones(shape, bool), (0, 0, width, height))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    most = max(MAX_PADDED_PIXELS, 4 * height * width)
    assert square.shape[0] == square.shape[1]
    assert square.shape[0] ** 2 <= most
    assert peak < 4 * (3 * most + picture.nbytes)
    assert square.max() == 200
    lit = square.any(-1)
    assert (lit.any(0).all(), lit.any(1).all()) == (width > height, height > width)
