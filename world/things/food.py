"""Fruit and vegetables; they keep their natural colours."""

import numpy as np

from ..looks import Color, Split, Wardrobe, color, plain
from ..meshes import Mesh, lathe, rounded, sphere, sweep
from ..thing import Thing, build

Rng = np.random.Generator
STALK = (0.30, 0.20, 0.10)


def _leaf(length: float, width: float, rise: float, droop: float) -> Mesh:
    """From the origin along +x; it rises, then droops."""
    t = np.linspace(0, 1, 10)
    path = [(length * s, 0, length * (rise * s - droop * s * s)) for s in t]
    half = [(0.0008, max(0.0006, width / 2 * np.sin(np.pi * min(1.0, s * 0.93 + 0.04)) ** 0.8)) for s in t]
    return sweep(path, half, 10)


def apple(rng: Rng, split: Split) -> Thing:
    radius, tall = rng.uniform(0.034, 0.042), rng.uniform(0.88, 1.05)
    shade = color(rng, "red", "green", "yellow")
    profile = rounded(
        [(0.0, 0.16), (0.16, 0.06), (0.42, 0.0), (0.78, 0.35), (1.0, 0.95), (1.0, 1.45), (0.62, 1.86),
         (0.2, 1.82), (0.0, 1.55)], 3
    )  # fmt: skip
    body = lathe([(r * radius, z * radius * tall) for r, z in profile])
    top = 1.55 * radius * tall
    stalk = sweep([(0, 0, top - 0.002), (0.001, 0, top + 0.010), (0.005, 0, top + 0.021)], [0.0013, 0.0013, 0.002], 8)
    pieces = [(Wardrobe(split, rng).spotted(shade, "peel", 0.07), body), (plain("wood", STALK), stalk)]
    if rng.random() < 0.6:
        leaf = _leaf(0.032, 0.016, 0.5, 0.35).turned("z", rng.uniform(0, 360)).moved(0.002, 0, top + 0.011)
        pieces.append((plain("leaf", color(rng, "green")), leaf))
    return build("apple", shade, "peel", *pieces)


def banana(rng: Rng, split: Split) -> Thing:
    """Lying on its side, bent in the floor's plane."""
    length, bend, thick = rng.uniform(0.16, 0.2), rng.uniform(70, 100), rng.uniform(0.015, 0.019)
    shade = color(rng, "yellow", "yellow", "yellow", "green")
    reach = length / np.radians(bend)
    turns = np.radians(np.linspace(-bend / 2, bend / 2, 26))
    path = np.array([(reach * np.sin(a), -reach * np.cos(a), thick) for a in turns])
    t = np.linspace(0, 1, 26)
    swell = np.clip(np.sin(np.pi * np.clip(t * 1.02, 0, 1)), 0.0, 1) ** 0.45
    radii = thick * np.maximum(swell, 0.32)
    radii[-4:] = thick * np.array([0.36, 0.3, 0.3, 0.34])
    body = sweep(path, radii, 12, 2.3)
    ends = [sweep(path[k : k + 2], radii[k : k + 2] * 1.03, 12, 2.3) for k in (0, 24)]
    look = Wardrobe(split, rng).spotted(shade, "peel", 0.06)
    return build("banana", shade, "peel", (look, body), (plain("peel", STALK), *ends))


def orange(rng: Rng, split: Split) -> Thing:
    radius, flat = rng.uniform(0.036, 0.044), rng.uniform(0.9, 0.98)
    shade = color(rng, "orange")
    ball = sphere(radius, radius, radius * flat, 40)
    dent = 1 - 0.10 * np.exp(-((ball.vertices[:, :2] ** 2).sum(1)) / (0.25 * radius) ** 2)
    ball.vertices[:, 2] *= dent
    button = sphere(0.0045, 0.0045, 0.0022, 10).moved(z=radius * flat * 0.91)
    look = Wardrobe(split, rng).spotted(shade, "peel", 0.04)
    return build("orange", shade, "peel", (look, ball), (plain("leaf", (0.30, 0.40, 0.15)), button))


def carrot(rng: Rng, split: Split) -> Thing:
    """Lying, its tip towards +x, with its leaves."""
    length, thick = rng.uniform(0.14, 0.19), rng.uniform(0.014, 0.019)
    shade = color(rng, "orange")
    t = np.linspace(0, 1, 30)
    wave = 1 + 0.035 * np.sin(2 * np.pi * 9 * t + rng.uniform(0, 6))
    radii = thick * np.clip(1.02 - 0.8 * t**1.15, 0.1, 1) * wave
    radii[[0, -1]] = thick * 0.55, thick * 0.05
    body = sweep([(length * s, 0, thick * (1 - 0.65 * s)) for s in t], radii, 20)
    leaf = plain("leaf", color(rng, "green"))
    stems = []
    for k in range(7):
        stem = _leaf(rng.uniform(0.07, 0.10), 0.010, rng.uniform(0.05, 0.5), 0.35)
        stems.append(stem.turned("z", 180 + (k - 3) * 13).moved(0.004, 0, thick * 1.05))
    return build("carrot", shade, "peel", (Wardrobe(split, rng).spotted(shade, "peel", 0.1), body), (leaf, *stems))


def pear(rng: Rng, split: Split) -> Thing:
    radius, tall = rng.uniform(0.033, 0.039), rng.uniform(0.95, 1.1)
    shade = color(rng, "green", "yellow")
    profile = rounded(
        [(0.0, 0.08), (0.35, 0.0), (0.85, 0.25), (1.08, 0.9), (0.75, 1.6), (0.42, 2.1), (0.36, 2.6),
         (0.1, 2.75), (0.0, 2.68)], 3
    )  # fmt: skip
    body = lathe([(r * radius, z * radius * tall) for r, z in profile])
    top = 2.68 * radius * tall
    stalk = sweep([(0, 0, top - 0.003), (0.001, 0, top + 0.009), (0.006, 0, top + 0.02)], 0.0015, 8)
    look = Wardrobe(split, rng).spotted(shade, "peel", 0.07)
    return build("pear", shade, "peel", (look, body), (plain("wood", STALK), stalk))


def bread(rng: Rng, split: Split) -> Thing:
    """A loaf of a golden brown, with pale cuts across it."""
    long, wide = rng.uniform(0.2, 0.28), rng.uniform(0.085, 0.11)
    red, green, blue = (np.array([0.66, 0.41, 0.18]) * rng.uniform(0.88, 1.1)).tolist()
    shade = Color("brown", (red, green, blue))
    t = np.linspace(0, 1, 24)
    swell = np.clip(1 - np.abs(2 * t - 1) ** 3.5, 0.02, 1) ** 0.5
    path = [(long * (s - 0.5), 0, 0) for s in t]
    body = sweep(path, np.stack([wide * 0.40 * swell, wide / 2 * swell], axis=1), 28, 2.3)
    cuts = []
    for x in long * np.linspace(-0.26, 0.26, int(rng.integers(3, 5))):
        turns = np.radians(np.linspace(35, 145, 9))
        line = [(x + 0.016 * np.cos(a), wide / 2 * np.cos(a), wide * 0.395 * np.sin(a)) for a in turns]
        cuts.append(sweep(line, [(0.004, 0.008)] * 9, 8))
    look = Wardrobe(split, rng).spotted(shade, "peel", 0.1)
    return build("bread", shade, "bread", (look, body), (plain("peel", (0.93, 0.80, 0.56)), *cuts))


THINGS = (apple, banana, orange, carrot, pear, bread)
