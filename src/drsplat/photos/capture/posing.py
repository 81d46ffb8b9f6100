"""COLMAP's models of photos: features, pairs, matches, poses. Finished steps are kept and not repeated."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Float64
from ...formats.replacing import replacing
from ...scene.geodesy import geocentric
from . import database as colmap_database
from . import pairs as pairing
from .finding import are_numbered
from .looks import looks_of
from .photos import Photo, mask_path
from .program import ColmapFailure, ask_colmap
from .settings import LENSES
from .turning import MIN_MATCHES, check_moved
from .work import Work

FEATURES_SIDE_PIXELS = 1200  # longer side of photos for finding features
DEFAULT_FOCAL_SHARE = 1.2 * 0.8  # of the diagonal: COLMAP's guess, 1.2 times the longer side of a photo of 4:3
FISHEYE_FOCAL_SHARE = 0.35  # of the diagonal: some 160 degrees from corner to corner
MAX_CHECKED_PAIRS = 100  # whether the camera moved
MIN_POSED_SHARE = 0.95  # of overlapping photos: if global mapping poses fewer, incremental mapping is tried
_TWO_FOCAL = ("OPENCV", "OPENCV_FISHEYE")

Progress = Callable[[str, int, int], None]
"""Function that is called with a stage, the number of finished steps and their total."""


@dataclass(frozen=True)
class Model:
    """Model that COLMAP made. files: its photos'. depth: median depth of its points in the cameras that saw them."""

    folder: Path
    mapper: str
    files: tuple[str, ...]
    num_points: int
    error_px: float
    depth: float


@dataclass(frozen=True)
class Posed:
    """Result of posing. models: largest first. features: number by file. pairs: verified matches by pair of files."""

    models: list[Model]
    features: dict[str, int]
    pairs: dict[tuple[str, str], int]


