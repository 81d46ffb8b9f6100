"""Pixels of a posed photo, on the raster of its pinhole.

Cost of decoding a picture file, from its headers, before a decoder is started.

A file of some hundred bytes can declare gigabytes, and a progressive JPEG can send its pixels over again as often as
it has bytes for.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from io import BufferedIOBase, BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError
from PIL.BmpImagePlugin import BmpImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.TiffImagePlugin import TiffImageFile

from ..base.arrays import Array, Bool, Colors, Float64, Mask, MaskIds, Pixels, PlanePoints
from ..base.contents import open_file
from ..errors import FormatError, InputError, placed
from .lens import Points, distort_points, undistort_points
from .views import View

MAX_SCANS_OF_LARGE = 32  # JPEGs; encoders write 1 to 15
MAX_SCANS_OF_SMALL = 500
SMALL_PIXELS = 1 << 20
MAX_JPEG_BYTES = 256 << 20

_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])", re.DOTALL)  # not stuffing or restarts, which stand among pixels
_START_MARKER = 0xD8
_SCAN_MARKER = 0xDA
_END_MARKER = 0xD9
_TILE_WIDTH_TAG, _TILE_LENGTH_TAG = 322, 323


def check_cost(picture: Image.Image, file: BufferedIOBase, most_pixels: int | None = None) -> None:
    """Refuse a picture that takes more time or memory to decode than its pixels deserve.

    picture: opened, not decoded. file: what it was opened from; its position stays.

    Raises: InputError: more pixels than `most_pixels`, a JPEG of too many scans, a TIFF of tiles far larger than
    itself, a BMP of runs, which is decoded byte by byte in Python and in older Pillow believes their lengths.
    """
    pixels, size = picture.width * picture.height, f"{picture.width}x{picture.height}"
    if most_pixels is not None and pixels > most_pixels:
        raise InputError(f"a picture of {size} pixels: at most {most_pixels:,} are taken, make it smaller")
    if isinstance(picture, JpegImageFile):
        position = file.tell()
        file.seek(0)
        content = file.read(MAX_JPEG_BYTES + 1)
        file.seek(position)
        if len(content) > MAX_JPEG_BYTES:
            raise InputError(f"a JPEG of more than {MAX_JPEG_BYTES:,} bytes")
        scans, most = jpeg_scans(content), most_scans(pixels)
        if scans > most:
            raise InputError(f"a JPEG of {size} pixels in {scans} scans: at most {most} are taken, save it anew")
    if isinstance(picture, TiffImageFile) and _tile(picture) > 4 * max(pixels, SMALL_PIXELS):
        raise InputError(f"a TIFF of {size} pixels in far larger tiles: save it as PNG")
    if isinstance(picture, BmpImageFile) and picture.info.get("compression") in (1, 2):
        raise InputError("a BMP of runs of pixels (RLE): save it as PNG")


def most_scans(pixels: int) -> int:
    """Return the number of scans a JPEG may have, so that their total number of pixels is bounded."""
    return min(MAX_SCANS_OF_SMALL, MAX_SCANS_OF_LARGE * max(1, SMALL_PIXELS // max(pixels, 1)))


def jpeg_scans(data: bytes) -> int:
    """Count the scans of a JPEG: its SOS markers, except those of previews inside segments."""
    scans, at = 0, 0
    while match := _MARKER.search(data, at):
        marker, at = match[1][0], match.end()
        if marker == _END_MARKER:
            break
        scans += marker == _SCAN_MARKER
        if marker != _START_MARKER:
            at += int.from_bytes(data[at : at + 2], "big")
    return scans


def _tile(picture: TiffImageFile) -> int:
    tags = picture.tag_v2
    return int(tags.get(_TILE_WIDTH_TAG, 0)) * int(tags.get(_TILE_LENGTH_TAG, 0))


PHOTO_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "PPM")
"""The only decoders that are ever started on a file, whatever its name."""

ORIENTATION_TAG = 0x0112
_MIN_BRIGHTEST = 16  # of 256, of pictures of 16 bits: those of 12 bits and less have none brighter
Way = Callable[[View, Points], Points]
_BLOCK_ROWS = 128  # remapped at once: the map of a whole 24 MP photo would take 400 MB


def photo_size(path: Path) -> tuple[int, int]:
    """Return width and height of the raster as stored, from the header alone.

    Raises: FormatError: not a photo, or so large that decoding it would be an attack.
    """
    with _opened(path) as photo:
        return photo.size


def decoded_picture(source: Path | BytesIO, most_pixels: int | None = None) -> Pixels:
    """Decode any picture as RGB, upright, on black where it is transparent; for queries, which have no camera.

    Raises: InputError: more than `most_pixels`, or too costly (`check_cost`), before it is decoded. FormatError:
    damaged, or not a picture; the message does not name the source.
    """
    try:
        with (
            open_file(source) if isinstance(source, Path) else nullcontext(source) as file,
            Image.open(file, formats=PHOTO_FORMATS) as coded,
        ):
            check_cost(coded, file, most_pixels)
            return np.asarray(ImageOps.exif_transpose(rgb_of(coded)))
    except InputError:
        raise
    except FormatError as error:
        raise FormatError(f"cannot be read as a picture: {error}") from None
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"cannot be read as a picture ({'/'.join(PHOTO_FORMATS)}): {type(error).__name__}") from error


def load_image(view: View) -> Pixels:
    """Return the photo of a view as RGB, resized to (view.height, view.width) and undistorted.

    The raster is taken as stored: an EXIF orientation is not applied, because poses and intrinsics of COLMAP,
    nerfstudio and 3DGS are of the stored raster. Transparency is composited on black, the default background of 3DGS.
    Undistortion keeps K and size: what lies outside the photo is black. 16-bit photos lose their low byte.

    Raises: InputError: the view has no photo. FormatError: the file is damaged, truncated, of
    another kind, or decodes to more pixels than a photo has.

    >>> ds.load_image(scene.views[0]).shape
    (72, 96, 3)
    """
    if view.image_path is None:
        raise InputError(f"view '{view.name}' has no photo: read it with images=FOLDER")
    with _opened(view.image_path) as photo:
        try:
            with open_file(view.image_path) as file:
                check_cost(photo, file)
        except InputError as error:
            raise FormatError(f"{view.image_path}: {error}") from None
        rgb = rgb_of(photo)
        if rgb.size != view.size:
            rgb = rgb.resize(view.size, Image.Resampling.BICUBIC)
        pixels = np.asarray(rgb)
    return pixels if view.distortion is None else _undistort_bilinear(view, pixels)


def photo_coverage(view: View) -> Mask:
    """Return which pixels of the pinhole lie on the photo; elsewhere `load_image` is black."""
    covered = np.ones((view.height, view.width), bool)
    if view.distortion is not None:
        for rows, source in _source_blocks(view):
            covered[rows] = _inside(source, view.width, view.height)
    return covered


def undistort_ids(view: View, mask_ids: MaskIds) -> MaskIds:
    """Bring a label map made on the photo as stored to the pinhole, by nearest pixel.

    The map keeps its own raster, which need not be the view's; it is -1 outside the photo. Masks computed on a
    distorted photo need it, those computed on what `load_image` returned do not.
    """
    return _moved_ids(view, mask_ids, distort_points)


def distort_ids(view: View, ids: MaskIds) -> MaskIds:
    """Bring a label map of the pinhole to the photo as it is stored, as `undistort_ids` does the other way."""
    return _moved_ids(view, ids, undistort_points)


def _moved_ids(view: View, ids: MaskIds, way: Way) -> MaskIds:
    if view.distortion is None:
        return ids
    height, width = ids.shape
    raster = view.resized(width, height)
    source = _nearest_pixels(width, height, raster.K.tobytes(), view.distortion, way)
    return np.where(source < 0, np.int32(-1), ids.reshape(-1)[source])


@lru_cache(maxsize=2)  # photos of a capture mostly share a camera; 4 bytes a pixel
def _nearest_pixels(
    width: int, height: int, intrinsics: bytes, distortion: tuple[float, float, float, float], way: Way
) -> MaskIds:
    """Return the flat index of the pixel that each pixel shows, `way` from it; -1 outside."""
    view = View("", np.frombuffer(intrinsics).reshape(3, 3), np.eye(4), width, height, distortion=distortion)
    nearest = np.full((height, width), -1, np.int32)
    for rows, source in _source_blocks(view, way):
        inside = _inside(source, width, height)
        x, y = source[inside].astype(np.int32).T
        nearest[rows][inside] = y * width + x
    nearest.flags.writeable = False
    return nearest


def _undistort_bilinear(view: View, photo: Pixels) -> Pixels:
    undistorted = np.zeros_like(photo)
    for rows, source in _source_blocks(view):
        inside = _inside(source, view.width, view.height)
        undistorted[rows][inside] = _bilinear(photo, source[inside])
    return undistorted


def _bilinear(photo: Pixels, at: PlanePoints) -> Colors:
    height, width = photo.shape[:2]
    corner = np.clip(at - 0.5, 0, (width - 1, height - 1))  # pixel centres are at half integers
    low = corner.astype(np.intp)
    fraction = (corner - low).astype(np.float32)
    right = (low[:, 0] < width - 1).astype(np.intp)
    below = (low[:, 1] < height - 1) * width
    index, fx, fy = low[:, 1] * width + low[:, 0], fraction[:, :1], fraction[:, 1:]
    flat = photo.reshape(-1, 3)
    top = flat[index] * (1 - fx) + flat[index + right] * fx
    bottom = flat[index + below] * (1 - fx) + flat[index + below + right] * fx
    blended: Array = top * (1 - fy) + bottom * fy + 0.5
    return blended.astype(np.uint8)


def _source_blocks(view: View, way: Way = distort_points) -> Iterator[tuple[slice, Float64[Array, "r w 2"]]]:
    """Yield blocks of rows of the pinhole, or of the photo, with the place of their pixel centres on the other."""
    columns = np.arange(view.width) + 0.5
    for start in range(0, view.height, _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, view.height)
        x, y = np.meshgrid(columns, np.arange(start, stop) + 0.5)
        yield slice(start, stop), way(view, np.stack([x, y], -1))


def _inside(points: Float64[Array, "r w 2"], width: int, height: int) -> Bool[Array, "r w"]:
    """Return which points lie on the photo; NaN does not."""
    x, y = points[..., 0], points[..., 1]
    return (x >= 0) & (x < width) & (y >= 0) & (y < height)


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open a photo and read its header; decoding errors in the block become FormatErrors."""
    try:
        with open_file(path) as file, Image.open(file, formats=PHOTO_FORMATS) as photo:
            yield photo
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such photo") from None
    except (FormatError, InputError) as error:
        raise FormatError(placed(path, error)) from None
    except UnidentifiedImageError:  # its message names an open file, not ours
        raise FormatError(f"{path}: is no photo ({'/'.join(PHOTO_FORMATS)})") from None
    except Exception as error:  # decoders of damaged files raise anything, from struct.error to KeyError
        raise FormatError(f"{path}: cannot be read as a photo ({'/'.join(PHOTO_FORMATS)}): {error}") from error


