"""Valid files of other programs that mean something else than a reader may think, with what is right for each.

A case is a folder's files by name, and how they are read; what comes out is one line: what was read, then warnings, or
the error. It is right if that line has all parts of what is expected of it, " ... " between them, in their order: of an
error what was given, what it was taken for, and what to do.
`PYTHONPATH=tests python tests/support/strange_files.py` prints them.
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
from pathlib import Path
from typing import Any, NamedTuple

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
from scene_files import ply_bytes, random_gaussians, spz_bytes
from written_captures import transforms_document, write_colmap_binary, write_colmap_text

W, H = 64, 48
CAMERA = [(1, "PINHOLE", W, H, (70.0, 70.0, W / 2, H / 2))]
PAGE = b"<!DOCTYPE html>\n<html><head><title>Sign in</title></head><body></body></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 104857600\n"


class Model(NamedTuple):
    """A COLMAP model of photos with these names."""

    names: list[str]
    is_binary: bool = False


def put(folder: Path, files: dict[str, Any]) -> None:
    """Write files by their names: models, pictures, bytes and JSON; None takes one away again."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        match content:
            case Model():
                write = write_colmap_binary if content.is_binary else write_colmap_text
                write(path, CAMERA, images(content.names))
            case Image.Image():
                content.save(path)
            case bytes():
                path.write_bytes(content)
            case None:
                path.unlink()
            case _:
                path.write_text(json.dumps(content))


class Case(NamedTuple):
    """What a folder is, its files, how it is read, and what its line has, or has not."""

    kind: str
    read: Callable[[Path], str]
    name: str
    files: dict[str, Any]
    expected: str
    absent: str = "\0"

    def outcome(self, folder: Path) -> str:
        """Return what was read, then its warnings; or the error."""
        put(folder, self.files)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                line = self.read(folder)
            except DrSplatError as error:
                line = f"{type(error).__name__}: {error}"
        said = [str(warning.message) for warning in caught if issubclass(warning.category, DrSplatWarning)]
        return " | ".join([line, *said]).replace(str(folder), "")

    def is_right(self, outcome: str) -> bool:
        pattern = ".*".join(map(re.escape, self.expected.split(" ... ")))
        return re.search(pattern, outcome, re.DOTALL) is not None and self.absent not in outcome


CASES: list[Case] = []


def cases(kind: str, read: Callable[[Path], str], *rows: tuple[Any, ...]) -> None:
    CASES.extend(Case(kind, read, *row) for row in rows)


def images(names: list[str]) -> list[tuple[Any, ...]]:
    return [(k + 1, (1.0, 0.02 * k, 0.0, 0.0), (0.1 * k, 0.0, 4.0), 1, name) for k, name in enumerate(names)]


PHOTO = Image.new("RGB", (W, H), (40, 80, 120))


def photos(*names: str, folder: str = "images") -> dict[str, Image.Image]:
    return {f"{folder}/{name}": PHOTO for name in names}


def models(counts: dict[str, int], *binary: str) -> dict[str, Any]:
    """Return models with so many of the photos 00.png, 01.png, ..., and these photos."""
    names = [f"{k:02}.png" for k in range(max(counts.values()))]
    return {place: Model(names[:count], place in binary) for place, count in counts.items()} | photos(*names)


def renamed(names: str, *files: str, folder: str = "images") -> dict[str, Any]:
    """Return a model of names, and photos in files that are called otherwise."""
    return {"sparse/0": Model(names.split()), **photos(*files, folder=folder)}


def views(folder: Path, **options: Any) -> str:
    found = read_views(folder, **options)
    photos = [view.image_path.name for view in found if view.image_path is not None]
    masks = sum(view.mask_path is not None for view in found)
    return f"{len(found)} views, {len(photos)} photos, {masks} masks: {', '.join(view.name for view in found[:3])}"


# Captures that hold more than one truth

