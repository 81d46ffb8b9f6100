"""Rooms in which things move: a car on a table, a swinging lamp, a rolling ball; 60 times, four cameras that stand and
one that goes round, and the truth of all of it.

    python -m world.moving --seed 0 --output DIR

The things are those of the catalogue, made of Gaussians: flat ones on their surfaces, of their colours. They are moved
by the true motion, and photos are drawn by `drsplat.render`; no other renderer is needed. DIR then holds `film.motion`,
`capture/` (photos, transforms.json with the time of each, language_features of true masks whose embeddings are the
words of things with noise) and `truth.json`.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int32
from PIL import Image
from scipy.spatial.transform import Rotation

from drsplat import Gaussians, View, ViewFeatures, WordEncoder, render
from drsplat.drawing.pictures import as_pixels
from drsplat.formats.langsplat import write_features
from drsplat.formats.moving_scenes import write_moving
from drsplat.kernels import render_channels, splat_arrays
from drsplat.scene.gaussians import SH_C0
from drsplat.scene.moving import Frames, Moving

from .cameras import look_at
from .layouts import phrase
from .looks import TEST, Look
from .meshes import Mesh, areas, box
from .things import make

TIMES = 60
SIZE = (160, 120)
FIXED, ROUND = 4, "cam04"
SPACING, WIDE = 0.012, 0.05  # metres between Gaussians of things, and of floor and table
NOISE = 0.5  # length of what is added to the unit vector of a mask's words
LIGHT = np.array([0.4, 0.3, 0.87])
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

Pose = tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]]


@dataclass(frozen=True, eq=False)
class Film:
    """names: of what there is, in words. labels: per row of `moving`, which of them it is. moves: which of them do."""

    moving: Moving
    names: tuple[str, ...]
    labels: Int32[np.ndarray, " n"]
    moves: tuple[int, ...]
    views: tuple[View, ...]

    @property
    def still(self) -> Moving:
        """The same things, all of them where they are in the middle of the film."""
        at = self.moving.at(float(self.moving.times[TIMES // 2]))
        return Moving(replace(at), self.moving.times, Frames(self.moving.times, lambda _: replace(at)))

    def masks(self, moving: Moving, view: View) -> Int32[np.ndarray, "h w"]:
        """What most of each pixel is of; -1 where it is more of nothing."""
        assert view.time is not None
        shown = np.eye(len(self.names), dtype=np.float32)[self.labels]
        drawn = render_channels(splat_arrays(moving.at(view.time), moving.canonical.near), view, shown)
        return np.where(drawn.alpha > 0.5, drawn.channels.argmax(2), -1).astype(np.int32)

    @cached_property
    def vectors(self) -> Float32[np.ndarray, "k d"]:
        return np.asarray(WordEncoder().encode_texts(self.names), np.float32)

    def features(self, moving: Moving, seed: int = 0) -> Mapping[str, ViewFeatures]:
        """True masks of all views, whose embeddings are their words', each with noise of its own."""
        found = {}
        for number, view in enumerate(self.views):
            rng = np.random.default_rng([seed, number])
            noise = rng.standard_normal(self.vectors.shape)
            noisy = self.vectors + NOISE * noise / np.linalg.norm(noise, axis=1, keepdims=True)
            unit = (noisy / np.linalg.norm(noisy, axis=1, keepdims=True)).astype(np.float32)
            found[view.name] = ViewFeatures(self.masks(moving, view), unit)
        return found


def make_film(seed: int) -> Film:
    """The same one for the same seed."""
    rng = np.random.default_rng([7, seed])
    table, car, vase, mug, lamp, ball = (make(kind, TEST, seed) for kind in KINDS)
    top = float(table.size[2])
    things = [table, car, vase, mug, lamp, ball]
    pieces = [[(part.look, part.mesh) for part in thing.parts] for thing in things]
    pieces.append([(Look("wood", (0.55, 0.45, 0.35)), box((4.0, 4.0, 0.02)).moved(z=-0.03))])
    spacings = [WIDE / 2, SPACING, SPACING, SPACING, SPACING, SPACING, WIDE]
    parts = [surfels(some, spacing, rng) for some, spacing in zip(pieces, spacings, strict=True)]
    labels = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part) for part in parts])
    rest, poses = _joined(parts), _poses(seed, [table, car, vase, mug, lamp, ball], top)

    def frame(number: int) -> Gaussians:
        at = [*(pose(number / (TIMES - 1)) for pose in poses), (np.eye(3), np.zeros(3))]
        return _posed(rest, labels, at)

    times = np.linspace(0, 2, TIMES)
    moving = Moving(frame(0), times, Frames(times, frame))
    names = (*(phrase(thing.color, thing.name) for thing in things), "grey floor")
    return Film(moving, names, labels, (1, 4, 5), tuple(_views(times, top)))


