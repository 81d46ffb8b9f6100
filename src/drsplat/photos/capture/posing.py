"""COLMAP's models of photos: features, pairs, matches, poses. Finished steps are kept and not repeated.

The pairs to match are, of few photos, all whose largest features match; of many, neighbours in order, place and looks,
whose number grows with that of the photos. The look of a photo is its SIFT descriptors relative to the words of a small
vocabulary that is trained on the photos themselves.
Source: Jegou et al., Aggregating local descriptors into a compact image representation, CVPR 2010 (VLAD), with the
intra-normalisation of Arandjelovic and Zisserman, All about VLAD, CVPR 2013.

Contents of COLMAP's database, read without COLMAP.

Source: https://colmap.github.io/database.html
"""

import hashlib
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from ...base.arrays import Embedding, Embeddings, Float32, Float64, OtherEmbeddings, Points, UInt8
from ...errors import FormatError
from ...scene.geodesy import geocentric
from .finding import are_numbered
from .photos import Photo, mask_path
from .program import ColmapFailure, ask_colmap
from .settings import LENSES
from .turning import MIN_MATCHES, check_moved
from .work import Work

Descriptors = UInt8[np.ndarray, "n 128"]
UnitDescriptors = Float32[np.ndarray, "n 128"]
PAIR_BASE = 2147483647  # pair id = PAIR_BASE * (smaller image id) + larger image id


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database to read it. Raises: FormatError: it is damaged, or there is none."""
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as database:
            yield database
    except sqlite3.Error as error:
        raise FormatError(
            f"COLMAP's database in {path.parent} is damaged ({error}): remove that folder, and start anew"
        ) from error


def verified_pairs(database: sqlite3.Connection) -> dict[tuple[str, str], int]:
    """Return the number of verified matches of each pair of names that has some."""
    names = dict(database.execute("SELECT image_id, name FROM images"))
    rows = database.execute("SELECT pair_id, rows FROM two_view_geometries WHERE rows > 0")
    return {(names[pair // PAIR_BASE], names[pair % PAIR_BASE]): count for pair, count in rows}


def matched_pixels(database: sqlite3.Connection, pair: tuple[str, str]) -> Float64[np.ndarray, "2 n 2"]:
    """Return the pixels of the verified matches of a pair of `verified_pairs`, in its first and second photo."""
    query = "SELECT image_id, rows, data FROM images JOIN keypoints USING (image_id) WHERE name = ?"
    (first, *ours), (second, *theirs) = (database.execute(query, (name,)).fetchone() for name in pair)
    query = "SELECT data FROM two_view_geometries WHERE pair_id = ?"
    matches = np.frombuffer(database.execute(query, (PAIR_BASE * first + second,)).fetchone()[0], np.uint32)
    pixels = [np.frombuffer(data, np.float32).reshape(rows, -1)[:, :2] for rows, data in (ours, theirs)]
    return np.stack([pixels[k][matches[k::2]] for k in (0, 1)]).astype(np.float64)


def descriptors_of(database: sqlite3.Connection, name: str) -> Descriptors:
    """Return the SIFT descriptors of a photo, of length 512, those of the smallest features first."""
    query = "SELECT rows, cols, data FROM descriptors JOIN images USING (image_id) WHERE name = ?"
    rows, columns, data = database.execute(query, (name,)).fetchone() or (0, 128, b"")
    return np.frombuffer(data or b"", np.uint8).reshape(rows, columns)  # of a photo without features: NULL


FEATURES_SIDE_PIXELS = 1200  # longer side of photos for finding features
DEFAULT_FOCAL_SHARE = 1.2 * 0.8  # of the diagonal: COLMAP's guess, 1.2 times the longer side of a photo of 4:3
FISHEYE_FOCAL_SHARE = 0.35  # of the diagonal: some 160 degrees from corner to corner
MAX_CHECKED_PAIRS = 100  # whether the camera moved
MIN_POSED_SHARE = 0.95  # of overlapping photos: if global mapping poses fewer, incremental mapping is tried
_TWO_FOCAL = ("OPENCV", "OPENCV_FISHEYE")

Progress = Callable[[str, int, int], None]
"""Function that is called with a stage, the number of finished steps and their total."""
NUM_WORDS, KMEANS_STEPS = 32, 12
MAX_TRAINING_DESCRIPTORS = 40_000  # of the vocabulary
MAX_DESCRIPTORS = 2_000  # of a photo

MAX_EXHAUSTIVE_PHOTOS = 150  # 11,175 pairs
MAX_EXHAUSTIVE_NUMBERED_PHOTOS = 40  # their order says which overlap
NEIGHBOURS_IN_ORDER = 12
NEIGHBOURS_IN_PLACE = 24
NEIGHBOURS_IN_LOOKS = 20
NUMBERED_NEIGHBOURS_IN_LOOKS = 8  # for loops
_BLOCK_ROWS = 512
MAX_COMPARED_FEATURES = 512  # of a photo, its largest
MIN_LARGE_MATCHES = 12  # of them, for a pair to be worth all its features
BEST_LARGE_MATCHES = 10  # pairs of a photo that are matched however few match
SQUARED_LENGTH = np.float32(512**2)  # of stored descriptors
MAX_RATIO = np.float32(0.8**2)  # of squared distances: Lowe's test


class Model(NamedTuple):
    """Model that COLMAP made. files: its photos'. depth: median depth of its points in the cameras that saw them."""

    folder: Path
    mapper: str
    files: list[str]
    num_points: int
    error_px: float
    depth: float


