"""What photos say of themselves, their names and order, and why they get no pose."""

import io
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from drsplat.fronts.commands.capture import LENSES as LENSES_OF_THE_VERB
from drsplat.photos.capture.capturing import capture_names
from drsplat.photos.capture.finding import are_numbered, find_photos, in_order
from drsplat.photos.capture.photos import APPLE_SIGNATURE, ExifFacts, Photo, bring, exif_facts, turned_down
from drsplat.photos.capture.settings import LENSES
from drsplat.photos.capture.turning import Reasons
from refusing import refused

PIXELS = np.random.default_rng(0).integers(0, 255, (80, 100, 3), np.uint8)
EXIF_IFD, GPS_IFD, ORIENTATION, MAKER_NOTE = 0x8769, 0x8825, 0x0112, 37500


def picture(exif: Image.Exif, kind: str = "JPEG", size: tuple[int, int] = (100, 80)) -> bytes:
    content = io.BytesIO()
    Image.fromarray(PIXELS).resize(size).save(content, kind, exif=exif)
    return content.getvalue()


def facts_of(exif: Image.Exif) -> ExifFacts:
    with Image.open(io.BytesIO(picture(exif))) as photo:
        return exif_facts(photo)


def apple_note(*acceleration: int) -> bytes:
    """An iPhone's maker note of one entry: thousandths of g along x, y and z of the phone."""
    entry = struct.pack(">HHII", 8, 10, 3, 16 + 12)
    numbers = b"".join(struct.pack(">ii", part, 1000) for part in acceleration)
    return APPLE_SIGNATURE + b"\0\1MM" + struct.pack(">H", 1) + entry + numbers


def test_focal_length_place_and_camera_are_read():
    exif = Image.Exif()
    exif[271], exif[272] = "Maker\0\0", "Phone 7"
    exif.get_ifd(EXIF_IFD)[41989] = 26
    exif.get_ifd(GPS_IFD).update(
        {1: "S", 2: (33.0, 51.0, 36.0), 3: "W", 4: (70.0, 30.0, 0.0), 5: b"\x01", 6: 12.5}
    )  # below the sea
    facts = facts_of(exif)
    assert facts.camera == "Maker Phone 7"
    assert facts.focal_share == pytest.approx(26 / np.hypot(36, 24))
    assert facts.position == pytest.approx((-70.5, -33.86, -12.5))


@pytest.mark.parametrize(
    "gps", [{}, {2: (91.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0)}, {2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0)}, {2: 3, 4: "x"}]
)
def test_what_is_no_place_is_none(gps):
    exif = Image.Exif()
    exif.get_ifd(GPS_IFD).update(gps)
    with Image.open(io.BytesIO(picture(Image.Exif()))) as photo:
        photo.getexif = lambda: exif
        assert exif_facts(photo).position is None


@pytest.mark.parametrize(
    ("acceleration", "orientation", "down"),
    [
        ((0, -1000, 0), 6, (0, 1, 0)), ((-1000, 0, 0), 1, (0, 1, 0)), ((1000, 0, 0), 3, (0, 1, 0)),
        ((0, 0, -1000), 1, (0, 0, 1)),
    ],
    ids=["upright", "to the left", "to the right", "screen up: the camera looks down"],
)  # fmt: skip
def test_gravity_of_a_phone_is_down_in_the_upright_photo(acceleration, orientation, down):
    exif = Image.Exif()
    exif.get_ifd(EXIF_IFD)[MAKER_NOTE] = apple_note(*acceleration)
    assert turned_down(facts_of(exif).down, orientation) == pytest.approx(down)


@given(st.binary(max_size=200))
def test_a_damaged_maker_note_says_nothing_or_a_direction(tail):
    exif = Image.Exif()
    exif.get_ifd(EXIF_IFD)[MAKER_NOTE] = APPLE_SIGNATURE + b"\0\1MM" + tail
    down = facts_of(exif).down
    assert down is None or np.linalg.norm(down) == pytest.approx(1)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_photos_are_brought_upright(orientation, kind, tmp_path):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    (tmp_path / f"a.{kind.lower()}").write_bytes(picture(exif, kind))
    (source,) = find_photos(tmp_path)
    photo = bring(source, tmp_path)
    assert (photo.width, photo.height) == ((80, 100) if orientation > 4 else (100, 80))
    with Image.open(tmp_path / photo.file) as brought:
        assert brought.size == (photo.width, photo.height)
        assert brought.getexif().get(ORIENTATION, 1) == 1
    as_it_was = (tmp_path / photo.file).read_bytes() == source.path.read_bytes()
    assert as_it_was == (orientation == 1)