KINDS = ("table", "car", "vase", "mug", "lamp", "ball")


def _poses(seed: int, things: list, top: float):  # type: ignore[no-untyped-def,type-arg]
    """Of each thing where it is at a share of the film."""
    table, _, _, _, lamp, ball = things
    side = 1 if seed % 2 == 0 else -1
    length, width = table.size[0], table.size[1]
    radius = float(ball.size[2]) / 2
    still = np.eye(3)

    def drive(share: float) -> Pose:
        """Along the table, with a bend; it looks where it goes."""
        x, y = (share - 0.5) * 0.75 * length, side * (0.18 + 0.10 * np.sin(2 * np.pi * share)) * width
        ahead = np.array([0.75 * length, side * 0.10 * width * 2 * np.pi * np.cos(2 * np.pi * share)])
        return Rotation.from_euler("z", np.arctan2(ahead[1], ahead[0])).as_matrix(), np.array([x, y, top])

    def swing(share: float) -> Pose:
        """Hung from the ceiling, 30 degrees to either side, one and a half times."""
        angle = np.radians(30) * np.cos(3 * np.pi * share + seed)
        turned = Rotation.from_euler("x", angle).as_matrix()
        hung = np.array([0.0, 0.0, -0.3 - float(lamp.size[2])])
        pivot = np.array([0.25 * length, 0.0, top + 0.65 + float(lamp.size[2])])
        return turned, pivot + turned @ hung

    def roll(share: float) -> Pose:
        """Over the floor in front of the table: it turns by its way over its radius."""
        way = 2.4 * (share - 0.5) * side
        turned = Rotation.from_euler("y", way / radius).as_matrix()
        return turned, np.array([way, -0.75 * width - 0.3, radius]) - turned @ np.array([0, 0, radius])

    places = {"table": (0.0, 0.0, 0.0), "vase": (0.1 * length, -side * 0.12 * width, top),
              "mug": (-0.25 * length, -side * 0.25 * width, top)}  # fmt: skip
    fixed = {name: (lambda _, place=place: (still, np.array(place))) for name, place in places.items()}
    return [fixed["table"], drive, fixed["vase"], fixed["mug"], swing, roll]


def _views(times: Float64[np.ndarray, " t"], top: float) -> Iterator[View]:
    target = np.array([0.0, 0.0, top * 0.8])
    for number in range(FIXED + 1):
        for frame, time in enumerate(times.tolist()):
            around = np.pi / 2 * number - 1.2 if number < FIXED else 2 * np.pi * frame / len(times)
            eye = np.array([2.2 * np.cos(around), 2.2 * np.sin(around), top + 0.9 + 0.15 * number])
            view = look_at(eye.tolist(), target.tolist(), SIZE, 58.0, f"cam{number:02d}/frame_{frame:04d}.png")
            yield replace(view, time=time)


def surfels(pieces: list[tuple[Look, Mesh]], spacing: float, rng: np.random.Generator) -> Gaussians:
    """Flat Gaussians on surfaces, as many as a grid of this spacing would have; lit from one side."""
    made = [_on_mesh(look, mesh, spacing, rng) for look, mesh in pieces]
    return _joined(made)


