"""Axes of scenes and of files, and what is up in them.

A PLY has y down (right, down, front); glTF, SPZ and OpenUSD have y up, and so does every file that is exported; a
tileset of the Earth has z up. The world of a scene may have anything up.
"""

import numpy as np

from ..base.arrays import Matrix3, Vector3

HALF_TURN = np.diag([1.0, -1.0, -1.0])  # about x: between the axes of a PLY, y down, and those of glTF, y up
Z_UP_FROM_PLY = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def standing_up(up: Vector3) -> Matrix3:
    """Return the rotation from a world in which `up` is up to one in which y is; the same in all files.

    It turns `up` to the up of a PLY, and then by a half turn about x; so a scene of COLMAP's poses is turned by that
    alone.
    """
    return HALF_TURN @ standing_as_ply(up)


def standing_as_ply(up: Vector3) -> Matrix3:
    """Return the rotation by the smallest angle that turns `up` to the up of a PLY, -y; a half turn is about x."""
    source, target = up / np.linalg.norm(up), np.array([0.0, -1.0, 0.0])
    cosine = float(source @ target)
    if cosine > 1 - 1e-12:
        return np.eye(3)
    if cosine < -1 + 1e-12:
        return HALF_TURN.copy()
    x, y, z = np.cross(source, target)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)
