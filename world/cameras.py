"""Camera paths through a room, looking at the things in it. OpenCV axes: x right, y down, z forward."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from drsplat import View

from .meshes import turn
from .rooms import Placed, Room

Vec = Float64[np.ndarray, " 3"]
Point = tuple[float, float, float] | Vec
PATHS = ("both", "orbit", "walk")


def look_at(eye: Point, target: Point, size: tuple[int, int], across: float, name: str = "") -> View:
    """An upright camera at `eye`, the target in the middle of its picture; `across` is the
    horizontal angle of view in degrees."""
    width, height = size
    ahead = np.subtract(target, eye)
    forward = ahead / np.linalg.norm(ahead)
    right = np.cross(forward, (0.0, 0.0, 1.0) if abs(forward[2]) < 0.999 else (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ eye
    focal = width / (2 * np.tan(np.radians(across) / 2))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return View(name, K, pose, width, height)


def orbit(room: Room, count: int, size: tuple[int, int], rng: np.random.Generator) -> list[View]:
    """Once and a half round the room's focus, up and down on the way."""
    views = []
    for k in range(count):
        angle = 3 * np.pi * k / count + 0.3
        height = 0.55 + 0.3 * np.sin(7 * np.pi * k / count)
        for shrink in range(16):
            reach = rng.uniform(0.95, 1.4) * 0.97**shrink
            ring = np.array([reach * np.cos(angle), reach * np.sin(angle), height + 0.05 * shrink])
            eye = room.focus + ring
            if is_free(room, eye):
                break
        target = room.focus + rng.normal(0, 0.08, 3) * [1, 1, 0.5]
        views.append(look_at(eye, target, size, 60.0))
    return views


def walk(room: Room, count: int, size: tuple[int, int], rng: np.random.Generator) -> list[View]:
    """Along the walls at the height of eyes, looking across at the things; of a few such views at
    each place the one that sees the most."""
    views = []
    for k in range(count):
        around = 2 * np.pi * k / count
        tries = [_strolling(room, around, attempt, size, rng) for attempt in range(24)]
        free = [view for view in tries if is_free(room, view.center)]
        views.append(max(free[:6] or tries, key=lambda view: len(in_sight(room, view))))
    return views


def _strolling(room: Room, around: float, attempt: int, size: tuple[int, int], rng: np.random.Generator) -> View:
    angle = around + rng.normal(0, 0.02 + 0.02 * attempt)
    ring = np.array([np.cos(angle), np.sin(angle)])
    ring /= np.abs(ring).max() ** 0.7  # between a circle and the rectangle of the walls
    inset = rng.uniform(0.5, 0.9)
    eye = np.array([*(ring * (np.array(room.size) / 2 - inset)), rng.uniform(1.35, 1.75)])
    return look_at(eye, _across(room, eye, rng), size, 66.0)


def in_sight(room: Room, view: View) -> list[int]:
    """The things whose middle is in the picture and not behind tall furniture."""
    centers = np.array([placed.center for placed in room.objects])
    camera = centers @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    pixels = camera @ view.K.T
    half = np.array([view.width, view.height]) / 2
    ahead = camera[:, 2] > 0.5
    middle = np.abs(pixels[:, :2] - half * pixels[:, 2:]) < 0.9 * half * pixels[:, 2:]
    tall = [placed for placed in room.objects if placed.thing.size.prod() > 0.15]
    return [
        int(k)
        for k in np.flatnonzero(ahead & middle.all(1))
        if not any(_hides(placed, view.center, centers[k]) for placed in tall)
    ]


def _hides(placed: Placed, eye: Vec, target: Vec) -> bool:
    """Whether the first four fifths of the way from the eye to the target cross the thing's box."""
    return any(_distance(placed, eye + t * (target - eye)) == 0 for t in np.linspace(0.05, 0.8, 12))


def _across(room: Room, eye: Vec, rng: np.random.Generator) -> Vec:
    """A thing in the other half of the room, or near it."""
    far = [o.center for o in room.objects if np.linalg.norm(o.center[:2] - eye[:2]) > 1.7]
    target = np.array(far[int(rng.integers(len(far)))]) if far else room.focus.copy()
    target[2] = np.clip(target[2], 0.3, 1.0)
    return 0.75 * target + 0.25 * room.focus


def is_free(room: Room, eye: Vec, gap: float = 0.3) -> bool:
    """In the room, and no nearer than `gap` to a wall or the box of a thing."""
    if (np.abs(eye[:2]) > np.array(room.size) / 2 - gap).any() or not 0.2 < eye[2] < 2.4:
        return False
    return all(_distance(placed, eye) >= gap for placed in room.objects)


def _distance(placed: Placed, eye: Vec) -> float:
    """From a point to the oriented box of a thing, in metres; 0 inside."""
    low, high = placed.thing.bounds
    local = turn("z", -placed.degrees) @ (eye - np.array(placed.position))
    return float(np.linalg.norm(np.maximum(0, np.maximum(low - local, local - high))))


def views_of(room: Room, count: int, size: tuple[int, int], rng: np.random.Generator, path: str = "both") -> list[View]:
    """frame_00001.jpg and so on. path: one of PATHS; "both" is three in five in orbit, the rest walking."""
    around = {"orbit": count, "walk": 0, "both": -(-3 * count // 5)}[path]
    views = orbit(room, around, size, rng) + walk(room, count - around, size, rng)
    return [replace(view, name=f"frame_{k:05d}.jpg") for k, view in enumerate(views, 1)]