ONE = renamed("a.png", "a.png")
cases(
    "captures",
    views,
    (
        "sparse/0 with 3 of 20 photos, sparse/1 with all, binary",
        models({"sparse/1": 20, "sparse/0": 3}, "sparse/0"),
        "20 views ... sparse/0 (3 photos)",
    ),
    ("the only model is sparse/merged", models({"sparse/merged": 2}), "2 views, 2 photos"),
    (
        "models 0 and 1 right beside images (COLMAP's own window)",
        models({"1": 3, "0": 2}),
        "3 views, 3 photos ... /0 (2 photos)",
    ),
    ("photos in input/, as 3DGS' convert.py has them", renamed("a.png", "a.png", folder="input"), "1 views, 1 photos"),
    ("photos in Images/", renamed("a.png", "a.png", folder="Images"), "1 views, 1 photos"),
    (
        "a model without its images",
        ONE | {"sparse/0/images.txt": None},
        "InputError ... got cameras.txt ... expected both ... copy it whole",
    ),
    (
        "images.bin with 3 photos, images.txt beside it with 5",
        models({"sparse/0": 5, "sparse/0/": 3}, "sparse/0/"),
        "3 views ... images.txt, with 5 photos",
    ),
    (
        "a damaged first model: the sound one, and a word",
        models({"sparse/1": 2, "sparse/0": 2}) | {"sparse/0/images.txt": b"1 no image\n"},
        "2 views ... sparse/0 (0 photos)",
    ),
    (
        "two models of as many photos: the first, and a word of the other",
        {"sparse/1": Model(["c.png", "d.png"]), **models({"sparse/0": 2}), **photos("c.png", "d.png")},
        "2 views ... sparse/1 (2 photos)",
    ),
)
cases(
    "captures",
    lambda folder: views(folder / "sparse"),
    (
        "the folder sparse is named, with 0 and 1 in it",
        models({"sparse/0": 3, "sparse/1": 2}),
        "3 views, 3 photos ... sparse/1 (2 photos)",
    ),
)


def camera(name: str, **more: Any) -> dict[str, Any]:
    """Return an entry of 3DGS' cameras.json."""
    place = {"position": [0, 0, 0], "rotation": np.eye(3).tolist()}
    return {"id": 0, "img_name": name, "width": W, "height": H, "fx": 70, "fy": 70, **place, **more}


def transforms(root: dict[str, Any], frame: dict[str, Any], folder: str = "images/") -> dict[str, Any]:
    """Return a nerfstudio document of two photos, with further keys of its own and of its second frame."""
    document = transforms_document(CAMERA, images(["a.png", "b.png"]), folder) | root
    for each in document["frames"]:
        each.pop("camera_model")
    document["frames"][1] |= frame
    return document


PAIR = photos("a.png", "b.png")
_utf16 = json.dumps(transforms({}, {})).encode("utf-16")
_elsewhere = transforms({}, {}, "E:\\scan\\images\\")
for _frame in _elsewhere["frames"]:
    _frame["mask_path"] = _frame["file_path"].replace("images", "masks")
_white = Image.new("L", (W, H), 255)
cases(
    "names",
    views,
    ("photos in other case on disk", renamed("IMG_1.JPG Img_2.jpg", "img_1.jpg", "IMG_2.JPG"), "2 views, 2 photos"),
    ("folders in other case on disk", renamed("Cam0/a.png", "cam0/A.png"), "1 views, 1 photos"),
    (
        "letters composed in the model, decomposed on disk (a Mac)",
        renamed(*(unicodedata.normalize(form, "Küche.png") for form in ("NFC", "NFD"))),
        "1 views, 1 photos",
    ),
    (
        "PNG in the model, JPEG on disk",
        renamed("a.png b.png", "a.jpg", "b.JPG"),
        "2 views, 2 photos ... another suffix ... a.jpg for a.png",
    ),
    (
        "a.jpg and A.jpg in the model, one of them on disk: each photo once",
        renamed("a.jpg A.jpg", "a.jpg"),
        "2 views, 1 photos ... A.jpg",
    ),
    (
        "two files that a name could mean: neither",
        renamed("IMG.png", "img.png", "Img.png"),
        "1 views, 0 photos ... no photo",
    ),
    (
        "a Windows drive in the model",
        renamed(r"C:\Users\me\room\a.png C:\Users\me\room\b.png", "a.png", "b.png"),
        "2 views, 2 photos, 0 masks: a.png, b.png",
    ),
    (
        "a Windows share with folders of cameras",
        renamed(r"\\nas\scans\room\images\cam0\a.png \\nas\scans\room\images\cam1\a.png", "cam0/a.png", "cam1/a.png"),
        "2 views, 2 photos ... cam0/a.png ... cam1/a.png",
    ),
    ("names below the project: images/a.png", renamed("images/a.png", "a.png"), "1 views, 1 photos"),
    (
        "names without suffix, and two files of each",
        {"cameras.json": [camera("a")], **photos("a.png", "a.jpg")},
        "1 views, 1 photos ... a.jpg of a.jpg, a.png is taken",
    ),
    (
        "cameras.json of Windows",
        {"cameras.json": [camera(r"D:\room\input\a"), camera(r"D:\room\input\b", id=1)], **PAIR},
        "2 views, 2 photos ... a.png, b.png",
    ),
    (
        "transforms.json of another machine, with masks",
        {"transforms.json": _elsewhere, "masks/a.png": _white, "masks/b.png": _white, **PAIR},
        "2 views, 2 photos, 2 masks",
    ),
    ("transforms.json in UTF-16", {"transforms.json": _utf16, **PAIR}, "2 views, 2 photos"),
    (
        "a name that leaves the folder by a drive and dots",
        renamed(r"C:\room\a.png C:\room\..\..\b.png"),
        "FormatError ... b.png ... expected a file name ... by its place",
    ),
)