def _on_mesh(look: Look, mesh: Mesh, spacing: float, rng: np.random.Generator) -> Gaussians:
    size = areas(mesh.vertices, mesh.faces)
    count = max(20, int(size.sum() / spacing**2))
    face = mesh.faces[rng.choice(len(size), count, p=size / size.sum())]
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    shares = np.stack([1 - root, root * (1 - v), root * v], 1)
    points, uv = ((shares * values[face]).sum(1) for values in (mesh.vertices, mesh.uv))
    a, b, c = (mesh.vertices[face[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colors = _colors(look, uv) * (0.6 + 0.4 * np.clip(normals @ LIGHT, 0, 1))[:, None]
    scales = np.tile(np.float32([0.75, 0.75, 0.12]) * np.float32(spacing), (count, 1))
    return Gaussians(
        points.astype(np.float32), _facing(normals), scales, np.full(count, 0.95, np.float32),
        ((colors - 0.5) / SH_C0).astype(np.float32)[:, None],
    )  # fmt: skip


def _colors(look: Look, uv: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    """sRGB, 0 to 1."""
    if look.texture is None:
        return np.tile(np.array(look.rgb), (len(uv), 1))
    bitmap = look.texture.bitmap
    at = np.floor(uv / look.texture.metres % 1.0 * len(bitmap)).astype(int) % len(bitmap)
    return np.asarray(bitmap[-1 - at[:, 1], at[:, 0]] / 255)


def _facing(normals: Float64[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 4"]:
    """Rotations that take z to the normals."""
    quats = np.column_stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))])
    quats[normals[:, 2] < -0.999999] = [0, 1, 0, 0]
    return (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32)


def _posed(rest: Gaussians, labels: Int32[np.ndarray, " n"], poses: list[Pose]) -> Gaussians:
    turns, shifts = np.stack([pose[0] for pose in poses]), np.stack([pose[1] for pose in poses])
    means = np.einsum("nij,nj->ni", turns[labels], rest.means.astype(np.float64)) + shifts[labels]
    turned = Rotation.from_matrix(turns)[labels] * Rotation.from_quat(rest.quats[:, [1, 2, 3, 0]])
    quats = turned.as_quat()[:, [3, 0, 1, 2]]
    return replace(rest, means=means.astype(np.float32), quats=quats.astype(np.float32))


def _joined(parts: list[Gaussians]) -> Gaussians:
    names = ("means", "quats", "scales", "opacities", "sh")
    return Gaussians(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def write_film(folder: Path, film: Film) -> None:
    """All of it in files, as `drsplat register` takes them. Raises: FileExistsError: the folder is there."""
    folder.mkdir(parents=True)
    write_moving(folder / "film.motion", film.moving)
    capture, frames = folder / "capture", []
    features = film.features(film.moving)
    for view in film.views:
        path = capture / "images" / view.name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert view.time is not None
        Image.fromarray(as_pixels(render(film.moving.at(view.time), view).rgb)).save(path)
        matrix = (np.linalg.inv(view.cam_from_world) @ _OPENGL).tolist()
        frames.append({"file_path": f"images/{view.name}", "time": view.time, "transform_matrix": matrix})
    first = film.views[0]
    lens = {"w": first.width, "h": first.height, "fl_x": first.K[0, 0], "fl_y": first.K[1, 1],
            "cx": first.K[0, 2], "cy": first.K[1, 2], "camera_model": "PINHOLE"}  # fmt: skip
    (capture / "transforms.json").write_text(json.dumps({**lens, "frames": frames}) + "\n")
    for name, one in features.items():
        stem = str(Path(name).with_suffix(""))
        write_features(capture / "language_features", stem, one.mask_ids, one.embeddings, form="compact")
    truth = {
        "names": film.names, "moves": film.moves, "counts": np.bincount(film.labels).tolist(),
        "times": film.moving.times.tolist(), "centers": _centers(film),
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(truth) + "\n")


def _centers(film: Film) -> list[list[list[float]]]:
    """Of each thing at each time, the mean of its Gaussians."""
    counts = np.bincount(film.labels)[:, None]
    found = []
    for time in film.moving.times.tolist():
        means = film.moving.at(time).means
        sums = np.stack([np.bincount(film.labels, means[:, axis]) for axis in range(3)], 1)
        found.append((sums / counts).round(6).tolist())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m world.moving", description="Makes a room in which things move.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    arguments = parser.parse_args()
    write_film(arguments.output, make_film(arguments.seed))


if __name__ == "__main__":
    main()
