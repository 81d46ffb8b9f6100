"""Objects of a scene as arrays of a catalogue, and a picture of a catalogue's answer."""

import io
import json
from collections.abc import Sequence, Sized
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from PIL import Image

from ...base.arrays import Arrays, Embeddings, Float32, OtherPixels
from ...drawing.cards import Card, card_sheet
from ...errors import InputError
from ...field.codes import Track
from ...formats.georeference import Georeference
from ...formats.tiles import TILES, read_tiles
from .. import Match, Scene
from ..objects import objects_of, support_of
from ..sheets import object_picture, object_views
from ..sketch import sketch_of
from .entries import Entry, SceneEntry
from .snapshot import Record

UNTILED = 0
SIZE = (240, 180)
MAX_BYTES = 16 << 10
QUALITIES = (85, 70, 50, 30, 15)
LARGEST = 127  # of a descriptor's numbers, as it is stored
Picture = tuple[bytes, str]


class Kept(NamedTuple):
    """An object as a catalogue keeps it. thumbnail: b"" for none."""

    match: Match
    descriptors: Float32[np.ndarray, "_ D"]
    record: Record
    thumbnail: bytes


def rows_of(
    scene: Scene, name: str, folder: str, georeference: Georeference | None, track: Track
) -> tuple[SceneEntry, Arrays]:
    """Return what a catalogue keeps of a scene: its entry, and all of its objects as arrays (`snapshot.ROWS`).

    Raises: InputError: objects were not searched for. FormatError: damaged files.
    """
    objects, matches = objects_of(scene.field), scene.objects
    pictures = _pictures(scene, matches, track)
    details = zip(matches, _tiles(scene, matches), scene.object_names(), pictures, strict=True)
    described = [objects.descriptors_of(node) for node in objects.things.tolist()]
    kept = [
        Kept(match, vectors, _record(scene, match, tile, word, picture), picture[0])
        for vectors, (match, tile, word, picture) in zip(described, details, strict=True)
    ]
    added = datetime.now(UTC).replace(microsecond=0)
    agreed = int(scene.agreed.sum())
    entry = SceneEntry(name, len(kept), agreed, added, scene.field.fingerprint, folder, "current")
    return entry, scene_arrays(kept, scene.field.encoder.dim, sketch_of(scene).to_bytes(), georeference)


def scene_arrays(kept: Sequence[Kept], dim: int, sketch: bytes, georeference: Georeference | None = None) -> Arrays:
    """Return the arrays of the objects of one scene. dim: of descriptors.

    Raises: InputError: a descriptor without a direction.
    """
    count, lines = len(kept), [json.dumps(one.record._asdict()).encode() for one in kept]
    centers = np.array([one.match.center for one in kept], np.float64).reshape(count, 3)
    positions = np.full((count, 3), np.nan)
    if georeference is not None and count:
        positions = georeference.positions(centers)
    descriptors = [one.descriptors for one in kept]
    return {
        "centers": centers,
        "positions": positions,
        "extents": np.array([one.match.extent for one in kept], np.float32).reshape(count, 3),
        "axes": np.array([one.match.axes for one in kept], np.float32).reshape(count, 3, 3),
        "descriptors": _stored(np.concatenate([np.empty((0, dim), np.float32), *descriptors], dtype=np.float32)),
        "descriptor_counts": _lengths(descriptors),
        **_bytes("records", "record_bytes", lines),
        **_bytes("thumbnails", "thumbnail_bytes", [one.thumbnail for one in kept]),
        **_bytes("sketches", "sketch_bytes", [sketch]),
    }


def _bytes(name: str, lengths: str, parts: Sequence[bytes]) -> Arrays:
    return {name: np.frombuffer(b"".join(parts), np.uint8), lengths: _lengths(parts)}


def _lengths(parts: Sequence[Sized]) -> np.ndarray:
    return np.array([len(part) for part in parts], np.uint32)


def _stored(vectors: Embeddings) -> np.ndarray:
    """Return directions in a byte for each number, the largest of a vector 127: their lengths need no room.

    Raises: InputError: numbers that are not finite, or a vector without a direction.
    """
    largest = np.abs(vectors).max(1, initial=0, keepdims=True)
    if not (np.isfinite(largest) & (largest > 0)).all():
        raise InputError("descriptors: expected finite vectors, none of them zero")
    return np.asarray(np.rint(vectors * (LARGEST / largest)), np.int8)


def _record(scene: Scene, match: Match, tile: int, word: str | None, picture: Picture) -> Record:
    assert match.object_id is not None
    objects = objects_of(scene.field)
    node, photo = objects.thing(match.object_id), picture[1]
    masks = (mask for mask in support_of(scene.field, node) if photo in ("", mask.view_name))
    best = next(masks, None)  # the photo's mask of the largest share; without a photo that of any
    return Record(
        tile, len(match), int(objects.num_views[node]), match.score, match.label, word,
        (photo or None) if best is None else best.view_name, None if best is None else best.mask_id,
    )  # fmt: skip


def _tiles(scene: Scene, matches: Sequence[Match]) -> list[int]:
    """Return the number of the tile with most Gaussians of each match, if the scene has tiles."""
    if scene.path is None or not (scene.path / TILES).is_file():
        return [UNTILED] * len(matches)
    firsts = np.array([tile.first for tile in read_tiles(scene.path).tiles])
    tiles_of_match = (np.searchsorted(firsts, match.gaussian_ids, side="right") - 1 for match in matches)
    return [int(np.bincount(tiles).argmax()) for tiles in tiles_of_match]


def _pictures(scene: Scene, matches: Sequence[Match], track: Track) -> list[Picture]:
    """Return the thumbnail and photo of each match; none without photos or Gaussians."""
    if not scene.has_gaussians or not scene.views:
        return [(b"", "")] * len(matches)
    views = object_views(scene, matches)
    pairs = track(list(zip(matches, views, strict=True)), "drawing objects")
    return [(thumbnail(object_picture(scene, match, view, SIZE)), view.name) for match, view in pairs]


def thumbnail(pixels: OtherPixels) -> bytes:
    """Return a JPEG of at most MAX_BYTES, of the best quality that fits; the size is halved until one does."""
    picture = Image.fromarray(pixels)
    while True:
        for quality in QUALITIES:
            file = io.BytesIO()
            picture.save(file, "JPEG", quality=quality, optimize=True)
            data = file.getvalue()
            if len(data) <= MAX_BYTES:
                return data
        picture = picture.resize((max(picture.width // 2, 1), max(picture.height // 2, 1)))


COLUMNS, MAX_CARDS = 5, 60
GREY = 214  # of an object without a thumbnail


def entry_sheet(entries: Sequence[Entry], heading: str) -> OtherPixels:
    """Draw a card for each of the first 60 entries. Raises: InputError: none. FormatError: a damaged thumbnail."""
    if not entries:
        raise InputError("there is nothing to draw: no object answers this query")
    cards = [
        Card(_tile(entry), entry.title, (f"in {entry.scene}", f"score {entry.score:.2f} · {entry.photo or 'no photo'}"))
        for entry in entries[:MAX_CARDS]
    ]
    return card_sheet(cards, COLUMNS, heading, "Best first.")


def _tile(entry: Entry) -> OtherPixels:
    if entry.thumbnail is None:
        return np.full((SIZE[1], SIZE[0], 3), GREY, np.uint8)
    return np.asarray(Image.fromarray(entry.picture()).resize(SIZE))