def in_utf16(folder: Path) -> str:
    for file in (folder / "sparse/0").iterdir():
        file.write_text(file.read_text(), encoding="utf-16")
    return views(folder)


def timed(folder: Path) -> str:
    write_features(folder / "features", "küche/img_1", np.zeros((4, H, W), np.int32), np.eye(1, 8, dtype=np.float32))
    (view,) = read_views(folder, times=folder / "times.csv")
    return f"{len(read_features(folder / 'features')[view.name].embeddings)} masks, time {view.time}"


cases("names", in_utf16, ("COLMAP's text in UTF-16, as Notepad saves it", ONE, "1 views, 1 photos"))
cases(
    "names",
    timed,
    (
        "features of photos and their times in other letters than the model's",
        renamed("Küche/IMG_1.JPG", "küche/img_1.jpg") | {"times.csv": "name,time\nkÜche/img_1.jpg,7.5".encode()},
        "1 masks ... time 7.5",
    ),
)


def several(*names: str, size: tuple[int, int] = (256, 192), seed: int = 0) -> dict[str, Image.Image]:
    """Return pictures, each unlike the others."""
    small = [np.random.default_rng(seed + k).integers(0, 256, (6, 8, 3), dtype=np.uint8) for k in range(len(names))]
    return {name: Image.fromarray(one).resize(size, 3) for name, one in zip(names, small, strict=True)}


def unposed(folder: Path) -> str:
    found = find_photos(folder)
    return f"{len(found)} photos, {sum(source.mask is not None for source in found)} masks"


def numbered(pattern: str, **look: Any) -> dict[str, Image.Image]:
    return several(*(pattern.format(k) for k in range(3)), **look)


SMALL: dict[str, Any] = {"size": (64, 48)}
_full = Image.new("L", (256, 192), 255)
_deep = Image.fromarray(np.full((192, 256), 1000, np.uint16))
cases(
    "photos",
    unposed,
    (
        "thumbnails in a folder and by name",
        numbered("IMG_{}.jpg") | numbered("thumbs/IMG_{}.jpg", **SMALL) | numbered("IMG_{}_thumb.png", **SMALL),
        "3 photos ... 6 files ... smaller copies",
    ),
    (
        "images_4 beside images",
        numbered("images/{}.png") | numbered("images_4/{}.png", **SMALL),
        "3 photos ... 3 files",
    ),
    (
        "two cameras of a rig with files of the same names",
        numbered("wide/{}.png") | numbered("tele/{}.png", seed=10, **SMALL),
        "6 photos",
        "aside",
    ),
    (
        "masks and depth maps beside the photos",
        numbered("{}.png")
        | {f"{k}.png.mask.png": _full for k in range(3)}
        | {f"{k}_depth.png": _deep for k in range(3)},
        "3 photos, 3 masks ... 6 files ... masks and maps",
    ),
    (
        "a photo of a mask, which is no mask of a photo",
        several("carnival_mask.png", "street.png"),
        "2 photos, 0 masks",
        "aside",
    ),
)

# Lenses and frames


def lens(folder: Path) -> str:
    found = read_views(folder)
    view = found[-1]
    return f"{len(found)} views, focal {view.K[0, 0]:.2f}, centre {view.K[0, 2]:g}, distortion {view.distortion}"


