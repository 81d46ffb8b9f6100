"""All things in a grid, several seeds each, with their names: to be looked at."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from .cameras import look_at
from .crops import Stage, random_sky, shoot
from .looks import Split, plain
from .meshes import box
from .things import CATALOGUE, make

COLUMNS = 3
LABEL = 13  # pixels


def contact_sheet(path: Path, split: Split, seeds: int = 4, side: int = 72, spp: int = 48, quality: int = 72) -> None:
    """Writes a JPEG: a block of `seeds` pictures per kind of thing."""
    rows = []
    for kind in CATALOGUE:
        stages = [_studio(kind, split, seed, side) for seed in range(seeds)]
        sky = random_sky(np.random.default_rng(3))
        rows.append((kind, [crop.image for crop in shoot(stages, sky, spp, 1)]))
    _paste(rows, seeds, side).save(path, quality=quality)


def _studio(kind: str, split: Split, seed: int, side: int) -> Stage:
    thing = make(kind, split, seed)
    scale = float(1 / thing.size.max())
    turn = np.radians(35 + 25 * (seed % 3) - 60 * (seed % 2))
    toward = np.array([np.cos(turn), np.sin(turn), 0.45 if thing.size[2] * scale > 0.25 else 1.0])
    middle = np.array([0, 0, 0.5 * thing.size[2] * scale])
    eye = middle + 2.35 * toward / np.linalg.norm(toward)
    paper = plain("plaster", (0.80, 0.82, 0.84))
    ground = box((80.0, 80.0, 0.2)).moved(z=-0.2)
    view = look_at(eye, middle, (side, side), 27.0, kind)
    return Stage([(thing, (0.0, 0.0, 0.0, scale))], [(paper, ground)], view, np.full(3, 1.5))


def _paste(rows: list[tuple[str, list[np.ndarray]]], seeds: int, side: int) -> Image.Image:
    deep = -(-len(rows) // COLUMNS)
    width, height = seeds * side + 6, side + LABEL
    sheet = Image.new("RGB", (COLUMNS * width - 6, deep * height), "white")
    draw = ImageDraw.Draw(sheet)
    for k, (kind, images) in enumerate(rows):
        x, y = (k // deep) * width, (k % deep) * height
        draw.text((x + 2, y), kind.replace("_", " "), fill="black")
        for n, image in enumerate(images):
            sheet.paste(Image.fromarray(image), (x + n * side, y + LABEL))
    return sheet
