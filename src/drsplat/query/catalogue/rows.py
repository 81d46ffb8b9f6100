"""Objects of a scene as columns of the table.

Picture of a catalogue's answer.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from PIL import Image

from ...base.arrays import OtherPixels
from ...drawing.cards import Card, card_sheet
from ...errors import InputError
from ...field import LanguageField
from ...field.codes import Track
from ...formats.georeference import Georeference
from ...formats.tiles import TILES, read_tiles
from .. import Match, Scene
from ..objects import objects_of, support_of
from ..sheets import object_picture, object_views
from ..sketch import sketch_of
from .entries import Entry, Position

UNTILED = 0
SIZE = (240, 180)
MAX_BYTES = 16 << 10
QUALITIES = (85, 70, 50, 30, 15)


@dataclass(frozen=True, eq=False)
class SceneRows:
    """Rows of one scene. columns: by name, of one length; descriptors: of each row (k, D) float32.

    pictured: number with a thumbnail.
    """

    columns: dict[str, list[Any]]
    descriptors: list[np.ndarray]
    pictured: int

    def __len__(self) -> int:
        """Return the number of objects; the last row is the scene's own."""
        return len(self.descriptors) - 1


def rows_of(
    scene: Scene, name: str, folder: str, added: datetime, georeference: Georeference | None, track: Track
) -> SceneRows:
    """Return all objects of a scene, and the scene's own row, which has no object.

    Raises: InputError: objects were not searched for. FormatError: damaged files.
    """
    objects, matches = objects_of(scene.field), scene.objects
    pictures = _pictures(scene, matches, track)
    positions = _positions(matches, georeference)
    words = scene.object_names()
    rows = [
        {"tile": tile} | _row(scene.field, match, position, word, picture)
        for match, tile, position, word, picture in zip(
            matches, _tiles(scene, matches), positions, words, pictures, strict=True
        )
    ]
    common = {"scene": name, "field": scene.field.fingerprint, "added": added}
    own = {"tile": UNTILED, "object_id": -1, "folder": folder, "sketch": sketch_of(scene).to_bytes()}
    rows = [common | row for row in [*rows, own]]
    descriptors = [objects.descriptors_of(node) for node in objects.things.tolist()]
    descriptors.append(np.empty((0, scene.field.encoder.dim), np.float32))
    columns = {key: [row.get(key) for row in rows] for key in dict.fromkeys(key for row in rows for key in row)}
    return SceneRows(columns, descriptors, sum(picture[0] is not None for picture in pictures))


def _row(
    field: LanguageField, match: Match, position: Position | None, word: str | None, picture: tuple[bytes | None, str]
) -> dict[str, Any]:
    if match.object_id is None:
        raise InputError("a catalogue keeps objects, and this match is none")
    node = objects_of(field).thing(match.object_id)
    photo, mask = _best_mask(field, node, picture[1])
    x, y, z = match.center.tolist()
    return {
        "object_id": match.object_id,
        "x": x,
        "y": y,
        "z": z,
        "axes": match.axes.ravel().tolist(),
        "extent": match.extent.tolist(),
        **({} if position is None else position._asdict()),
        "num_gaussians": len(match),
        "num_views": int(objects_of(field).num_views[node]),
        "sure": match.score,
        "label": match.label,
        "name": word,
        "photo": photo,
        "mask": mask,
        "thumbnail": picture[0],
    }


def _tiles(scene: Scene, matches: Sequence[Match]) -> list[int]:
    """Return the number of the tile with most Gaussians of each match, if the scene has tiles."""
    if scene.path is None or not (scene.path / TILES).is_file():
        return [UNTILED] * len(matches)
    firsts = np.array([tile.first for tile in read_tiles(scene.path).tiles])
    tiles_of_match = (np.searchsorted(firsts, match.gaussian_ids, side="right") - 1 for match in matches)
    return [int(np.bincount(tiles).argmax()) for tiles in tiles_of_match]


def _best_mask(field: LanguageField, node: int, photo: str) -> tuple[str | None, int | None]:
    """Return a photo and the node's mask of the largest share in it; for photo "", the largest share anywhere."""
    for mask in support_of(field, node):
        if photo in ("", mask.view_name):
            return mask.view_name, mask.mask_id
    return photo or None, None


def _pictures(scene: Scene, matches: Sequence[Match], track: Track) -> list[tuple[bytes | None, str]]:
    """Return the thumbnail and photo of each match; none without photos or Gaussians."""
    if not scene.has_gaussians or not scene.views:
        return [(None, "")] * len(matches)
    views = object_views(scene, matches)
    pairs = track(list(zip(matches, views, strict=True)), "drawing objects")
    return [(thumbnail(object_picture(scene, match, view, SIZE)), view.name) for match, view in pairs]


def _positions(matches: Sequence[Match], georeference: Georeference | None) -> list[Position | None]:
    if georeference is None or not matches:
        return [None] * len(matches)
    positions = georeference.positions(np.stack([match.center for match in matches]))
    return [Position(*row) for row in positions.tolist()]


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