FISHEYE = "a fisheye lens, not a pinhole ... undistort"
for _name, _keys, _words in (
    ("a panorama of instant-ngp", {"latlong": True}, "latlong is True ... a panorama ... cut"),
    (
        "a panorama by its model",
        {"camera_model": "EQUIRECTANGULAR"},
        "camera_model is 'EQUIREC ... not a pinhole ... cut",
    ),
    ("an f-theta lens", {"ftheta_p0": 0.1, "ftheta_p1": 0.9}, f"ftheta_p0 is 0.1 ... {FISHEYE}"),
    ("an orthographic picture", {"ortho": True}, "ortho is True ... an orthographic picture ... give photos"),
    (
        "an orthographic camera of Blender",
        {"camera_type": "ORTHO"},
        "camera_type is 'ORTHO' ... not a pinhole ... give photos",
    ),
    ("a fisheye by its flag", {"is_fisheye": True}, f"is_fisheye is True ... {FISHEYE}"),
    (
        "a fisheye of nerfstudio",
        {"camera_model": "OPENCV_FISHEYE"},
        "camera_model is 'OPENCV_F ... not a pinhole ... undist",
    ),
    ("a fisheye of ROS", {"distortion_model": "equidistant"}, "distortion_model is ... not a pinhole ... undistort"),
    ("a name of a telephone's lens", {"lens_model": "phone back camera 4.2 mm f/1.6", "lens": "wide"}, ""),
    ("a sixth-order lens", {"k3": 0.01}, "k3 is 0.01 ... terms beyond ... undistort"),
    ("a lens with a skew (Metashape)", {"b2": 1.5}, "b2 is 1.5 ... sheared pixels ... undistort"),
    ("a rolling shutter", {"rolling_shutter": [0, 0, 0.5, 0]}, "rolling_shutter is ... moves while ... export"),
    ("poses of Mitsuba", {"normal_mts_args": {"a": 1}}, "normal_mts_args is ... other axes ... export"),
    ("poses in OpenCV's axes", {"camera_convention": "opencv"}, "camera_convention is ... other axes ... export"),
    ("a flag that says no", {"is_fisheye": False, "latlong": 0, "rolling_shutter": [0, 0, 0, 0], "k3": 0.0}, ""),
):
    _expected = f"FormatError ... {_words}" if _words else "2 views"
    _absent = "\0" if "camera_model" in _keys else "camera_model"
    for _where, _given in (("file", (_keys, {})), ("frame", ({}, _keys))):
        _row = f"{_name}, of the {_where}", {"transforms.json": transforms(*_given), **PAIR}, _expected, _absent
        cases("lenses", lens, _row)


def of_frame(**keys: Any) -> dict[str, Any]:
    return {"transforms.json": transforms({}, keys), **PAIR}


def of_camera(**keys: Any) -> dict[str, Any]:
    return {"cameras.json": [camera("a", **keys)], **photos("a.png")}


cases(
    "lenses",
    lens,
    (
        "distortion_params of nerfstudio",
        of_frame(distortion_params=[0.1, -0.02, 0, 0, 0.003, 0.004]),
        "2 views ... (0.1, -0.02, 0.003, 0.004)",
    ),
    (
        "a camera that moves while it looks",
        of_frame(transform_matrix_end=np.eye(4).tolist()),
        "FormatError ... transform_matrix_end ... moves ... give one",
    ),
    ("cameras.json with a principal point", of_camera(cx=30, cy=20), "1 views ... centre 30"),
    (
        "cameras.json of a fisheye",
        of_camera(is_fisheye=True),
        "FormatError ... is_fisheye is True ... a fisheye lens ... undistort",
    ),
)

# Masks: the left half is kept

