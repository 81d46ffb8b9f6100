"""Names and numbers of a GLB file with Gaussians, which its reader and its writer share.

Source: glTF 2.0; KHR_gaussian_splatting (release candidate of 2026); EXT_mesh_features; EXT_structural_metadata.
"""

import struct

import numpy as np

from ..base.arrays import Float64
from ..scene.similarity import quaternion_of

MAGIC, VERSION = b"glTF", 2
HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
CHUNK = struct.Struct("<I4s")  # bytes of the chunk, its kind
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\x00"
MAX_FILE_BYTES = 2**32 - 1  # a header's limit

SPLATTING, SPZ = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"
FEATURES, METADATA = "EXT_mesh_features", "EXT_structural_metadata"
KERNEL, COLOR_SPACE, LINEAR_COLOR_SPACE = "ellipse", "srgb_rec709_display", "lin_rec709_display"
POINTS_MODE = 0  # of a primitive
POSITION, COLOR = "POSITION", "COLOR_0"
ROTATION, SCALE, OPACITY = (f"{SPLATTING}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))
HARMONICS = tuple(f"{SPLATTING}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(2 * degree + 1))
FEATURE_ID, RELEVANCY = "_FEATURE_ID_0", "_RELEVANCY"

BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
COMPONENTS = {BYTE: "<i1", UNSIGNED_BYTE: "<u1", SHORT: "<i2", UNSIGNED_SHORT: "<u2", UNSIGNED_INT: "<u4", FLOAT: "<f4"}
NUMBERS_OF_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT3": 9, "MAT4": 16}

OURS = "drsplat"  # the name under which `extras` of the root node say what glTF has no place for


def rotation_xyzw(rotation: Float64[np.ndarray, "3 3"]) -> list[float]:
    """Return a rotation as a node has it: a unit quaternion x, y, z, w."""
    w, x, y, z = (float(number) + 0.0 for number in quaternion_of(rotation).round(15))
    return [x, y, z, w]