@dataclass(frozen=True)
class Posing:
    """Posing of distinct photos. lens: of `LENSES`. threads: 0 for all."""

    work: Work
    photos: Sequence[Photo]
    lens: str
    threads: int
    progress: Progress

    def run(self) -> Posed:
        """Pose the photos. Raises: InputError: the camera only turned, a full disk. ColmapFailure: COLMAP failed."""
        self._extract()
        with colmap_database.reading(self._database) as database:
            features = colmap_database.num_features(database)
            chosen = self._pairs(database, features)
        self._match(chosen)
        with colmap_database.reading(self._database) as database:
            pairs = colmap_database.verified_pairs(database)
            files = {photo.file for photo in self.photos}
            pairs = {pair: count for pair, count in pairs.items() if set(pair) <= files}
            self._check_moved(database, pairs)
        return Posed(self._map(pairs), features, pairs)

    @property
    def _database(self) -> Path:
        return self.work.folder / f"{self.lens}.db"

    def _ask(self, task: str, **request: Any) -> Any:
        return ask_colmap(
            task, self.work.log, database=str(self._database), images=str(self.work.photos),
            threads=self.threads or -1, **request,
        )  # fmt: skip

    def _extract(self) -> None:
        ids = self._camera_ids()
        groups: dict[tuple[int, str | None], list[str]] = {}
        for photo in self.photos:
            masked = mask_path(self.work.photos, photo.file).is_file()
            key = ids[camera_key(photo)], str(self.work.masks) if masked else None
            groups.setdefault(key, []).append(photo.file)
        listed = [{"camera_id": key[0], "masks": key[1], "names": names} for key, names in groups.items()]
        self._ask(
            "extract", groups=listed, max_side=FEATURES_SIDE_PIXELS,
            report=lambda done: self.progress("features", done, len(self.photos)),
        )  # fmt: skip

    def _camera_ids(self) -> dict[str, int]:
        """Return the database's camera of each group of photos; new ones are added."""
        document = f"{self.lens}.json"
        ids: dict[str, int] = self.work.remembered(document) or {}
        if not ids:
            self._database.unlink(missing_ok=True)
        new = {camera_key(photo): photo for photo in self.photos if camera_key(photo) not in ids}
        if new:
            cameras = [camera_of(photo, self.lens) for photo in new.values()]
            ids |= dict(zip(new, self._ask("add_cameras", cameras=cameras), strict=True))
            self.work.remember(document, ids)
        return ids

    def _pairs(self, database: Any, features: dict[str, int]) -> list[tuple[str, str]]:
        """Return the pairs of files to match, in order."""
        photos = [photo for photo in self.photos if photo.file in features]
        numbered = are_numbered([photo.name for photo in photos])
        if len(photos) <= (pairing.MAX_EXHAUSTIVE_NUMBERED_PHOTOS if numbered else pairing.MAX_EXHAUSTIVE_PHOTOS):
            pairs = pairing.all_pairs(len(photos))
        else:
            looks = looks_of(
                [photo.file for photo in photos], lambda file: colmap_database.descriptors_of(database, file)
            )
            alike = pairing.NUMBERED_NEIGHBOURS_IN_LOOKS if numbered else pairing.NEIGHBOURS_IN_LOOKS
            pairs = pairing.pairs_in_looks(looks, alike) | pairing.pairs_in_place(places_of(photos))
            if numbered:
                pairs |= pairing.pairs_in_order(len(photos))
        return [(photos[i].file, photos[j].file) for i, j in sorted(pairs)]

    def _match(self, pairs: list[tuple[str, str]]) -> None:
        path = self.work.folder / "pairs.txt"
        with replacing(path, overwrite=True) as file:
            file.write("".join(f"{first} {second}\n" for first, second in pairs).encode())
        self._ask(
            "match", pairs=str(path), batch=str(self.work.folder / "batch.txt"),
            report=lambda done: self.progress("pairs", done, len(pairs)),
        )  # fmt: skip

    def _check_moved(self, database: Any, pairs: dict[tuple[str, str], int]) -> None:
        """Check a sample of pairs; files are named after their contents, so their order is as good as random."""
        photos = {photo.file: photo for photo in self.photos}
        many = sorted(pair for pair, count in pairs.items() if count >= MIN_MATCHES)
        sample = []
        for pair in many[:: len(many) // MAX_CHECKED_PAIRS + 1]:
            sizes = np.array([[[photos[file].width, photos[file].height]] for file in pair])
            diagonals = np.linalg.norm(sizes, axis=2, keepdims=True)
            focals = np.array([[[camera_of(photos[file], self.lens)["params"][0]]] for file in pair])
            pixels = colmap_database.matched_pixels(database, pair)
            sample.append(((pixels - sizes / 2) / diagonals, focals / diagonals))
        check_moved(sample, self.lens != "fisheye" and all(photo.exif.focal_share for photo in self.photos))

    def _map(self, pairs: dict[tuple[str, str], int]) -> list[Model]:
        most = len(_largest_group(pairs))
        if not most:
            return []
        models = self._mapped("global", "map_globally", pairs)
        if not models or len(models[0].files) < MIN_POSED_SHARE * most:
            models = max(
                models, self._mapped("incremental", "map_incrementally", pairs),
                key=lambda each: len(each[0].files) if each else 0,
            )  # fmt: skip
        return models

    def _mapped(self, mapper: str, task: str, pairs: dict[tuple[str, str], int]) -> list[Model]:
        """Return the models of a mapper, the largest first, or those of an earlier run on the same matches."""
        files = sorted(photo.file for photo in self.photos)
        key = hashlib.blake2b(repr((files, sorted(pairs.items()))).encode(), digest_size=8).hexdigest()
        name = f"{self.lens}_{mapper}_{key}"
        described = self.work.remembered(f"{name}.json")
        folder = self.work.folder / name
        if described is None:
            self.progress(f"poses ({mapper})", 0, len(files))
            folder.mkdir(exist_ok=True)
            try:
                described = self._ask(
                    task, output=str(folder), names=files,
                    report=lambda done: self.progress(f"poses ({mapper})", min(done, len(files)), len(files)),
                )  # fmt: skip
            except ColmapFailure:
                described = []
            self.work.remember(f"{name}.json", described)
        models = [
            Model(
                folder / entry["folder"],
                mapper,
                tuple(entry["names"]),
                entry["num_points"],
                entry["error_px"],
                entry["depth"],
            )
            for entry in described
        ]
        return sorted(models, key=lambda model: -len(model.files))


def camera_key(photo: Photo) -> str:
    """Return a text that is the same for photos with the same camera, lens and raster, which share intrinsics."""
    return f"{photo.exif.camera} {photo.exif.focal_share or 0:.3f} {photo.width}x{photo.height}"


def camera_of(photo: Photo, lens: str) -> dict[str, Any]:
    """Return COLMAP's camera of a photo, to be refined: the focal length of its EXIF, else a guess."""
    model, terms = LENSES[lens]
    share = None if lens == "fisheye" else photo.exif.focal_share  # EXIF's is of another projection
    focal = (share or (FISHEYE_FOCAL_SHARE if lens == "fisheye" else DEFAULT_FOCAL_SHARE)) * float(
        np.hypot(photo.width, photo.height)
    )
    focals = [focal, focal] if model in _TWO_FOCAL else [focal]
    return {
        "model": model, "width": photo.width, "height": photo.height,
        "params": [*focals, photo.width / 2, photo.height / 2, *[0.0] * terms],
        "has_prior_focal_length": share is not None or lens == "fisheye",  # without it COLMAP assumes straight lines
    }  # fmt: skip


def places_of(photos: Sequence[Photo]) -> Float64[np.ndarray, "n 3"]:
    """Return positions of photos in metres from the centre of the Earth; rows of NaN where they have none."""
    nowhere = (np.nan, np.nan, np.nan)
    positions = [photo.exif.position or nowhere for photo in photos]
    return geocentric(np.array([(x, y, 0.0 if z is None else z) for x, y, z in positions], np.float64).reshape(-1, 3))


def _largest_group(pairs: dict[tuple[str, str], int]) -> set[str]:
    """Return the files of the largest group connected by overlaps; none without any overlap."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    files = sorted({file for pair in pairs for file in pair})
    if not files:
        return set()
    index = {file: k for k, file in enumerate(files)}
    rows, columns = np.array([[index[first], index[second]] for first, second in pairs]).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(files), len(files)))
    _, labels = connected_components(graph, directed=False)
    largest = np.bincount(labels).argmax()
    return {file for file, label in zip(files, labels, strict=True) if label == largest}
