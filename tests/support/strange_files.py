"""Valid files of other programs that mean something else than a reader may think, with what is right for each.

A case writes a file or a folder and reads it; what comes out is one line: what was read, then warnings, or the error.
It is right if that line has all words that are expected of it, in their order: of an error what was given, what it was
taken for, and what to do. `python tests/support/strange_files.py` prints them.
"""

import io
import json
import re
import struct
import tempfile
import unicodedata
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from drsplat import load_codebook, load_image, read_features, read_gaussians, read_views, read_vocabulary
from drsplat.errors import DrSplatError, DrSplatWarning
from drsplat.formats.captures import read_times
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.langsplat import write_features
from drsplat.formats.peer_features import read_peer_features
from drsplat.formats.ply import read_point_ply
from drsplat.formats.sources import sources_of
from drsplat.photos.capture.finding import find_photos
from drsplat.scene.gaussians import SH_C0
from drsplat.scene.photo_masks import load_mask, views_with_something
from scene_files import random_gaussians, spz_bytes
from written_captures import transforms_document, write_colmap_binary, write_colmap_text, write_json, write_photo

W, H = 64, 48
CAMERA = [(1, "PINHOLE", W, H, (70.0, 70.0, W / 2, H / 2))]
ENTRY = {"width": W, "height": H, "position": [0, 0, 0], "rotation": np.eye(3).tolist(), "fx": 70, "fy": 70}
BOM = b"\xef\xbb\xbf"
PAGE = b"<!DOCTYPE html>\n<html><head><title>Sign in</title></head><body></body></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 104857600\n"


