"""Pictures of single things on small stages, many at once: what an image-text encoder learns from.

Every stage has a thing, now and then neighbours that hide a part of it, a floor and a wall from the
split's textures. All stages of a batch are in one scene under one sky, each with its own camera, so that
one run of the renderer makes them all.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from drsplat import View

from . import engine
from .cameras import look_at
from .looks import Look, Split, Wardrobe, color, plain, shaded, washed
from .meshes import Mesh, box
from .thing import Thing
from .things import CATALOGUE

AT_WALLS = ("sofa", "shelf")  # nobody sees the backs of these
SPACING = 60.0  # metres between stages; a thing's longest side on its stage is one metre


@dataclass(frozen=True, eq=False)
class Crop:
    """mask: where the thing itself is seen, without what its neighbours hide."""

    image: UInt8[np.ndarray, "s s 3"]
    mask: Bool[np.ndarray, "s s"]
    name: str
    color: str
    material: str


@dataclass(frozen=True, eq=False)
class Stage:
    """Actors are things with their places: (x, y, degrees about z, scale); the first is the star."""

    actors: list[tuple[Thing, tuple[float, float, float, float]]]
    scenery: list[tuple[Look, Mesh]]
    view: View
    exposure: Float64[np.ndarray, " 3"]


def crops(split: Split, seed: int, count: int, side: int = 128, spp: int = 8, batch: int = 64) -> Iterator[Crop]:
    """`count` crops, the kinds of things in turn; deterministic, batch by batch."""
    for start in range(0, count, batch):
        numbers = range(start, min(start + batch, count))
        rng = split.rng(seed, 101, start)
        stages = [random_stage(split, split.rng(seed, 100, k), k % len(CATALOGUE), side) for k in numbers]
        yield from shoot(stages, random_sky(rng), spp, int(rng.integers(2**31)))


def random_stage(split: Split, rng: np.random.Generator, kind: int, side: int) -> Stage:
    """A thing of this kind of the catalogue, from anywhere above the floor."""
    makers = list(CATALOGUE.values())
    star = makers[kind](rng, split)
    azimuth = float(rng.uniform(0, 2 * np.pi))
    around = 100 if star.name in AT_WALLS else 180
    turn = np.degrees(azimuth) + rng.uniform(-around, around)
    actors = [(star, (0.0, 0.0, float(turn), _unit(star)))]
    for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.3, 0.2]))):
        other = makers[int(rng.integers(len(makers)))](rng, split)
        before = rng.random() < 0.25  # the star, and then it must be small
        scale = _unit(other) * (rng.uniform(0.2, 0.4) if before else rng.uniform(0.4, 0.9))
        gap = _reach(star, actors[0][1][3]) + _reach(other, scale) * rng.uniform(0.8, 1.1)
        angle = azimuth + (rng.uniform(-1.0, 1.0) if before else rng.uniform(1.0, 2 * np.pi - 1.0))
        x, y = gap * np.cos(angle), gap * np.sin(angle)
        actors.append((other, (float(x), float(y), float(rng.uniform(0, 360)), float(scale))))
    height = np.radians(rng.uniform(8, 55))
    toward = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
    middle = np.array([0, 0, 0.5 * star.size[2] * _unit(star)]) + rng.normal(0, 0.05, 3)
    eye = middle + toward * rng.uniform(2.1, 3.4)
    eye[2] = max(eye[2], 0.12)
    view = look_at(eye, middle, (side, side), 28.0, star.name)
    exposure = rng.uniform(0.9, 1.6) * (1 + rng.normal(0, 0.04, 3))
    return Stage(actors, _scenery(split, rng, azimuth), view, exposure)


def _unit(thing: Thing) -> float:
    return float(1 / thing.size.max())


def _reach(thing: Thing, scale: float) -> float:
    return float(scale * np.hypot(*thing.size[:2]) / 2)


def _scenery(split: Split, rng: np.random.Generator, azimuth: float) -> list[tuple[Look, Mesh]]:
    clothes = Wardrobe(split, rng)
    floor, wall = (_ground(clothes, rng, use) for use in ("floor", "wall"))
    flat = box((16.0, 16.0, 0.2)).moved(z=-0.2)
    away = rng.uniform(0.8, 4.0)
    upright = box((0.2, 24.0, 14.0)).moved(x=-away - 0.1).turned("z", float(np.degrees(azimuth)))
    return [(floor, flat), (wall, upright)]


def _ground(clothes: Wardrobe, rng: np.random.Generator, use: str) -> Look:
    shade = color(
        rng, "white", "white", "grey", "brown", "brown", *(["black", "blue", "green", "red", "yellow", "pink"])
    )
    pale = washed(shade.rgb, 0.35, 0.6) if rng.random() < 0.5 else shade.rgb
    kind = rng.random()
    if kind < 0.25:
        return plain("plaster", pale)
    dark = shaded(pale, 0.55)
    if kind < 0.5 and use == "floor":
        return clothes.textured("wood", "wood", pale, dark, float(rng.uniform(1.5, 3)))
    if kind < 0.65:
        return clothes.textured("cloth", "fabric", pale, dark, float(rng.uniform(0.6, 1.2)))
    return clothes.textured(use, "plaster", pale, dark, float(rng.uniform(1.0, 3.0)))


def random_sky(rng: np.random.Generator) -> Any:
    """A pale sky with one or two broad lights in it, warm or cool."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 32), np.linspace(0, 2 * np.pi, 64), indexing="ij")
    warm = rng.normal(0, 0.05)
    tint = np.array([1 + warm, 1.0, 1 - warm])
    image = 0.45 * (0.55 + 0.45 * np.cos(polar))[..., None] * np.ones(3)
    for _ in range(int(rng.integers(1, 3))):
        p, a = rng.uniform(0.25, 1.1), rng.uniform(0, 2 * np.pi)
        close = np.sin(polar) * np.sin(p) * np.cos(around - a) + np.cos(polar) * np.cos(p)
        sharp = rng.uniform(6, 40)
        image += (0.16 * sharp * np.exp(sharp * (close - 1)))[..., None]
    return (image * tint).astype(np.float32)


