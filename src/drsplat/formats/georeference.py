"""Georeference: a scene's place on the Earth, in georeference.json beside it."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..base.arrays import Matrix3, Points
from ..base.contents import AnyPath
from ..errors import FormatError
from ..scene.geodesy import geodetic
from .json_files import as_document, as_kind, read_json, write_json

NAME = "georeference.json"
FORMAT, VERSION = "drsplat georeference", 1
ROTATION_TOLERANCE = 1e-4  # of the rows' lengths and right angles


@dataclass(frozen=True, eq=False)
class Georeference:
    """longitude, latitude: degrees of WGS 84 of the world's origin; height: its metres above the ellipsoid.

    enu_from_world: rotation whose rows are east, north and up in the world. scale: metres of one unit of the world.
    """

    longitude: float
    latitude: float
    height: float
    enu_from_world: Matrix3
    scale: float

    def positions(self, points: Points) -> Points:
        """Return the longitude and latitude in degrees and height in metres of points of the world."""
        offsets = self.scale * points @ self.enu_from_world.T
        return geodetic((self.longitude, self.latitude, self.height), offsets)


def read_georeference(*folders: AnyPath | None) -> Georeference | None:
    """Return the georeference of the first folder that has one, None where none has.

    Raises: FormatError: damaged, no rotation, a place that is not on the Earth.
    """
    paths = (Path(folder) / NAME for folder in folders if folder is not None)
    return next((_read(path) for path in paths if path.is_file()), None)


def write_georeference(folder: Path, georeference: Georeference) -> None:
    """Write a folder's georeference.json anew. Raises: InputError: it cannot be written."""
    values = asdict(georeference)
    rotation = values.pop("enu_from_world").tolist()
    document = {"format": FORMAT, "version": VERSION, **values, "enu_from_world": rotation}
    write_json(folder / NAME, document, overwrite=True, end="")


def _read(path: Path) -> Georeference:
    document = as_document(read_json(path), str(path), FORMAT, VERSION)
    place: Georeference = as_kind(document, Georeference, str(path))
    rotation = place.enu_from_world
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not square or np.linalg.det(rotation) < 0:
        raise FormatError(f"{path}: enu_from_world: expected a rotation, rows east, north and up")
    if abs(place.longitude) > 180 or abs(place.latitude) > 90 or not 1e-9 <= place.scale <= 1e9:
        raise FormatError(f"{path}: expected degrees of the Earth, and a scale above 0 in metres per unit")
    if abs(place.height) > 1e7:
        raise FormatError(f"{path}: height: expected metres above the ellipsoid, got {place.height:g}")
    return place