@dataclass(frozen=True)
class Case:
    """A file of a kind, what it is, how it is made and read, and words that the line about it has, or has not."""

    kind: str
    name: str
    read: Callable[[Path], str]
    expected: tuple[str, ...]
    absent: tuple[str, ...] = ()

    def outcome(self, folder: Path) -> str:
        """Return what was read, then its warnings; or the error."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                line = self.read(folder)
            except DrSplatError as error:
                line = f"{type(error).__name__}: {error}"
        said = [str(warning.message) for warning in caught if issubclass(warning.category, DrSplatWarning)]
        return " | ".join([line, *said]).replace(str(folder), "")

    def is_right(self, outcome: str) -> bool:
        at = 0
        for word in self.expected:
            found = outcome.find(word, at)
            if found < 0:
                return False
            at = found + len(word)
        return not any(word in outcome for word in self.absent)

    @property
    def is_error(self) -> bool:
        return self.expected[0] in ("FormatError", "InputError")


CASES: list[Case] = []


def case(kind: str, name: str, *expected: str, absent: tuple[str, ...] = ()) -> Callable[..., Any]:
    """Register a function of a folder that returns a line."""

    def add(read: Callable[[Path], str]) -> Callable[[Path], str]:
        CASES.append(Case(kind, name, read, expected, absent))
        return read

    return add


def images(*names: str) -> list[tuple[Any, ...]]:
    return [(k + 1, (1.0, 0.02 * k, 0.0, 0.0), (0.1 * k, 0.0, 4.0), 1, name) for k, name in enumerate(names)]


def capture(folder: Path, *names: str, files: tuple[str, ...] | None = None, model: str = "sparse/0") -> Path:
    """Write a COLMAP capture. files: names on disk below images/, where they are others."""
    write_colmap_text(folder / model, CAMERA, images(*names))
    for name in names if files is None else files:
        write_photo(folder / "images" / name, W, H)
    return folder


def views(folder: Path, **options: Any) -> str:
    found = read_views(folder, **options)
    photos = [view.image_path.name for view in found if view.image_path is not None]
    masks = sum(view.mask_path is not None for view in found)
    return f"{len(found)} views, {len(photos)} photos, {masks} masks: {', '.join(view.name for view in found[:3])}"


# Captures that hold more than one truth


@case("captures", "sparse/0 with 3 of 20 photos, sparse/1 with all, binary", "20 views", "sparse/0 (3 photos)")
def _(folder):
    names = [f"{k:02}.png" for k in range(20)]
    capture(folder, *names, model="sparse/1")
    write_colmap_binary(folder / "sparse/0", CAMERA, images(*names[:3]))
    return views(folder)


@case("captures", "the only model is sparse/merged", "2 views, 2 photos")
def _(folder):
    return views(capture(folder, "a.png", "b.png", model="sparse/merged"))


@case("captures", "the folder sparse is named, with 0 and 1 in it", "3 views, 3 photos", "sparse/1 (2 photos)")
def _(folder):
    capture(folder, "a.png", "b.png", "c.png")
    capture(folder, "a.png", "b.png", model="sparse/1")
    return views(folder / "sparse")


@case("captures", "models 0 and 1 right beside images (COLMAP's own window)", "3 views, 3 photos", "/0 (2 photos)")
def _(folder):
    capture(folder, "a.png", "b.png", "c.png", model="1")
    capture(folder, "a.png", "b.png", model="0")
    return views(folder)


@case("captures", "images.bin with 3 photos, images.txt beside it with 5", "3 views", "images.txt, with 5 photos")
def _(folder):
    names = [f"{k}.png" for k in range(5)]
    write_colmap_binary(capture(folder, *names) / "sparse/0", CAMERA, images(*names[:3]))
    return views(folder)


@case("captures", "photos in input/, as 3DGS' convert.py has them", "1 views, 1 photos")
def _(folder):
    write_photo(folder / "input/a.png", W, H)
    return views(capture(folder, "a.png", files=()))


@case("captures", "photos in Images/", "1 views, 1 photos")
def _(folder):
    write_photo(folder / "Images/a.png", W, H)
    return views(capture(folder, "a.png", files=()))


@case("captures", "a model without its images", "InputError", "got cameras.txt", "expected both", "copy it whole")
def _(folder):
    (capture(folder, "a.png") / "sparse/0/images.txt").unlink()
    return views(folder)


@case("captures", "a damaged first model: the sound one, and a word", "2 views", "sparse/0 (0 photos)")
def _(folder):
    capture(folder, "a.png", "b.png", model="sparse/1")
    (capture(folder, "a.png", "b.png", model="sparse/0") / "sparse/0/images.txt").write_text("1 no image\n")
    return views(folder)


@case("captures", "two models of as many photos: the first, and a word of the other", "2 views", "sparse/1 (2 photos)")
def _(folder):
    capture(folder, "a.png", "b.png")
    capture(folder, "c.png", "d.png", model="sparse/1")
    return views(folder)


for _what, _names, _files, _words in (
    ("photos in other case on disk", ("IMG_1.JPG", "Img_2.jpg"), ("img_1.jpg", "IMG_2.JPG"), ("2 views, 2 photos",)),
    ("folders in other case on disk", ("Cam0/a.png",), ("cam0/A.png",), ("1 views, 1 photos",)),
    (
        "letters composed in the model, decomposed on disk (a Mac)", (unicodedata.normalize("NFC", "Küche.png"),),
        (unicodedata.normalize("NFD", "Küche.png"),), ("1 views, 1 photos",),
    ),
    (
        "PNG in the model, JPEG on disk", ("a.png", "b.png"), ("a.jpg", "b.JPG"),
        ("2 views, 2 photos", "another suffix", "a.jpg for a.png"),
    ),
    (
        "a.jpg and A.jpg in the model, one of them on disk: each photo once", ("a.jpg", "A.jpg"), ("a.jpg",),
        ("2 views, 1 photos", "A.jpg"),
    ),
    ("two files that a name could mean: neither", ("IMG.png",), ("img.png", "Img.png"), ("0 photos", "no photo")),
    (
        "a Windows drive in the model", (r"C:\Users\me\room\a.png", r"C:\Users\me\room\b.png"), ("a.png", "b.png"),
        ("2 views, 2 photos, 0 masks: a.png, b.png",),
    ),
    (
        "a Windows share with folders of cameras",
        (r"\\nas\scans\room\images\cam0\a.png", r"\\nas\scans\room\images\cam1\a.png"),
        ("cam0/a.png", "cam1/a.png"), ("2 views, 2 photos", "cam0/a.png", "cam1/a.png"),
    ),
    ("names below the project: images/a.png", ("images/a.png",), ("a.png",), ("1 views, 1 photos",)),
    (
        "a name that leaves the folder by a drive and dots", (r"C:\room\a.png", r"C:\room\..\..\b.png"), (),
        ("FormatError", "b.png", "expected a file name", "by its place"),
    ),
):  # fmt: skip
    case("names", _what, *_words)(
        lambda folder, names=_names, files=_files: views(capture(folder, *names, files=files))
    )


@case("names", "names without suffix, and two files of each", "1 views, 1 photos", "a.jpg of a.jpg, a.png is taken")
def _(folder):
    write_json(folder / "cameras.json", [{"img_name": "a", **ENTRY}])
    write_photo(folder / "images/a.png", W, H), write_photo(folder / "images/a.jpg", W, H)
    return views(folder)


@case("names", "cameras.json of Windows", "2 views, 2 photos", "a.png, b.png")
def _(folder):
    write_json(folder / "cameras.json", [{"img_name": rf"D:\room\input\{name}", **ENTRY} for name in "ab"])
    write_photo(folder / "images/a.png", W, H), write_photo(folder / "images/b.png", W, H)
    return views(folder)


@case("names", "transforms.json of another machine, with masks", "2 views, 2 photos, 2 masks")
def _(folder):
    document = transforms_document(CAMERA, images("a.png", "b.png"))
    for frame in document["frames"]:
        name = frame["file_path"].split("/")[-1]
        frame |= {"file_path": rf"E:\scan\images\{name}", "mask_path": rf"E:\scan\masks\{name}"}
        write_photo(folder / "images" / name, W, H)
        Image.new("L", (W, H), 255).save(_made(folder / "masks" / name))
    write_json(folder / "transforms.json", document)
    return views(folder)


@case("names", "COLMAP's text in UTF-16, as Notepad saves it", "1 views, 1 photos")
def _(folder):
    capture(folder, "a.png")
    for file in (folder / "sparse/0").iterdir():
        file.write_text(file.read_text(), encoding="utf-16")
    return views(folder)


@case("names", "transforms.json in UTF-16", "1 views, 1 photos")
def _(folder):
    write_photo(folder / "images/a.png", W, H)
    text = json.dumps(transforms_document(CAMERA, images("a.png")))
    (folder / "transforms.json").write_text(text, encoding="utf-16")
    return views(folder)


@case("names", "features of photos and their times in other letters than the model's", "1 masks", "time 7.5")
def _(folder):
    capture(folder, "Küche/IMG_1.JPG", files=("küche/img_1.jpg",))
    write_features(folder / "features", "küche/img_1", np.zeros((4, H, W), np.int32), np.eye(1, 8, dtype=np.float32))
    (folder / "times.csv").write_text("name,time\nkÜche/img_1.jpg,7.5\n")
    (view,) = read_views(folder, times=folder / "times.csv")
    return f"{len(read_features(folder / 'features')[view.name].embeddings)} masks, time {view.time}"


def photo_of(folder: Path, name: str, size: tuple[int, int] = (256, 192), seed: int = 0) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC).save(_made(folder / name))


def photos(folder: Path) -> str:
    found = find_photos(folder)
    return f"{len(found)} photos, {sum(source.mask is not None for source in found)} masks"


@case("photos", "thumbnails in a folder and by name", "4 photos", "8 files", "smaller copies")
def _(folder):
    for k in range(4):
        photo_of(folder, f"IMG_{k}.jpg", seed=k)
        photo_of(folder, f"thumbs/IMG_{k}.jpg", (64, 48), seed=k)
        photo_of(folder, f"IMG_{k}_thumb.png", (64, 48), seed=k)
    return photos(folder)


@case("photos", "images_4 beside images", "3 photos", "3 files")
def _(folder):
    for k in range(3):
        photo_of(folder, f"images/{k}.png", seed=k)
        photo_of(folder, f"images_4/{k}.png", (64, 48), seed=k)
    return photos(folder)


@case("photos", "two cameras of a rig with files of the same names", "6 photos", absent=("aside",))
def _(folder):
    for k in range(3):
        photo_of(folder, f"wide/{k}.png", seed=k)
        photo_of(folder, f"tele/{k}.png", (64, 48), seed=10 + k)
    return photos(folder)


@case("photos", "masks and depth maps beside the photos", "3 photos, 3 masks", "6 files", "masks and maps")
def _(folder):
    for k in range(3):
        photo_of(folder, f"{k}.png", seed=k)
        Image.new("L", (256, 192), 255).save(folder / f"{k}.png.mask.png")
        Image.fromarray(np.full((192, 256), 1000, np.uint16)).save(folder / f"{k}_depth.png")
    return photos(folder)


@case("photos", "a photo of a mask, which is no mask of a photo", "2 photos, 0 masks", absent=("aside",))
def _(folder):
    photo_of(folder, "carnival_mask.png"), photo_of(folder, "street.png", seed=1)
    return photos(folder)


# Lenses and frames


def transforms(folder: Path, root: dict[str, Any] | None = None, frame: dict[str, Any] | None = None) -> str:
    document = transforms_document(CAMERA, images("a.png", "b.png")) | (root or {})
    for each in document["frames"]:
        each.pop("camera_model", None)
    document["frames"][1] |= frame or {}
    for name in ("a.png", "b.png"):
        write_photo(folder / "images" / name, W, H)
    write_json(folder / "transforms.json", document)
    found = read_views(folder)
    view = found[-1]
    return f"{len(found)} views, focal {view.K[0, 0]:.2f}, centre {view.K[0, 2]:g}, distortion {view.distortion}"


FISHEYE = ("a fisheye lens, not a pinhole", "undistort")
LENSES: tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...] = (
    ("a panorama of instant-ngp", {"latlong": True}, ("latlong is True", "a panorama", "cut")),
    (
        "a panorama by its model",
        {"camera_model": "EQUIRECTANGULAR"},
        ("camera_model is 'EQUIREC", "not a pinhole", "cut"),
    ),
    ("an f-theta lens", {"ftheta_p0": 0.1, "ftheta_p1": 0.9}, ("ftheta_p0 is 0.1", *FISHEYE)),
    ("an orthographic picture", {"ortho": True}, ("ortho is True", "an orthographic picture", "give photos")),
    (
        "an orthographic camera of Blender",
        {"camera_type": "ORTHO"},
        ("camera_type is 'ORTHO'", "not a pinhole", "give photos"),
    ),
    ("a fisheye by its flag", {"is_fisheye": True}, ("is_fisheye is True", *FISHEYE)),
    (
        "a fisheye of nerfstudio",
        {"camera_model": "OPENCV_FISHEYE"},
        ("camera_model is 'OPENCV_F", "not a pinhole", "undist"),
    ),
    ("a fisheye of ROS", {"distortion_model": "equidistant"}, ("distortion_model is", "not a pinhole", "undistort")),
    ("a name of a telephone's lens", {"lens_model": "phone back camera 4.2 mm f/1.6", "lens": "wide"}, ("2 views",)),
    ("a sixth-order lens", {"k3": 0.01}, ("k3 is 0.01", "terms beyond", "undistort")),
    ("a lens with a skew (Metashape)", {"b2": 1.5}, ("b2 is 1.5", "sheared pixels", "undistort")),
    ("a rolling shutter", {"rolling_shutter": [0, 0, 0.5, 0]}, ("rolling_shutter is", "moves while", "export")),
    ("poses of Mitsuba", {"normal_mts_args": {"a": 1}}, ("normal_mts_args is", "other axes", "export")),
    ("poses in OpenCV's axes", {"camera_convention": "opencv"}, ("camera_convention is", "other axes", "export")),
    (
        "a flag that says no",
        {"is_fisheye": False, "latlong": 0, "rolling_shutter": [0, 0, 0, 0], "k3": 0.0},
        ("2 views",),
    ),
)
for _name, _keys, _words in LENSES:
    _absent = ("camera_model",) if "camera_model" not in _keys else ()
    _words = _words if _words[0] == "2 views" else ("FormatError", *_words)
    case("lenses", f"{_name}, of the file", *_words, absent=_absent)(
        lambda folder, keys=_keys: transforms(folder, keys)
    )
    case("lenses", f"{_name}, of a frame", *_words, absent=_absent)(
        lambda folder, keys=_keys: transforms(folder, frame=keys)
    )


@case("lenses", "distortion_params of nerfstudio", "2 views", "(0.1, -0.02, 0.003, 0.004)")
def _(folder):
    return transforms(folder, frame={"distortion_params": [0.1, -0.02, 0, 0, 0.003, 0.004]})


@case("lenses", "a camera that moves while it looks", "FormatError", "transform_matrix_end", "moves", "give one")
def _(folder):
    return transforms(folder, frame={"transform_matrix_end": np.eye(4).tolist()})


@case("lenses", "cameras.json with a principal point", "1 views", "centre 30")
def _(folder):
    return _cameras_json(folder, cx=30, cy=20)


@case("lenses", "cameras.json of a fisheye", "FormatError", "is_fisheye is True", "a fisheye lens", "undistort")
def _(folder):
    return _cameras_json(folder, is_fisheye=True)


def _cameras_json(folder: Path, **more: Any) -> str:
    write_json(folder / "cameras.json", [{"img_name": "a", **ENTRY, **more}])
    write_photo(folder / "images/a.png", W, H)
    found = read_views(folder)
    return f"{len(found)} views, centre {found[0].K[0, 2]:g}"


# Masks: the left half is kept


LEFT = np.zeros((H, W), np.uint8)
LEFT[:, : W // 2] = 255


def masked(folder: Path, picture: Image.Image, place: str = "masks/a.png", photo: str = "a.jpg", **options: Any) -> str:
    write_photo(folder / "images" / photo, W, H)
    write_colmap_text(folder / "sparse/0", CAMERA, images(photo))
    picture.save(_made(folder / place))
    return kept(folder, **options)


def kept(folder: Path, **options: Any) -> str:
    mask = load_mask(read_views(folder, **options)[0])
    if mask is None:
        return "no mask"
    return f"keeps {mask[:, : W // 2].mean():.0%} of the left, {mask[:, W // 2 :].mean():.0%} of the right"


KEEPS_LEFT = "keeps 100% of the left, 0% of the right"


def _rgba(grey: np.ndarray, alpha: np.ndarray) -> Image.Image:
    return Image.fromarray(np.dstack([grey, grey, grey, alpha]).astype(np.uint8))


def _palette(colours: list[int]) -> Image.Image:
    picture = Image.fromarray((LEFT > 0).astype(np.uint8), "P")
    picture.putpalette(colours)
    return picture


_noise = np.random.default_rng(3).integers(20, 250, (H, W)).astype(np.uint8)
PICTURES: tuple[tuple[str, Image.Image], ...] = (
    ("0 and 1", Image.fromarray(LEFT // 255)),
    ("0 and 100", Image.fromarray(LEFT // 255 * 100)),
    ("one bit", Image.fromarray(LEFT).convert("1")),
    ("16 bits, 0 and 65,535", Image.fromarray(LEFT.astype(np.uint16) * 257)),
    ("16 bits, 0 and 1", Image.fromarray((LEFT // 255).astype(np.uint16))),
    ("16 bits, 0 and 255", Image.fromarray(LEFT.astype(np.uint16))),
    ("32 bits, 0 and 1", Image.fromarray((LEFT // 255).astype(np.int32))),
    ("a palette of black and white", _palette([0, 0, 0, 255, 255, 255])),
    ("a palette of labels (VOC)", _palette([0, 0, 0, 128, 0, 0])),
    ("a palette with white first", _palette([255, 255, 255, 0, 0, 0]).point(lambda index: 1 - index)),
    ("dark labels in colour", Image.fromarray(np.dstack([LEFT // 4, LEFT * 0, LEFT * 0]))),
    ("white with transparency", _rgba(np.full_like(LEFT, 255), LEFT)),
    ("black with transparency (brush)", _rgba(np.zeros_like(LEFT), LEFT)),
    ("a photo cut out", _rgba(_noise, LEFT)),
    ("black and white, all opaque", _rgba(LEFT, np.full_like(LEFT, 255))),
    ("grey with alpha", Image.fromarray(np.dstack([np.full_like(LEFT, 255), LEFT]), "LA")),
)
for _what, _picture in PICTURES:
    _place = "masks/a.tif" if _picture.mode == "I" else "masks/a.png"
    case("masks", _what, KEEPS_LEFT)(lambda folder, what=_picture, place=_place: masked(folder, what, place))

PLACES = (
    "masks/a.jpg.png", "masks/a.png", "masks/a.mask.png", "masks/a.jpg.mask.png", "masks/a.bmp", "Masks/A.PNG",
    "mask/a.png", "images/masks/a.png", "images/a.jpg.mask.png", "images/a.mask.png", "images/a_mask.png",
    "images/.mask/a.png",
)  # fmt: skip
for _place in PLACES:
    case("masks", f"at {_place}", KEEPS_LEFT)(lambda folder, place=_place: masked(folder, Image.fromarray(LEFT), place))


@case("masks", "masks_4 beside images_4, masks beside images", KEEPS_LEFT)
def _(folder):
    write_photo(folder / "images_4/a.jpg", W, H)
    Image.fromarray(LEFT).save(_made(folder / "masks_4/a.png"))
    return masked(folder, Image.new("L", (W, H), 255), images="images_4")


@case("masks", "dynamic_mask_a.png of instant-ngp, white is left out", "keeps 0% of the left, 100% of the right")
def _(folder):
    return masked(folder, Image.fromarray(LEFT), "images/dynamic_mask_a.png")


@case("masks", "masks of 0 and 1, with invert_masks", "keeps 0% of the left, 100% of the right")
def _(folder):
    return masked(folder, Image.fromarray(LEFT // 255), invert_masks=True)


@case("masks", "red on a white picture: named, not guessed", "FormatError", "colours and no black", "no mask", "paint")
def _(folder):
    return masked(folder, Image.fromarray(np.dstack([np.full_like(LEFT, 255), LEFT, LEFT])))


@case("masks", "a photo beside a.jpg that is called a.png is no mask", "no mask")
def _(folder):
    write_photo(folder / "images/a.png", W, H)
    return masked(folder, Image.fromarray(LEFT), "elsewhere/a.png")


@case("masks", "all black: inverting them is no advice", "0 left", "one value all over", absent=("keeps",))
def _(folder):
    return _used(folder, [np.zeros_like(LEFT)] * 3)


@case("masks", "people in white, two photos without any", "1 left", "meant the other way", "keeps 90%")
def _(folder):
    person = np.zeros_like(LEFT)
    person[10:40, 10:40] = 255
    return _used(folder, [np.zeros_like(LEFT), np.zeros_like(LEFT), person])


def _used(folder: Path, masks: list[np.ndarray]) -> str:
    capture(folder, *(f"{k}.png" for k in range(len(masks))))
    for k, mask in enumerate(masks):
        Image.fromarray(mask).save(_made(folder / f"masks/{k}.png"))
    return f"{len(views_with_something(read_views(folder)))} left"


# Colours and activations of scenes

FLOATS = [
    "x",
    "y",
    "z",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
]


def rows_of(count: int = 200) -> dict[str, np.ndarray]:
    """Return columns as 3DGS has them: the first colour is 0.2, 0.4, 0.6."""
    rng = np.random.default_rng(5)
    columns = {name: rng.normal(0, 1, count) for name in FLOATS}
    columns |= {f"scale_{k}": rng.normal(-3, 0.5, count) for k in range(3)} | {"opacity": rng.normal(0, 2, count)}
    columns |= {f"f_dc_{k}": rng.normal(0, 0.5, count) for k in range(3)}
    for k, colour in enumerate((0.2, 0.4, 0.6)):
        columns[f"f_dc_{k}"][0] = (colour - 0.5) / SH_C0
    return columns


def ply(
    columns: dict[str, np.ndarray], comment: str = "", before: bytes = b"", element: tuple[str, bytes] = ("", b"")
) -> bytes:
    types = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i2": "short", "u4": "uint", "i1": "char"}
    columns = {name: c.astype("<f4") if c.dtype.kind == "f" and c.itemsize == 8 else c for name, c in columns.items()}
    record = np.empty(len(next(iter(columns.values()))), [(name, c.dtype) for name, c in columns.items()])
    for name, column in columns.items():
        record[name] = column
    head = ["ply", "format binary_little_endian 1.0", *([f"comment {comment}"] if comment else [])]
    head += [f"element vertex {len(record)}", *(f"property {types[c.dtype.str[1:]]} {n}" for n, c in columns.items())]
    head += [element[0]] if element[0] else []
    return before + "\n".join([*head, "end_header", ""]).encode() + record.tobytes() + element[1]


def scene(folder: Path, content: bytes, name: str = "scene.ply") -> str:
    path = _made(folder / name)
    path.write_bytes(content)
    return read_scene(path)


def read_scene(path: Path) -> str:
    g = read_gaussians(path)
    colour = " ".join(f"{value:.2f}" for value in 0.5 + SH_C0 * g.sh[0, 0])
    return f"{len(g)} Gaussians, colour {colour}, opacity {g.opacities.mean():.2f}, scale {np.median(g.scales):.3f}"


def _halves(column: np.ndarray) -> np.ndarray:
    return column.astype("<f2").view("<u2")


RIGHT = "200 Gaussians, colour 0.20 0.40 0.60, opacity 0.5"


def _rgb_rows(convert: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    columns = rows_of()
    for k, name in enumerate(("red", "green", "blue")):
        columns[name] = convert(np.clip(0.5 + SH_C0 * columns.pop(f"f_dc_{k}"), 0, 1))
    return columns


for _what, _convert in (
    ("bytes", lambda c: np.rint(255 * c).astype("u1")),
    ("16 bits", lambda c: np.rint(65535 * c).astype("<u2")),
    ("fractions", lambda c: c),
    ("fractions up to 255", lambda c: 255 * c),
):
    case("colours", f"red, green, blue as {_what} in place of f_dc", RIGHT)(
        lambda folder, convert=_convert: scene(folder, ply(_rgb_rows(convert)))
    )


for _value, _words in ((1, ("FormatError", "color_space is", "linear light", "Export it in sRGB")), (0, (RIGHT,))):
    case("colours", f"an element color_space of {_value} (SHARP)", *_words)(
        lambda folder, value=_value: scene(
            folder, ply(rows_of(), element=("element color_space 1\nproperty uchar color_space", bytes([value])))
        )
    )


@case("colours", "half floats, cut into tiles", "200 rows", "near 0.05")
def _(folder):
    _made(folder / "scene.ply").write_bytes(ply({name: _halves(column) for name, column in rows_of().items()}))
    (source,) = sources_of(folder / "scene.ply")
    return f"{len(source.positions())} rows, near {np.median(source.gaussians(np.arange(200)).scales):.3f}"


def _activated(*names: str) -> dict[str, np.ndarray]:
    columns = rows_of()
    if "opacity" in names:
        columns["opacity"] = 1 / (1 + np.exp(-columns["opacity"]))
    return columns | {name: np.exp(columns[name]) for name in names if name != "opacity"}


SCALES = ("scale_0", "scale_1", "scale_2")
for _what, _names in (("scales and opacities", (*SCALES, "opacity")), ("opacities", ("opacity",)), ("scales", SCALES)):
    case("colours", f"{_what} activated twice", RIGHT, "scale 0.05", "activated")(
        lambda folder, names=_names: scene(folder, ply(_activated(*names)))
    )


def _in_millimetres(columns: dict[str, np.ndarray], *names: str) -> dict[str, np.ndarray]:
    return columns | {name: 1000 * columns[name] for name in ("x", "y", "z", *names)}


GREY = {name: np.full(200, 9, "u1") for name in ("red", "green", "blue")}
LARGE = {name: rows_of()[name] + np.log(1000) for name in SCALES}
IN_SHORTS = {name: _halves(column).view("<i2") for name, column in rows_of().items() if name not in "xyz"}
OBJ_INFO = ply(rows_of(), "color_space linear").replace(b"comment color_space", b"obj_info color_space")
MANY = {name: np.tile(column, 1250) for name, column in _activated("opacity", *SCALES).items()}
LINEAR_LIGHT = ("linear light", "Export it in sRGB")
for _what, _content, *_words in (
    ("as 3DGS has them, with a byte order mark before the header", ply(rows_of(), before=BOM), RIGHT, "scale 0.05"),
    ("f_dc, with red, green and blue of a viewer beside", ply(rows_of() | GREY), RIGHT),
    (
        "a comment: color_space linearRGB", ply(rows_of(), "color_space linearRGB"), "FormatError",
        "color_space is 'linearrgb'", *LINEAR_LIGHT,
    ),
    ("obj_info: color_space linear", OBJ_INFO, "FormatError", "color_space is 'linear'", *LINEAR_LIGHT),
    ("a comment: color_space sRGB", ply(rows_of(), "color_space sRGB"), RIGHT),
    ("activated values of more rows than are judged", ply(MANY), "250000 Gaussians", "scale 0.05", "activated"),
    ("half floats declared ushort", ply({n: _halves(c) for n, c in rows_of().items()}), RIGHT, "scale 0.05"),
    ("float positions, half floats declared short", ply(rows_of() | IN_SHORTS), RIGHT, "scale 0.05"),
    (
        "quantised to bytes, by an unknown rule", ply(rows_of() | {"opacity": np.full(200, 200, "u1")}), "FormatError",
        "whole numbers (uint8)", "quantised", "Export",
    ),
    (
        "activated scales of a scene in millimetres, whose exponentials overflow",
        ply(_in_millimetres(_activated(*SCALES), *SCALES)), RIGHT, "scale 5", "activated",
    ),
):  # fmt: skip
    case("colours", _what, *_words)(lambda folder, content=_content: scene(folder, content))


@case("colours", "a scene in millimetres as it should be", RIGHT, "scale 5", absent=("activated",))
def _(folder):
    return scene(folder, ply(_in_millimetres(rows_of() | LARGE)))


@case("colours", "activated, cut into tiles", "near 0.07", "0.049", "activated")
def _(folder):
    _made(folder / "scene.ply").write_bytes(ply(_activated("opacity", *SCALES)))
    (source,) = sources_of(folder / "scene.ply")
    return f"near {np.median(source.sizes()):.3f}, {np.median(source.gaussians(np.arange(9)).scales):.3f}"


USD = """#usda 1.0
(
    defaultPrim = "World"
)
def Xform "World" (
    prepend apiSchemas = ["ColorSpaceAPI"]
)
{
    ABOVE
    def ParticleField3DGaussianSplat "splats" (
        APPLIED
    )
    {
        OWN
        uniform int radiance:sphericalHarmonicsDegree = 0
        point3f[] positions = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        quatf[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0), (1, 0, 0, 0)]
        float3[] scales = [SCALES]
        float[] opacities = [0.9, 0.8, 0.7]
        float3[] radiance:sphericalHarmonicsCoefficients = [(-1, -1, -1), (0.5, 0, 0), (0, 0.5, 0)] (
            elementSize = 1
            META
        )
    }
}
"""
SIZES = "(0.1, 0.1, 0.1), (0.1, 0.2, 0.1), (0.1, 0.1, 0.3)"


def usda(above: str = "", own: str = "", meta: str = "", scales: str = SIZES, applied: bool = True) -> bytes:
    """Return a stage whose colour space may be said above the splats, at them, or at their harmonics.

    applied: ColorSpaceAPI to the splats, without which USD does not look at their own.
    """
    text = USD.replace("APPLIED", 'prepend apiSchemas = ["ColorSpaceAPI"]' if applied else "")
    text = text.replace("ABOVE", above).replace("OWN", own).replace("META", meta).replace("SCALES", scales)
    return text.encode()


def _space(name: str) -> str:
    return f'uniform token colorSpace:name = "{name}"'


LINEAR = ("FormatError", "lin_rec709_scene", "linear light", "Export it in srgb")
for _what, _parts, _words in (
    ("linear light, said above the splats", {"above": _space("lin_rec709_scene")}, LINEAR),
    (
        "linear light, said of the harmonics",
        {"meta": 'colorSpace = "lin_ap1_scene"'},
        ("FormatError", "lin_ap1_scene", "linear light", "Export it in srgb"),
    ),
    (
        "other primaries",
        {"own": _space("srgb_p3d65_scene")},
        ("FormatError", "srgb_p3d65_scene", "other primaries", "Export it in srgb"),
    ),
    (
        "sRGB of its own below linear light",
        {"above": _space("lin_rec709_scene"), "own": _space("srgb_rec709_scene")},
        ("3 Gaussians",),
    ),
    (
        "sRGB of its own that is not applied, below linear light",
        {"above": _space("lin_rec709_scene"), "own": _space("srgb_rec709_scene"), "applied": False},
        LINEAR,
    ),
    ("linear light that is not applied", {"own": _space("lin_rec709_scene"), "applied": False}, LINEAR),
    ("sRGB as 3DGRUT calls it", {"own": _space("srgb_rec709_display")}, ("3 Gaussians",)),
    ("raw", {"own": _space("raw")}, ("3 Gaussians",)),
    (
        "logarithms of scales",
        {"scales": "(-3, -3, -3), (-3, -2, -3), (-3, -3, -1)"},
        ("FormatError", "3 of 3 rows have scales", "logarithms", "Export it again"),
    ),
):
    case("colours", f"USD: {_what}", *_words, absent=("Delete",))(
        lambda folder, parts=_parts: scene(folder, usda(**parts), "scene.usda")
    )


# Files that are something else


def torch_zip(*names: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/data.pkl", b"\x80\x02}q\x00" + b"".join(names) + b".")
        archive.writestr("archive/data/0", bytes(64))
    return buffer.getvalue()


for _name, _content in (
    ("step-000029999.ckpt", torch_zip(b"_model.gauss_params.means")),
    ("ckpt_29999_rank0.pt", torch_zip(b"splats")),
    ("scene.ply", torch_zip(b"splats")),
    ("chkpnt30000.pth", b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M"),
):
    case(
        "else",
        f"a checkpoint, {_name}",
        "InputError",
        "got a checkpoint",
        "expected a scene",
        "ns-export gaussian-splat",
        "gsplat",
    )(lambda folder, name=_name, content=_content: scene(folder, content, name))


@case("else", "a folder that nerfstudio trained", "InputError", "got a checkpoint", "expected a scene", "ns-export")
def _(folder):
    _made(folder / "run/nerfstudio_models/step-000029999.ckpt").write_bytes(torch_zip())
    (folder / "run/config.yml").write_text("!!python/object:nerfstudio.engine.trainer.TrainerConfig\n")
    return read_scene(folder / "run")


for _suffix in (".ply", ".spz", ".splat", ".sog", ".glb", ".usda", ".ksplat"):
    case("else", f"a web page called scene{_suffix}", "FormatError", _suffix, "a web page", "raw file")(
        lambda folder, suffix=_suffix: scene(folder, PAGE, f"scene{suffix}")
    )
    case("else", f"a pointer of LFS called scene{_suffix}", "FormatError", _suffix, "Git LFS", "git lfs pull")(
        lambda folder, suffix=_suffix: scene(folder, POINTER, f"scene{suffix}")
    )


@case("else", "a photo that is a pointer of LFS", "FormatError", "a.png", "Git LFS", "git lfs pull")
def _(folder):
    capture(folder, "a.png")
    (folder / "images/a.png").write_bytes(POINTER)
    return views(folder)


@case("else", "COLMAP's images.bin as a pointer of LFS", "FormatError", "images.bin", "Git LFS", "git lfs pull")
def _(folder):
    write_colmap_binary(folder / "sparse/0", CAMERA, images("a.png"))
    (folder / "sparse/0/images.bin").write_bytes(POINTER)
    return views(folder)


@case(
    "else",
    "transforms.json as a web page",
    "FormatError",
    "transforms.json",
    "a web page",
    "raw file",
    absent=("expected JSON",),
)
def _(folder):
    (folder / "transforms.json").write_bytes(PAGE)
    return views(folder)


for _name, _read in (
    ("features.pt", lambda path: read_peer_features(path)),
    ("codes.faiss", lambda path: load_codebook(path)),
    ("words.json", lambda path: read_vocabulary(path)),
    ("times.csv", lambda path: read_times(path)),
    ("points.ply", lambda path: read_point_ply(path)),
):

    def _pointer(folder: Path, name: str = _name, read: Callable[[Path], Any] = _read) -> str:
        (folder / name).write_bytes(POINTER)
        return str(read(folder / name))

    case("else", f"a pointer of LFS called {_name}", "FormatError", _name, "Git LFS", "git lfs pull")(_pointer)


def _members(content: bytes) -> bytes:
    raw = zlib.decompress(content, 31)
    parts = (raw[:1000], raw[1000:])
    return b"".join(_gzip(part) for part in parts)


def _gzip(raw: bytes) -> bytes:
    packer = zlib.compressobj(wbits=31)
    return packer.compress(raw) + packer.flush()


G = random_gaussians(np.random.default_rng(1))
for _what, _content in (
    ("in two gzip members", _members(spz_bytes(G, 3))),
    ("with zeros behind", spz_bytes(G, 2) + bytes(512)),
    ("with zeros in the stream", _gzip(zlib.decompress(spz_bytes(G, 3), 31) + bytes(16))),
    ("version 4 with zeros behind", spz_bytes(G, 4) + bytes(3)),
):
    case("else", f"SPZ {_what}", "24 Gaussians")(lambda folder, content=_content: scene(folder, content, "scene.spz"))


@case("else", "SPZ with something else behind", "FormatError", "scene.spz", "gzip stream is damaged", "gzipped")
def _(folder):
    return scene(folder, spz_bytes(G, 3) + b"something else", "scene.spz")


def wide_png(pixels: np.ndarray) -> bytes:
    """Return a PNG of 16 bits, grey or RGB."""
    high, width = pixels.shape[:2]
    head = struct.pack(">IIBBBBB", width, high, 16, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body)) for tag, body in chunks
    )


for _what, _most, _shape, _words in (
    ("10 bits in 16, RGB", 1023, (H, W, 3), ("FormatError", "16 bits a channel", "10 or 12 bits", "multiply")),
    ("10 bits in 16, grey", 1023, (H, W), ("FormatError", "16 bits a channel", "10 or 12 bits", "multiply")),
    ("12 bits in 16, grey", 4095, (H, W), ("FormatError", "16 bits a channel", "10 or 12 bits", "multiply")),
    ("16 bits, RGB", 65535, (H, W, 3), ("brightest 255",)),
    ("16 bits, grey", 65535, (H, W), ("brightest 255",)),
):

    def _wide(folder: Path, most: int = _most, shape: tuple[int, ...] = _shape) -> str:
        pixels = np.random.default_rng(2).integers(0, most + 1, shape)
        pixels[0, 0] = most
        capture(folder, "a.png")
        (folder / "images/a.png").write_bytes(wide_png(pixels))
        return f"brightest {load_image(read_views(folder)[0]).max()}"

    case("else", f"a photo of {_what}", *_words)(_wide)


@case("else", "an output called s.compressed.ply", "InputError", "s.compressed.ply", "compressed PLY", "name it s.ply")
def _(folder):
    write_gaussians(folder / "s.compressed.ply", G)
    return "written"


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def outcomes() -> Iterator[tuple[Case, str]]:
    """Yield each case with what came of it."""
    for one in CASES:
        with tempfile.TemporaryDirectory() as folder:
            yield one, one.outcome(Path(folder))


if __name__ == "__main__":
    wrong = 0
    print("| kind | file | expected | came | |\n|---|---|---|---|---|")
    for one, line in outcomes():
        mark = "" if one.is_right(line) else "**wrong**"
        wrong += mark != ""
        came = re.sub(r"\s+", " ", line).replace("|", "/")
        print(f"| {one.kind} | {one.name} | {'; '.join(one.expected)} | {came[:150]} | {mark} |")
    print(f"\n{len(CASES) - wrong} of {len(CASES)} right")
    raise SystemExit(bool(wrong))