class Posed(NamedTuple):
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
        with reading(self._database) as database:
            # the number of features of each processed photo, by its name
            query = (
                "SELECT name, rows FROM images JOIN keypoints USING (image_id) JOIN descriptors USING (image_id, rows)"
            )
            features = dict(database.execute(query))
            chosen = self._pairs(database, features)
        self._ask(
            "match", pairs=chosen, batch=str(self.work.folder / "batch.txt"),
            report=lambda done: self.progress("pairs", done, len(chosen)),
        )  # fmt: skip
        with reading(self._database) as database:
            pairs = verified_pairs(database)
            # check a sample of pairs; files are named after their contents, so their order is as good as random
            photos = {photo.file: photo for photo in self.photos}
            pairs = {pair: count for pair, count in pairs.items() if photos.keys() >= set(pair)}
            many = sorted(pair for pair, count in pairs.items() if count >= MIN_MATCHES)
            sample = []
            for pair in many[:: len(many) // MAX_CHECKED_PAIRS + 1]:
                sizes = np.array([[[photos[file].width, photos[file].height]] for file in pair])
                diagonals = np.linalg.norm(sizes, axis=2, keepdims=True)
                focals = np.array([[[camera_of(photos[file], self.lens)["params"][0]]] for file in pair])
                pixels = matched_pixels(database, pair)
                sample.append(((pixels - sizes / 2) / diagonals, focals / diagonals))
            check_moved(sample, self.lens != "fisheye" and all(photo.exif.focal_share for photo in self.photos))
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
        # the database's camera of each group of photos; new ones are added
        document = f"{self.lens}.json"
        ids: dict[str, int] = self.work.remembered(document) or {}
        if not ids:
            self._database.unlink(missing_ok=True)
        new = {camera_key(photo): photo for photo in self.photos if camera_key(photo) not in ids}
        if new:
            cameras = [camera_of(photo, self.lens) for photo in new.values()]
            ids |= dict(zip(new, self._ask("add_cameras", cameras=cameras), strict=True))
            self.work.remember(document, ids)
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

    def _pairs(self, database: Any, features: dict[str, int]) -> list[tuple[str, str]]:
        """Return the pairs of files to match, in order."""
        photos = [photo for photo in self.photos if photo.file in features]
        numbered = are_numbered([photo.name for photo in photos])
        if len(photos) <= (MAX_EXHAUSTIVE_NUMBERED_PHOTOS if numbered else MAX_EXHAUSTIVE_PHOTOS):
            pairs = pairs_in_large_features([descriptors_of(database, photo.file) for photo in photos])
        else:
            looks = looks_of([photo.file for photo in photos], lambda file: descriptors_of(database, file))
            alike = NUMBERED_NEIGHBOURS_IN_LOOKS if numbered else NEIGHBOURS_IN_LOOKS
            places = [photo.exif.position or (np.nan, np.nan, np.nan) for photo in photos]
            positions = geocentric(np.array([(x, y, z or 0.0) for x, y, z in places], np.float64).reshape(-1, 3))
            pairs = pairs_in_looks(looks, alike) | pairs_in_place(positions)
            if numbered:
                pairs |= pairs_in_order(len(photos))
        return [(photos[i].file, photos[j].file) for i, j in sorted(pairs)]

    def _map(self, pairs: dict[tuple[str, str], int]) -> list[Model]:
        most = _largest_group(pairs)
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
        models = [Model(mapper=mapper, **each | {"folder": folder / each["folder"]}) for each in described]
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


def _largest_group(pairs: dict[tuple[str, str], int]) -> int:
    """Return the number of files of the largest group connected by overlaps; 0 without any overlap."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not pairs:
        return 0
    files, ends = np.unique(list(pairs), return_inverse=True)
    graph = coo_array((np.ones(len(pairs)), ends.reshape(-1, 2).T), shape=(len(files), len(files)))
    return int(np.bincount(connected_components(graph, directed=False)[1]).max())


def looks_of(keys: Sequence[str], read: Callable[[str], Descriptors]) -> OtherEmbeddings:
    """Return a unit vector for each photo, zeros for one without descriptors; one photo is in memory at a time.

    read: returns the descriptors of a photo by its key.
    """
    each = max(1, MAX_TRAINING_DESCRIPTORS // max(len(keys), 1))
    step = max(1, len(keys) // MAX_TRAINING_DESCRIPTORS)
    sample = np.concatenate([_thinned(read(key), each) for key in keys[::step]] or [np.empty((0, 128), np.float32)])
    if len(sample) < 4 * NUM_WORDS:
        return np.zeros((len(keys), 1), np.float32)
    vocabulary = _vocabulary(sample)
    return np.stack([_look(_thinned(read(key), MAX_DESCRIPTORS), vocabulary) for key in keys])


def _vocabulary(sample: UnitDescriptors) -> Float32[np.ndarray, "w 128"]:
    """Return the centres of a k-means of descriptors."""
    centres = sample[np.random.default_rng(0).choice(len(sample), NUM_WORDS, replace=False)]
    for _ in range(KMEANS_STEPS):
        nearest = _nearest(sample, centres)
        for word in range(NUM_WORDS):
            if (nearest == word).any():
                centres[word] = sample[nearest == word].mean(0)
    return centres


def _look(descriptors: UnitDescriptors, vocabulary: Float32[np.ndarray, "w 128"]) -> Embedding:
    """Return the VLAD vector of a photo."""
    nearest = _nearest(descriptors, vocabulary)
    look = np.zeros_like(vocabulary)
    np.add.at(look, nearest, descriptors - vocabulary[nearest])
    look /= np.maximum(np.linalg.norm(look, axis=1, keepdims=True), 1e-9)
    flat = look.reshape(-1)
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-9), np.float32)


def _nearest(descriptors: UnitDescriptors, centres: Float32[np.ndarray, "w 128"]) -> np.ndarray:
    return ((centres**2).sum(1) - 2 * descriptors @ centres.T).argmin(1)


def _thinned(descriptors: Descriptors, most: int) -> UnitDescriptors:
    """Return at most `most` descriptors, evenly chosen, of unit length."""
    chosen = np.linspace(0, len(descriptors) - 1, min(most, len(descriptors))).astype(np.intp)
    values = descriptors[chosen].astype(np.float32)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-9)


def pairs_in_order(count: int) -> set[tuple[int, int]]:
    """Return pairs of photos that were taken soon after each other, and fewer pairs further apart."""
    steps = [*range(1, NEIGHBOURS_IN_ORDER + 1)]
    while steps[-1] * 2 < count:
        steps.append(steps[-1] * 2)
    return {(i, i + step) for step in steps for i in range(count - step)}


def pairs_in_place(positions: Points) -> set[tuple[int, int]]:
    """Return pairs of photos that were taken near each other; rows of NaN have no place."""
    from scipy.spatial import KDTree

    placed = np.flatnonzero(np.isfinite(positions).all(1))
    if len(placed) < 2:
        return set()
    count = min(NEIGHBOURS_IN_PLACE + 1, len(placed))
    _, near = KDTree(positions[placed]).query(positions[placed], k=count)
    return _ordered(placed.repeat(count), placed[near].reshape(-1))


def pairs_in_large_features(descriptors: Sequence[UInt8[np.ndarray, "_ 128"]]) -> set[tuple[int, int]]:
    """Return pairs of photos whose largest features match, and for each photo those where most do.

    Most pairs of a capture show nothing in common, and COLMAP spends most of its time on proving that. Dot products of
    descriptors are whole numbers below 2^24, so they are exact.

    descriptors: as `descriptors_of` returns them.
    """
    large = [rows[-MAX_COMPARED_FEATURES:].astype(np.float32) for rows in descriptors]
    counts = np.zeros((len(large), len(large)), np.int32)
    for i, ours in enumerate(large):
        if i == 0 or not len(ours):
            continue
        products = ours @ np.concatenate(large[:i]).T  # one product is quicker than many small ones
        parts = np.split(products, np.cumsum([len(rows) for rows in large[: i - 1]]), axis=1)
        counts[i, :i] = counts[:i, i] = [_mutual_matches(part) for part in parts]
    best = np.argsort(-counts, axis=1, kind="stable")[:, :BEST_LARGE_MATCHES]
    first, second = np.nonzero(counts >= MIN_LARGE_MATCHES)
    return _ordered(first, second) | _ordered(np.arange(len(large)).repeat(best.shape[1]), best.reshape(-1))


def _mutual_matches(products: Float32[np.ndarray, "n m"]) -> int:
    """Return how many rows and columns are each other's nearest, and by far. products: changes."""
    if not products.size:
        return 0
    rows, nearest = np.arange(len(products)), products.argmax(1)
    mutual = products.argmax(0)[nearest] == rows
    distances = SQUARED_LENGTH - products[rows, nearest]
    products[rows, nearest] = 0
    return int((mutual & (distances < MAX_RATIO * (SQUARED_LENGTH - products.max(1)))).sum())


def pairs_in_looks(looks: Embeddings, count: int = NEIGHBOURS_IN_LOOKS) -> set[tuple[int, int]]:
    """Return pairs of photos that look alike. looks: unit vectors; rows of zeros look like nothing."""
    count = min(count + 1, len(looks))
    pairs: set[tuple[int, int]] = set()
    for start in range(0, len(looks), _BLOCK_ROWS):
        alike = looks[start : start + _BLOCK_ROWS] @ looks.T
        best = np.argpartition(-alike, count - 1, axis=1)[:, :count]
        rows, columns = np.repeat(np.arange(len(alike)), count), best.reshape(-1)
        similar = alike[rows, columns] > 0
        pairs |= _ordered(start + rows[similar], columns[similar])
    return pairs


def _ordered(first: np.ndarray, second: np.ndarray) -> set[tuple[int, int]]:
    low, high = np.minimum(first, second), np.maximum(first, second)
    apart = low < high
    return set(zip(low[apart].tolist(), high[apart].tolist(), strict=True))
