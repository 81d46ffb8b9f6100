"""COLMAP's cameras.txt, images.txt and points3D.txt, record by record."""

from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import TypeVar

from ..base.contents import encoding_of, open_file
from ..errors import FormatError
from .colmap_binary import CameraRecord, ImageRecord, PointRecord

T = TypeVar("T")


def cameras(path: Path) -> Iterator[CameraRecord]:
    for where, line in _data_lines(path):
        yield _parsed(_camera, line, where, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")


def images(path: Path) -> Iterator[ImageRecord]:
    """Yield images, whose lines alternate with lines of 2D points, which may be empty but must be there."""
    lines = _lines(path)
    for where, line in lines:
        if line and not line.startswith("#"):
            yield _parsed(_image, line, where, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
            where, observations = next(lines, (where, ""))
            if len(observations.split()) % 3:
                raise FormatError(
                    f"{where}: expected the 2D points of the image above (X Y POINT3D_ID, or an empty line)"
                )


def points(path: Path) -> Iterator[PointRecord]:
    for where, line in _data_lines(path):
        yield _parsed(_point, line, where, "POINT3D_ID X Y Z R G B ERROR TRACK[]")


def _camera(line: str) -> CameraRecord:
    camera_id, model, width, height, *parameters = line.split()
    return CameraRecord(int(camera_id), model, int(width), int(height), tuple(map(float, parameters)))


def _image(line: str) -> ImageRecord:
    _, *numbers, camera_id, name = line.split(maxsplit=9)
    w, x, y, z, tx, ty, tz = map(float, numbers)
    return ImageRecord(name, (w, x, y, z), (tx, ty, tz), int(camera_id))


def _point(line: str) -> PointRecord:
    _, x, y, z, r, g, b = line.split(maxsplit=7)[:7]
    return float(x), float(y), float(z), int(r), int(g), int(b)


def _parsed(parse: Callable[[str], T], line: str, where: str, expected: str) -> T:
    try:
        return parse(line)
    except ValueError:
        raise FormatError(f"{where}: expected {expected}, got '{ascii(line)[1:60]}'") from None


def _data_lines(path: Path) -> Iterator[tuple[str, str]]:
    return ((where, line) for where, line in _lines(path) if line and not line.startswith("#"))


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    with open_file(path) as raw, TextIOWrapper(raw, encoding=encoding_of(raw)) as file:
        try:
            for number, line in enumerate(file, 1):
                yield f"{path}:{number}", line.strip()
        except UnicodeError as error:
            raise FormatError(f"{path}: expected UTF-8 text: {error}") from error
