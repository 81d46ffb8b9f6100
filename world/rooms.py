"""Rooms: furniture on the floor, things on floor, tables, seats and shelves, without overlap."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from drsplat.base.arrays import Vector3

from .looks import Look, Split, Wardrobe, color, plain, shaded, washed
from .meshes import Mesh, box, turn
from .thing import Ledge, Thing
from .things import CATALOGUE

Rng = np.random.Generator
WALL_HEIGHT = 2.6
MOST = 20  # things in a room
ON_TABLE = (
    "mug", "bowl", "plate", "bottle", "teapot", "spoon", "fork", "knife", "pot", "pan", "apple", "banana",
    "orange", "carrot", "pear", "bread", "book", "lamp", "vase", "candle", "clock",
    "laptop", "frame", "duck", "car", "carton",
)  # fmt: skip
ON_SHELF = (
    "book", "vase", "clock", "frame", "bear", "duck", "car", "teapot", "candle", "blocks", "bowl", "bottle", "ball",
)  # fmt: skip
ON_SEAT = ("cushion", "bear", "book")
ON_FLOOR = ("plant", "floor_lamp", "ball", "basket", "carton", "bear", "stool", "car", "blocks")


@dataclass(frozen=True, eq=False)
class Placed:
    """A thing in the room: turned by `degrees` about z, then moved to `position`."""

    thing: Thing
    position: tuple[float, float, float]
    degrees: float

    @property
    def center(self) -> Vector3:
        """Of its box, in the world."""
        low, high = self.thing.bounds
        return turn("z", self.degrees) @ ((low + high) / 2) + np.array(self.position)

    @property
    def footprint(self) -> Float64[np.ndarray, "4 2"]:
        """The corners of its box seen from above, in the world."""
        low, high = self.thing.bounds
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        return np.array(corners) @ turn("z", self.degrees)[:2, :2].T + self.position[:2]


@dataclass(frozen=True, eq=False)
class Structure:
    """A part of the room itself: floor, wall, window, rug."""

    name: str
    pieces: list[tuple[Look, Mesh]]


@dataclass(frozen=True, eq=False)
class Room:
    """x and y run from -size/2 to size/2, the floor is z = 0; the focus is what cameras go round.

    Instance ids: objects by their index, then structures.
    """

    size: tuple[float, float]
    focus: Vector3
    objects: list[Placed]
    structures: list[Structure]
    window: tuple[np.ndarray, np.ndarray, np.ndarray]
    light: dict[str, Any] = field(default_factory=dict)

    def pieces(self) -> Iterator[tuple[int, Look, Mesh]]:
        """All surfaces with the ids of their instances, in the order of the ids."""
        for k, placed in enumerate(self.objects):
            for part in placed.thing.parts:
                yield k, part.look, part.mesh.turned("z", placed.degrees).moved(*placed.position)
        for k, structure in enumerate(self.structures, len(self.objects)):
            for look, mesh in structure.pieces:
                yield k, look, mesh


def overlap(a: Float64[np.ndarray, "4 2"], b: Float64[np.ndarray, "4 2"], gap: float) -> bool:
    """Whether two rectangles are nearer than `gap` metres (by separating axes: at corners, a little
    farther counts too)."""
    for corners in (a, b):
        for edge in (corners[1] - corners[0], corners[3] - corners[0]):
            axis = edge / np.linalg.norm(edge)
            p, q = a @ axis, b @ axis
            if p.min() > q.max() + gap or q.min() > p.max() + gap:
                return False
    return True


def make_room(split: Split, seed: int) -> Room:
    """The room of a seed: a table in the middle, a sofa and a shelf at walls, and up to 20 things in all."""
    rng = split.rng(seed, 200)
    size = (float(rng.uniform(4.4, 5.2)), float(rng.uniform(4.2, 5.0)))
    objects: list[Placed] = []
    table = _table(split, rng)
    objects.append(table)
    walls = rng.permutation(4)
    for wall, kind in zip(walls, ("sofa", "shelf"), strict=False):
        _at_wall(objects, CATALOGUE[kind](rng, split), int(wall), size, rng)
    if table.thing.size[2] > 0.6:
        _chairs(objects, table, split, rng)
    hosts = list(objects)
    _on_floor(objects, split, rng, size)
    _on_ledges(objects, hosts, split, rng)
    structures, window = _shell(split, rng, size, int(walls[2]))
    focus = np.array([table.position[0], table.position[1], table.thing.size[2] + 0.05])
    light = {"sky": rng.uniform(0.5, 0.7), "window": rng.uniform(8, 12), "warm": rng.normal(0.02, 0.04)}
    return Room(size, focus, objects, structures, window, light)


def _table(split: Split, rng: Rng) -> Placed:
    thing = CATALOGUE["table"](rng, split)
    x, y = rng.uniform(-0.25, 0.25, 2).tolist()
    return Placed(thing, (x, y, 0.0), float(rng.uniform(0, 180)))


def _fits(new: Placed, others: list[Placed], gap: float) -> bool:
    return not any(overlap(new.footprint, other.footprint, gap) for other in others)


def _inside(new: Placed, size: tuple[float, float]) -> bool:
    return bool((np.abs(new.footprint) <= np.array(size) / 2 - 0.02).all())


def _wall_frame(wall: int, size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, float]:
    """Inward normal, direction along the wall, distance of the wall from the middle."""
    normal = np.round(turn("z", 90 * wall)[:2, :2] @ [-1.0, 0.0], 12)
    return normal, np.array([-normal[1], normal[0]]), size[wall % 2] / 2


def _at_wall(objects: list[Placed], thing: Thing, wall: int, size: tuple[float, float], rng: Rng) -> None:
    normal, along, away = _wall_frame(wall, size)
    depth, wide = thing.size[0], thing.size[1]
    room = size[(wall + 1) % 2] / 2 - wide / 2 - 0.1
    for _ in range(60):
        x, y = -normal * (away - depth / 2 - 0.06) + along * rng.uniform(-room, room)
        degrees = float(np.degrees(np.arctan2(normal[1], normal[0])))
        new = Placed(thing, (float(x), float(y), 0.0), degrees)
        if _inside(new, size) and _fits(new, objects, 0.15):
            objects.append(new)
            return


def _chairs(objects: list[Placed], table: Placed, split: Split, rng: Rng) -> None:
    """One or two at the sides of the table, facing it."""
    chair = CATALOGUE["chair"](rng, split)
    sides = rng.permutation(4)[: int(rng.integers(1, 3))]
    for side in sides.tolist():
        reach = table.thing.size[side % 2] / 2 + chair.size[0] / 2 + rng.uniform(0.06, 0.15)
        degrees = table.degrees + 90 * side
        x, y = turn("z", degrees)[:2, :2] @ [reach, rng.uniform(-0.15, 0.15)] + table.position[:2]
        new = Placed(chair, (float(x), float(y), 0.0), degrees + 180 + float(rng.uniform(-12, 12)))
        if _fits(new, objects, 0.03):
            objects.append(new)


def _on_floor(objects: list[Placed], split: Split, rng: Rng, size: tuple[float, float]) -> None:
    for kind in rng.permutation(ON_FLOOR)[: int(rng.integers(2, 4))].tolist():
        thing = CATALOGUE[kind](rng, split)
        for _ in range(80):
            place = rng.uniform(-0.5, 0.5, 2) * (np.array(size) - 0.3)
            if thing.size[2] > 0.8:  # tall ones go into corners, out of the way of cameras
                place = np.sign(place) * (np.array(size) / 2 - 0.08 - thing.size[:2].max() / 2)
            new = Placed(thing, (float(place[0]), float(place[1]), 0.0), float(rng.uniform(0, 360)))
            if _inside(new, size) and _fits(new, objects, 0.08):
                objects.append(new)
                break


def _on_ledges(objects: list[Placed], hosts: list[Placed], split: Split, rng: Rng) -> None:
    """Fill tables, seats and shelves; a kind comes twice at most, and then in two colours."""
    used: list[tuple[str, str]] = [(o.thing.name, o.thing.color) for o in objects]
    wanted = {"table": (ON_TABLE, int(rng.integers(8, 11))), "sofa": (ON_SEAT, int(rng.integers(1, 3)))}
    for host in hosts:
        kinds, count = wanted.get(host.thing.name, (ON_SHELF, 1))
        for number, ledge in enumerate(host.thing.ledges):
            if host.thing.name == "shelf":
                count = 0 if number == 0 else int(rng.integers(1, 3))
            here: list[Placed] = []
            things = _choice(kinds, min(count, MOST - len(objects)), used, split, rng)
            for thing in sorted(things, key=lambda thing: -float(thing.size[0] * thing.size[1])):
                placed = _somewhere(thing, host, ledge, here, rng)
                if placed is not None:
                    here.append(placed)
                    used.append((thing.name, thing.color))
            objects.extend(here)


def _choice(kinds: tuple[str, ...], count: int, used: list[tuple[str, str]], split: Split, rng: Rng) -> list[Thing]:
    things: list[Thing] = []
    for kind in rng.permutation(kinds).tolist():
        if len(things) >= count:
            break
        thing = CATALOGUE[kind](rng, split)
        same = [shade for name, shade in used if name == thing.name]
        if len(same) < (1 if rng.random() < 0.75 else 2) and thing.color not in same:
            things.append(thing)
    return things


def _somewhere(thing: Thing, host: Placed, ledge: Ledge, here: list[Placed], rng: Rng) -> Placed | None:
    """A free place for a thing on a ledge, or None; on shelves it looks out."""
    if thing.size[2] > ledge.clearance or thing.size[2] > 0.6:
        return None
    narrow = min(ledge.size) < 0.5
    for _ in range(40):
        yaw = rng.uniform(-20, 20) if narrow else rng.uniform(0, 360)
        spread = rng.uniform(-0.5, 0.5, 2) if narrow else np.clip(rng.normal(0, 0.22, 2), -0.5, 0.5)
        local = np.array(ledge.center) + spread * np.array(ledge.size)
        flat = Placed(thing, (float(local[0]), float(local[1]), 0.0), float(yaw)).footprint
        if (np.abs(flat - ledge.center) > np.array(ledge.size) / 2).any():
            continue
        x, y = turn("z", host.degrees)[:2, :2] @ local + host.position[:2]
        new = Placed(thing, (float(x), float(y), host.position[2] + ledge.z), host.degrees + float(yaw))
        if _fits(new, here, 0.012):
            return new
    return None


def _shell(
    split: Split, rng: Rng, size: tuple[float, float], window_wall: int
) -> tuple[list[Structure], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    clothes = Wardrobe(split, rng)
    wall_shade = color(rng, "white", "yellow", "blue", "green", "pink", "grey")
    pale = washed(wall_shade.rgb, 0.62, 0.32)
    wall = clothes.textured("wall", "plaster", pale, shaded(pale, 0.94), 1.5)
    floor_shade = color(rng, "brown", "brown", "grey", "white")
    light_floor = washed(floor_shade.rgb, 0.18, 0.8)
    floor = clothes.textured("floor", "wood", light_floor, shaded(light_floor, 0.5), float(rng.uniform(0.7, 1.1)))
    ground = box((size[0], size[1], 0.1)).moved(z=-0.1)
    walls, skirting, white = [], [], plain("plaster", (0.92, 0.91, 0.88))
    for k in range(4):
        _, _, away = _wall_frame(k, size)
        along = size[(k + 1) % 2]
        walls.append(box((0.1, along + 0.2, WALL_HEIGHT)).moved(x=away + 0.05).turned("z", 90 * k))
        skirting.append(box((0.015, along, 0.08)).moved(x=away - 0.0075).turned("z", 90 * k))
    frame, light = _window(size, window_wall, rng)
    structures = [
        Structure("floor", [(floor, ground)]),
        Structure("wall", [*((wall, mesh) for mesh in walls), *((white, mesh) for mesh in skirting)]),
        Structure("window", [(white, mesh) for mesh in frame]),
    ]
    if rng.random() < 0.5:
        rug_shade = color(rng)
        look = clothes.patterned(rug_shade, "fabric", 0.6)
        structures.append(Structure("rug", [(look, box((2.3, 1.7, 0.004)).turned("z", float(rng.uniform(0, 180))))]))
    return structures, light


def _window(
    size: tuple[float, float], wall: int, rng: Rng
) -> tuple[list[Mesh], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Frame bars, and corner and sides of the pane, which shines into the room."""
    normal, along, away = _wall_frame(wall, size)
    wide, tall, low, shift = (rng.uniform(1.3, 1.7), rng.uniform(1.2, 1.4), 0.95, rng.uniform(-0.3, 0.3))
    corner = np.array([*(-normal * (away - 0.02) + along * (shift - wide / 2)), low])
    bars = [box((0.06, wide + 0.08, 0.06)).moved(z=z) for z in (low - 0.05, low + tall - 0.01)]
    bars += [box((0.05, 0.05, tall)).moved(y=y, z=low) for y in (-wide / 2 - 0.015, 0, wide / 2 + 0.015)]
    turned = float(np.degrees(np.arctan2(normal[1], normal[0])))
    x, y = -normal * (away - 0.035) + along * shift
    frame = [bar.turned("z", turned).moved(float(x), float(y)) for bar in bars]
    return frame, (corner, np.array([*(along * wide), 0.0]), np.array([0.0, 0.0, tall]))
