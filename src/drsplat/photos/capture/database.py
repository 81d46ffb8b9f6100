"""Contents of COLMAP's database, read without COLMAP.

Source: https://colmap.github.io/database.html
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ...base.arrays import Float32, Float64
from ...errors import FormatError

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


def num_features(database: sqlite3.Connection) -> dict[str, int]:
    """Return the number of features of each processed photo, by its name."""
    query = "SELECT name, rows FROM images JOIN keypoints USING (image_id) JOIN descriptors USING (image_id, rows)"
    return dict(database.execute(query))


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


def descriptors_of(database: sqlite3.Connection, name: str) -> Float32[np.ndarray, "n 128"]:
    """Return the SIFT descriptors of a photo, of unit length."""
    query = "SELECT rows, cols, data FROM descriptors JOIN images USING (image_id) WHERE name = ?"
    rows, columns, data = database.execute(query, (name,)).fetchone() or (0, 128, b"")
    values = np.frombuffer(data, np.uint8).reshape(rows, columns).astype(np.float32)
    return np.asarray(values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-9))