def shoot(stages: list[Stage], sky: Any, spp: int, seed: int) -> list[Crop]:
    """One picture of each stage."""
    shapes = dict(part for k, stage in enumerate(stages) for part in _built(stage, k))
    world = engine.scene(shapes, {"sky": engine.sky(sky)}, depth=3)
    views = [_shifted(stage.view, k) for k, stage in enumerate(stages)]
    wide = engine.radiance(world, engine.side_by_side(views, spp), seed)
    hits, _ = engine.first_hits(world, views, lambda name: int(name.split(":")[1]))
    pictures = np.split(wide, len(stages), axis=1)
    return [_crop(stage, picture, hit) for stage, picture, hit in zip(stages, pictures, hits, strict=True)]


def _built(stage: Stage, k: int) -> Iterator[tuple[str, Any]]:
    x, y = _corner(k)
    for n, (thing, (dx, dy, turn, scale)) in enumerate(stage.actors):
        for m, part in enumerate(thing.parts):
            mesh = part.mesh.scaled(scale, scale, scale).turned("z", turn).moved(x + dx, y + dy)
            yield f"s{k}:{n}:{m}", engine.shape(mesh, part.look, f"s{k}:{n}:{m}")
    for m, (look, mesh) in enumerate(stage.scenery):
        yield f"s{k}:-1:{m}", engine.shape(mesh.moved(x, y), look, f"s{k}:-1:{m}")


def _corner(k: int) -> tuple[float, float]:
    return SPACING * (k % 8), SPACING * (k // 8)


def _shifted(view: View, k: int) -> View:
    pose = view.cam_from_world.copy()
    pose[:3, 3] -= pose[:3, :3] @ np.array([*_corner(k), 0.0])
    return View(view.name, view.K, pose, view.width, view.height)


def _crop(stage: Stage, picture: np.ndarray, hit: np.ndarray) -> Crop:
    image = np.rint(255 * engine.srgb(picture * stage.exposure)).astype(np.uint8)
    star = stage.actors[0][0]
    return Crop(image, hit == 0, star.name, star.color, star.material)
