"""A room -> photos, instance ids, depth and poses."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from drsplat import View
from drsplat.base.arrays import MaskIds, PixelNumbers, Pixels

from . import engine
from .rooms import Room


@dataclass(frozen=True, eq=False)
class Shot:
    """ids: the object, or the number of objects + the structure, that the ray through the middle of
    the pixel meets first, -1 for the sky. depth: along z in metres, 0 for the sky."""

    view: View
    image: Pixels
    ids: MaskIds
    depth: PixelNumbers


def built(room: Room) -> Any:
    """The room as a Mitsuba scene; its shapes are called ID:PART."""
    shapes: dict[str, Any] = {}
    for k, pieces in groupby(room.pieces(), itemgetter(0)):
        for m, (_, look, mesh) in enumerate(pieces):
            shapes[f"s{k}:{m}"] = engine.shape(mesh, look, f"s{k}:{m}")
    return engine.scene(shapes, _lights(room))


def _lights(room: Room) -> dict[str, Any]:
    warm = np.array([1 + room.light["warm"], 1.0, 1 - room.light["warm"]])
    day = np.array([0.97, 1.0, 1.05]) * room.light["window"]
    even = (room.light["sky"] * warm).tolist()
    return {"sky": engine.even_sky(even), "window": engine.panel(*room.window, day.tolist())}


def shoot(room: Room, views: list[View], spp: int, seed: int) -> Iterator[Shot]:
    """One shot per view, all with the same exposure."""
    world = built(room)
    exposure = _exposure(world, views)
    window = len(room.objects) + [s.name for s in room.structures].index("window")
    for k, view in enumerate(views):
        light = engine.radiance(world, engine.sensor(view, spp), seed + k)
        image = np.rint(255 * engine.srgb(light * exposure)).astype(np.uint8)
        ids, depth = engine.first_hits(world, [view], lambda name: _index(name, window))
        yield Shot(view, image, ids[0], depth[0])


def _index(name: str, window: int) -> int:
    return int(name[1:].split(":")[0]) if ":" in name else window  # the pane itself has no number


def _exposure(world: Any, views: list[View]) -> float:
    """That makes the median of four small pictures a middling grey (linear)."""
    few = [views[k].resized(64, 48) for k in np.linspace(0, len(views) - 1, 4).astype(int)]
    levels = [engine.radiance(world, engine.sensor(view, 16), 0).mean(2) for view in few]
    return float(0.25 / np.median(np.stack(levels)))