LEFT = np.zeros((H, W), np.uint8)
LEFT[:, : W // 2] = 255
WHITE, BLACK = np.full_like(LEFT, 255), np.zeros_like(LEFT)
HALF = Image.fromarray(LEFT)


def kept(folder: Path, **options: Any) -> str:
    mask = load_mask(read_views(folder, **options)[0])
    if mask is None:
        return "no mask"
    return f"keeps {mask[:, : W // 2].mean():.0%} of the left, {mask[:, W // 2 :].mean():.0%} of the right"


def masked(picture: Image.Image, place: str = "masks/a.png") -> dict[str, Any]:
    return renamed("a.jpg", "a.jpg") | {place: picture}


def _bands(*planes: np.ndarray, mode: str | None = None) -> Image.Image:
    return Image.fromarray(np.dstack(planes), mode)


def _palette(*colours: int) -> Image.Image:
    picture = Image.fromarray(LEFT // 255, "P")
    picture.putpalette(colours)
    return picture


KEEPS_LEFT = "keeps 100% of the left, 0% of the right"
KEEPS_RIGHT = "keeps 0% of the left, 100% of the right"
_noise = np.random.default_rng(3).integers(20, 250, (H, W)).astype(np.uint8)
_wide = LEFT.astype(np.uint16)
PICTURES = {
    "0 and 1": Image.fromarray(LEFT // 255),
    "0 and 100": Image.fromarray(LEFT // 255 * 100),
    "one bit": HALF.convert("1"),
    "16 bits, 0 and 65,535": Image.fromarray(_wide * 257),
    "16 bits, 0 and 1": Image.fromarray(_wide // 255),
    "16 bits, 0 and 255": Image.fromarray(_wide),
    "32 bits, 0 and 1": Image.fromarray((LEFT // 255).astype(np.int32)),
    "a palette of black and white": _palette(0, 0, 0, 255, 255, 255),
    "a palette of labels (VOC)": _palette(0, 0, 0, 128, 0, 0),
    "a palette with white first": _palette(255, 255, 255, 0, 0, 0).point(lambda index: 1 - index),
    "dark labels in colour": _bands(LEFT // 4, BLACK, BLACK),
    "white with transparency": _bands(WHITE, WHITE, WHITE, LEFT),
    "black with transparency (brush)": _bands(BLACK, BLACK, BLACK, LEFT),
    "a photo cut out": _bands(_noise, _noise, _noise, LEFT),
    "black and white, all opaque": _bands(LEFT, LEFT, LEFT, WHITE),
    "grey with alpha": _bands(WHITE, LEFT, mode="LA"),
}
PLACES = (
    "masks/a.jpg.png", "masks/a.png", "masks/a.mask.png", "masks/a.jpg.mask.png", "masks/a.bmp", "Masks/A.PNG",
    "mask/a.png", "images/masks/a.png", "images/a.jpg.mask.png", "images/a.mask.png", "images/a_mask.png",
    "images/.mask/a.png",
)  # fmt: skip
cases(
    "masks",
    kept,
    *(
        (what, masked(picture, "masks/a.tif" if picture.mode == "I" else "masks/a.png"), KEEPS_LEFT)
        for what, picture in PICTURES.items()
    ),
    *((f"at {place}", masked(HALF, place), KEEPS_LEFT) for place in PLACES),
    ("dynamic_mask_a.png of instant-ngp, white is left out", masked(HALF, "images/dynamic_mask_a.png"), KEEPS_RIGHT),
    (
        "red on a white picture: named, not guessed",
        masked(_bands(WHITE, LEFT, LEFT)),
        "FormatError ... colours and no black ... no mask ... paint",
    ),
    ("a photo beside a.jpg that is called a.png is no mask", masked(PHOTO, "images/a.png"), "no mask"),
)
cases(
    "masks",
    lambda folder: kept(folder, images="images_4"),
    (
        "masks_4 beside images_4, masks beside images",
        masked(_white) | {"images_4/a.jpg": PHOTO, "masks_4/a.png": HALF},
        KEEPS_LEFT,
    ),
)
cases(
    "masks",
    lambda folder: kept(folder, invert_masks=True),
    ("masks of 0 and 1, with invert_masks", masked(PICTURES["0 and 1"]), KEEPS_RIGHT),
)


def used(*masks: np.ndarray) -> dict[str, Any]:
    pictures = {f"masks/{k:02}.png": Image.fromarray(mask) for k, mask in enumerate(masks)}
    return models({"sparse/0": len(masks)}) | pictures


_person = BLACK.copy()
_person[10:40, 10:40] = 255
cases(
    "masks",
    lambda folder: f"{len(views_with_something(read_views(folder)))} left",
    ("all black: inverting them is no advice", used(BLACK, BLACK, BLACK), "0 left ... one value all over", "keeps"),
    (
        "people in white, two photos without any",
        used(BLACK, BLACK, _person),
        "1 left ... meant the other way ... keeps 90%",
    ),
)

# Colours and activations of scenes

Columns = dict[str, np.ndarray]
AXES, SCALES, COLOURS = ("x", "y", "z"), ("scale_0", "scale_1", "scale_2"), ("red", "green", "blue")


def columns_of(count: int = 200) -> Columns:
    """Return columns as 3DGS has them: the first colour is 0.2, 0.4, 0.6."""
    rng = np.random.default_rng(5)
    made = {name: rng.normal(0, 1, count) for name in (*AXES, *(f"rot_{k}" for k in range(4)))}
    made |= {name: rng.normal(-3, 0.5, count) for name in SCALES} | {"opacity": rng.normal(0, 2, count)}
    for k, colour in enumerate((0.2, 0.4, 0.6)):
        made[f"f_dc_{k}"] = np.append((colour - 0.5) / SH_C0, rng.normal(0, 0.5, count - 1))
    return {name: column.astype("<f4") for name, column in made.items()}


RAW = columns_of()


def ply(columns: Columns, comment: str = "", before: bytes = b"") -> dict[str, bytes]:
    return {"scene.ply": before + ply_bytes(columns, before_header=comment)}


def read_scene(folder: Path) -> str:
    (path,) = folder.iterdir()
    g = read_gaussians(path)
    colour = " ".join(f"{value:.2f}" for value in 0.5 + SH_C0 * g.sh[0, 0])
    return f"{len(g)} Gaussians, colour {colour}, opacity {g.opacities.mean():.2f}, scale {np.median(g.scales):.3f}"


def halves(columns: Columns, kind: str, keep: tuple[str, ...] = ()) -> Columns:
    return {name: c if name in keep else c.astype("<f2").view(kind) for name, c in columns.items()}


def coloured(convert: Callable[[np.ndarray], np.ndarray]) -> Columns:
    """Return red, green and blue in place of f_dc."""
    colours = {name: convert(np.clip(0.5 + SH_C0 * RAW[f"f_dc_{k}"], 0, 1)) for k, name in enumerate(COLOURS)}
    return {name: column for name, column in RAW.items() if "dc" not in name} | colours


def activated(*names: str) -> Columns:
    return RAW | {name: 1 / (1 + np.exp(-RAW[name])) if name == "opacity" else np.exp(RAW[name]) for name in names}


def sharp(value: int) -> dict[str, bytes]:
    """Return a scene of SHARP, whose colour space is an element behind the rows."""
    content = ply(RAW)["scene.ply"].replace(
        b"end_header", b"element color_space 1\nproperty uchar color_space\nend_header"
    )
    return {"scene.ply": content + bytes([value])}


RIGHT = "200 Gaussians, colour 0.20 0.40 0.60, opacity 0.5"
LINEAR_LIGHT = "linear light ... Export it in sRGB"
_large = activated(*SCALES)
_large |= {name: 1000 * _large[name] for name in (*AXES, *SCALES)}
_millimetres = RAW | {name: RAW[name] + np.float32(np.log(1000)) for name in SCALES}
_millimetres |= {name: 1000 * RAW[name] for name in AXES}
cases(
    "colours",
    read_scene,
    (
        "as 3DGS has them, with a byte order mark before the header",
        ply(RAW, before=b"\xef\xbb\xbf"),
        f"{RIGHT} ... scale 0.05",
    ),
    *(
        (f"red, green, blue as {what} in place of f_dc", ply(coloured(convert)), RIGHT)
        for what, convert in (
            ("bytes", lambda c: np.rint(255 * c).astype("u1")),
            ("16 bits", lambda c: np.rint(65535 * c).astype("<u2")),
            ("fractions", lambda c: c),
            ("fractions up to 255", lambda c: 255 * c),
        )
    ),
    (
        "f_dc, with red, green and blue of a viewer beside",
        ply(RAW | dict.fromkeys(COLOURS, np.full(200, 9, "u1"))),
        RIGHT,
    ),
    (
        "a comment: color_space linearRGB",
        ply(RAW, "comment color_space linearRGB"),
        f"FormatError ... color_space is 'linearrgb' ... {LINEAR_LIGHT}",
    ),
    (
        "obj_info: color_space linear",
        ply(RAW, "obj_info color_space linear"),
        f"FormatError ... color_space is 'linear' ... {LINEAR_LIGHT}",
    ),
    ("a comment: color_space sRGB", ply(RAW, "comment color_space sRGB"), RIGHT),
    ("an element color_space of 1 (SHARP)", sharp(1), f"FormatError ... color_space is ... {LINEAR_LIGHT}"),
    ("an element color_space of 0 (SHARP)", sharp(0), RIGHT),
    (
        "activated values of more rows than are judged",
        ply({name: np.tile(column, 1250) for name, column in activated("opacity", *SCALES).items()}),
        "250000 Gaussians ... scale 0.05 ... activated",
    ),
    ("half floats declared ushort", ply(halves(RAW, "<u2")), f"{RIGHT} ... scale 0.05"),
    ("float positions, half floats declared short", ply(halves(RAW, "<i2", keep=AXES)), f"{RIGHT} ... scale 0.05"),
    (
        "quantised to bytes, by an unknown rule",
        ply(RAW | {"opacity": np.full(200, 200, "u1")}),
        "FormatError ... whole numbers (uint8) ... quantised ... Export",
    ),
    *(
        (f"{what} activated twice", ply(activated(*names)), f"{RIGHT} ... scale 0.05 ... activated")
        for what, names in (
            ("scales and opacities", (*SCALES, "opacity")),
            ("opacities", ("opacity",)),
            ("scales", SCALES),
        )
    ),
    (
        "activated scales of a scene in millimetres, whose exponentials overflow",
        ply(_large),
        f"{RIGHT} ... scale 5 ... activated",
    ),
    ("a scene in millimetres as it should be", ply(_millimetres), f"{RIGHT} ... scale 5", "activated"),
)


def tiled(folder: Path) -> str:
    (source,) = sources_of(folder / "scene.ply")
    scales = np.median(source.gaussians(np.arange(len(source.positions()))).scales)
    return f"{len(source.positions())} rows, near {np.median(source.sizes()):.3f}, {scales:.3f}"


cases(
    "colours",
    tiled,
    ("half floats, cut into tiles", ply(halves(RAW, "<u2")), "200 rows ... near ... 0.05"),
    ("activated, cut into tiles", ply(activated("opacity", *SCALES)), "near 0.07 ... 0.05 ... activated"),
)

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
APPLIED = 'prepend apiSchemas = ["ColorSpaceAPI"]'
SIZES = "(0.1, 0.1, 0.1), (0.1, 0.2, 0.1), (0.1, 0.1, 0.3)"


def usda(**parts: str) -> dict[str, bytes]:
    """Return a stage whose colour space may be said ABOVE the splats, at them (OWN), or at their harmonics (META).

    APPLIED: ColorSpaceAPI to the splats, without which USD does not look at their own.
    """
    text = USD
    for word, value in ({"ABOVE": "", "OWN": "", "META": "", "SCALES": SIZES, "APPLIED": APPLIED} | parts).items():
        text = text.replace(word, value)
    return {"scene.usda": text.encode()}


def _space(name: str) -> str:
    return f'uniform token colorSpace:name = "{name}"'


LINEAR = "FormatError ... lin_rec709_scene ... linear light ... Export it in srgb"
_linear, _srgb = _space("lin_rec709_scene"), _space("srgb_rec709_scene")
cases(
    "colours",
    read_scene,
    *(
        (f"USD: {what}", usda(**parts), words, "Delete")
        for what, parts, words in (
            ("linear light, said above the splats", {"ABOVE": _linear}, LINEAR),
            (
                "linear light, said of the harmonics",
                {"META": 'colorSpace = "lin_ap1_scene"'},
                LINEAR.replace("rec709", "ap1"),
            ),
            (
                "other primaries",
                {"OWN": _space("srgb_p3d65_scene")},
                "FormatError ... srgb_p3d65_scene ... other primaries ... Export it in srgb",
            ),
            ("sRGB of its own below linear light", {"ABOVE": _linear, "OWN": _srgb}, "3 Gaussians"),
            (
                "sRGB of its own that is not applied, below linear light",
                {"ABOVE": _linear, "OWN": _srgb, "APPLIED": ""},
                LINEAR,
            ),
            ("linear light that is not applied", {"OWN": _linear, "APPLIED": ""}, LINEAR),
            ("sRGB as 3DGRUT calls it", {"OWN": _space("srgb_rec709_display")}, "3 Gaussians"),
            ("raw", {"OWN": _space("raw")}, "3 Gaussians"),
            (
                "logarithms of scales",
                {"SCALES": "(-3, -3, -3), (-3, -2, -3), (-3, -3, -1)"},
                "FormatError ... 3 of 3 rows have scales ... logarithms ... Export it again",
            ),
        )
    ),
)

# Files that are something else


def archive(*names: bytes) -> bytes:
    """Return a checkpoint of PyTorch."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/data.pkl", b"\x80\x02}q\x00" + b"".join(names) + b".")
        archive.writestr("archive/data/0", bytes(64))
    return buffer.getvalue()


def gzipped(raw: bytes) -> bytes:
    packer = zlib.compressobj(wbits=31)
    return packer.compress(raw) + packer.flush()


G = random_gaussians(np.random.default_rng(1))
SPZ = spz_bytes(G, 3)
_raw = zlib.decompress(SPZ, 31)
LFS, WEB = "Git LFS ... git lfs pull", "a web page ... raw file"
CHECKPOINT = "InputError ... got a checkpoint ... expected a scene ... ns-export"
cases(
    "else",
    read_scene,
    *(
        (f"a checkpoint, {name}", {name: content}, f"{CHECKPOINT} gaussian-splat ... gsplat")
        for name, content in (
            ("step-000029999.ckpt", archive(b"_model.gauss_params.means")),
            ("ckpt_29999_rank0.pt", archive(b"splats")),
            ("scene.ply", archive(b"splats")),
            ("chkpnt30000.pth", b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M"),
        )
    ),
    (
        "a folder that nerfstudio trained",
        {
            "run/nerfstudio_models/step-000029999.ckpt": archive(),
            "run/config.yml": b"!!python/object:nerfstudio.engine.trainer.TrainerConfig\n",
        },
        CHECKPOINT,
    ),
    *(
        (f"{what} called scene{suffix}", {f"scene{suffix}": content}, f"FormatError ... {suffix} ... {words}")
        for suffix in (".ply", ".spz", ".splat", ".sog", ".glb", ".usda", ".ksplat")
        for what, content, words in (("a web page", PAGE, WEB), ("a pointer of LFS", POINTER, LFS))
    ),
    *(
        (f"SPZ {what}", {"scene.spz": content}, "24 Gaussians")
        for what, content in (
            ("in two gzip members", gzipped(_raw[:1000]) + gzipped(_raw[1000:])),
            ("with zeros behind", spz_bytes(G, 2) + bytes(512)),
            ("with zeros in the stream", gzipped(_raw + bytes(16))),
            ("version 4 with zeros behind", spz_bytes(G, 4) + bytes(3)),
        )
    ),
    (
        "SPZ with something else behind",
        {"scene.spz": SPZ + b"something else"},
        "FormatError ... scene.spz ... gzip stream is damaged ... gzipped",
    ),
)
cases(
    "else",
    views,
    ("a photo that is a pointer of LFS", ONE | {"images/a.png": POINTER}, f"FormatError ... a.png ... {LFS}"),
    (
        "COLMAP's images.bin as a pointer of LFS",
        {"sparse/0": Model(["a.png"], is_binary=True), "sparse/0/images.bin": POINTER},
        f"FormatError ... images.bin ... {LFS}",
    ),
    (
        "transforms.json as a web page",
        {"transforms.json": PAGE},
        f"FormatError ... transforms.json ... {WEB}",
        "expected JSON",
    ),
)
READERS: dict[str, Callable[[Path], Any]] = {
    "features.pt": read_peer_features,
    "codes.faiss": load_codebook,
    "words.json": read_vocabulary,
    "times.csv": read_times,
    "points.ply": read_point_ply,
}
for _name, _read in READERS.items():
    cases(
        "else",
        lambda folder, name=_name, read=_read: str(read(folder / name)),
        (f"a pointer of LFS called {_name}", {_name: POINTER}, f"FormatError ... {_name} ... {LFS}"),
    )


def wide_png(most: int, *shape: int) -> bytes:
    """Return a PNG of 16 bits, grey or RGB, of values up to `most`."""
    pixels = np.random.default_rng(2).integers(0, most + 1, shape)
    pixels[0, 0] = most
    head = struct.pack(">IIBBBBB", W, H, 16, 2 if len(shape) == 3 else 0, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body)) for tag, body in chunks
    )


FEW_BITS = "FormatError ... 16 bits a channel ... 10 or 12 bits ... multiply"
cases(
    "else",
    lambda folder: f"brightest {load_image(read_views(folder)[0]).max()}",
    *(
        (f"a photo of {what}", ONE | {"images/a.png": wide_png(*made)}, words)
        for what, made, words in (
            ("10 bits in 16, RGB", (1023, H, W, 3), FEW_BITS),
            ("10 bits in 16, grey", (1023, H, W), FEW_BITS),
            ("12 bits in 16, grey", (4095, H, W), FEW_BITS),
            ("16 bits, RGB", (65535, H, W, 3), "brightest 255"),
            ("16 bits, grey", (65535, H, W), "brightest 255"),
        )
    ),
)
cases(
    "else",
    lambda folder: str(write_gaussians(folder / "s.compressed.ply", G)),
    ("an output called s.compressed.ply", {}, "InputError ... s.compressed.ply ... compressed PLY ... name it s.ply"),
)


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
        print(f"| {one.kind} | {one.name} | {one.expected} | {came[:150]} | {mark} |")
    print(f"\n{len(CASES) - wrong} of {len(CASES)} right")
    raise SystemExit(bool(wrong))