def is_wide(coded: Image.Image) -> bool:
    """Return whether a picture that is not decoded yet has 16 bits a channel."""
    return coded.mode.startswith("I;16") or any(";16" in str(tile[-1]) for tile in getattr(coded, "tile", ()))


def orientation_of(coded: Image.Image) -> int:
    """Return the EXIF orientation; 1 (upright) where it is missing or none."""
    try:
        value = coded.getexif().get(ORIENTATION_TAG, 1)
    except Exception:  # parsers of damaged blocks raise anything
        return 1
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def rgb_of(picture: Image.Image) -> Image.Image:
    """Return a picture in 8 bits a channel, on black where it is transparent; 16 bits lose their low byte.

    It is not turned upright: it keeps its EXIF orientation.

    Raises: FormatError: channels of 32 bits, or of 16 bits that hold values of 12 or less, which would be black.
    """
    if picture.mode in ("I", "F"):
        raise FormatError(f"pixels of mode {picture.mode}, not 8 or 16 bits a channel: convert it to PNG or JPEG")
    wide, orientation = is_wide(picture), orientation_of(picture)  # said by what decoding takes away
    if picture.mode.startswith("I;16"):
        grey = np.asarray(picture)
        wide = bool(grey.any())  # what is black is black
        rgb = Image.fromarray((grey >> 8).astype(np.uint8)).convert("RGB")
    elif "A" in picture.getbands() or "transparency" in picture.info:
        rgba = picture.convert("RGBA")
        rgb = Image.composite(rgba.convert("RGB"), Image.new("RGB", rgba.size), rgba.getchannel("A"))
    else:
        rgb = picture.convert("RGB")
    if wide and max(high for _, high in rgb.getextrema()) < _MIN_BRIGHTEST:  # type: ignore[misc, union-attr]
        raise FormatError(
            "16 bits a channel with no value above 4,095 of 65,535, as pictures of 10 or 12 bits have: they would be "
            "black; multiply the values (by 64 for 10 bits, by 16 for 12) and save it again"
        )
    rgb.getexif()[ORIENTATION_TAG] = orientation
    return rgb