@pytest.mark.parametrize("mode", ["P", "LA", "RGBA", "CMYK", "I;16", "1"])
def test_odd_pixels_become_plain_ones(mode, tmp_path):
    grey = Image.fromarray(PIXELS[..., 0])
    odd = Image.fromarray(PIXELS[..., 0].astype(np.uint16) * 256) if mode == "I;16" else grey.convert(mode)
    odd.save(tmp_path / f"a.{'tif' if mode == 'CMYK' else 'png'}")
    photo = bring(find_photos(tmp_path)[0], tmp_path)
    with Image.open(tmp_path / photo.file) as brought:
        assert (brought.mode, brought.format) == ("RGB", "PNG")
        if mode in ("P", "LA", "RGBA", "I;16"):
            assert np.abs(np.asarray(brought)[..., 0].astype(int) - PIXELS[..., 0]).mean() < 3


def test_tiny_photos_are_left_out(tmp_path):
    (tmp_path / "a.jpg").write_bytes(picture(Image.Exif(), size=(63, 80)))
    assert bring(find_photos(tmp_path)[0], tmp_path).fault == "63x80 pixels are too few"


def test_photos_are_found_in_the_order_of_their_numbers(tmp_path):
    (tmp_path / "masks").mkdir()
    (tmp_path / "b").mkdir()
    for name in ("a10.jpg", "a9.JPG", "b/c.png", "masks/a9.png", ".a8.jpg", "note.txt"):
        (tmp_path / name).write_bytes(b"x")
    assert [source.name for source in find_photos(tmp_path)] == ["a9.JPG", "a10.jpg", "b/c.png"]


def test_folders_without_photos_are_refused(tmp_path):
    with refused("there is no photo in it"):
        find_photos(tmp_path)
    with refused("there is no such file or folder; expected a folder of photos or a video"):
        find_photos(tmp_path / "none")


@given(st.lists(st.text("aZ019.²", max_size=8)))
def test_any_names_can_be_sorted(names):
    assert sorted(sorted(names, key=in_order)) == sorted(names)


@pytest.mark.parametrize(
    ("names", "numbered"),
    [
        ([f"IMG_{k:04}.jpg" for k in range(20)], True),
        ([f"frame{7 * k}.png" for k in range(20)], True),
        ([f"2024-05-{k:02}_{17 * k % 60}.jpg" for k in range(20)], False),
        (["kitchen.jpg", "door.jpg", "bed.jpg"], False),
        (["a.jpg"], False),
    ],
)
def test_numbered_photos_are_told_from_others(names, numbered):
    assert are_numbered(names) == numbered


def test_names_in_a_capture_differ_in_more_than_their_suffix():
    photos = [
        Photo(name, file)
        for name, file in (("a.JPG", "1.jpg"), ("a.heic", "2.jpg"), ("A.png", "3.png"), ("b/a.jpeg", "4.jpg"))
    ]
    assert list(capture_names(photos).values()) == ["a.JPG", "a_heic.jpg", "A_png.png", "b/a.jpeg"]


def test_reasons():
    sharp = Photo("a", "a.jpg", sharpness=10.0)
    photos = [sharp, *(replace(sharp, name=name, file=f"{name}.jpg") for name in "bcdefg")]
    photos[2] = replace(photos[2], sharpness=1.0)
    features = {photo.file: 1000 for photo in photos} | {"b.jpg": 20}
    del features["g.jpg"]
    photos.append(replace(sharp, name="h", file="h.jpg"))
    features["h.jpg"] = 1000
    pairs = {("a.jpg", "e.jpg"): 17, ("a.jpg", "h.jpg"): 1234}
    models = [["a.jpg"], ["f.jpg", "x.jpg"]]
    said = [Reasons(photos, features, pairs, models).of(photo) for photo in photos[1:]]
    expected = (
        "hardly any texture, or is blurred: 20", "it is blurred", "no overlap", "at most 17", "another place",
        "could not read", "too little movement: 1,234 places",
    )  # fmt: skip
    for reason, words in zip(said, expected, strict=True):
        assert words in reason


def test_the_command_line_offers_the_lenses_that_there_are():
    """It names them itself, because help has to come without NumPy."""
    assert set(LENSES_OF_THE_VERB) == set(LENSES)
