"""Records of a COLMAP model, whether in text or in binary.

Source: https://colmap.github.io/format.html and COLMAP's list of camera models.
"""

from typing import NamedTuple

from ..errors import FormatError
from .lenses import cure_of

PointRecord = tuple[float, float, float, int, int, int]
"""x, y, z (world), r, g, b."""

MODEL_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip
"""By COLMAP's model id."""

PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"), "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"), "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}  # fmt: skip
"""Parameters of the camera models that a remap to a pinhole can undo."""


class CameraRecord(NamedTuple):
    camera_id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


class ImageRecord(NamedTuple):
    """quaternion (w, x, y, z) and translation take world to camera."""

    name: str
    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    camera_id: int


def parameter_names(model: str, where: str) -> tuple[str, ...]:
    """Return the order of a model's parameters in the file.

    Raises: FormatError: a lens that no pinhole stands for; the message says what to run.
    """
    if model in PARAMETERS:
        return PARAMETERS[model]
    raise FormatError(
        f"{where}: camera model {model!a} is not supported (supported: {', '.join(PARAMETERS)}): {cure_of(model)}"
    )
