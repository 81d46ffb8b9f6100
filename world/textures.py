"""Small tileable bitmaps from a seed: a pattern between two colours, or grain around one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64, UInt8

SIDE = 128
Rgb = tuple[float, float, float]
Mask = Float64[np.ndarray, "side side"]
_ROWS, _COLUMNS = np.mgrid[0:SIDE, 0:SIDE] / SIDE


def noise(rng: np.random.Generator, across: float, down: float, slope: float = 1.5) -> Mask:
    """Tileable, mean 0, deviation 1; `across` and `down` are its grain in 1/side, larger is finer."""
    y, x = np.meshgrid(np.fft.fftfreq(SIDE, 1 / SIDE), np.fft.rfftfreq(SIDE, 1 / SIDE), indexing="ij")
    power = (1 + (x / across) ** 2 + (y / down) ** 2) ** -slope
    power[0, 0] = 0
    field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(SIDE, SIDE))) * power, (SIDE, SIDE))
    return field / field.std()


def _soft(signed: np.ndarray, width: float = 0.06) -> Mask:
    """0 below zero, 1 above, with a soft edge against aliasing."""
    return np.clip(0.5 + signed / width, 0, 1)


def stripes(rng: np.random.Generator) -> Mask:
    count = rng.integers(2, 5)
    return _soft(np.cos(2 * np.pi * count * _ROWS) - rng.uniform(0.35, 0.7), 0.3)


def dots(rng: np.random.Generator) -> Mask:
    count = rng.integers(2, 4)
    x, y = (np.mod(count * a + b, 1) - 0.5 for a, b in ((_COLUMNS, 0.0), (_ROWS, 0.0)))
    x2, y2 = (np.mod(count * a + 0.5, 1) - 0.5 for a in (_COLUMNS, _ROWS))
    radius = rng.uniform(0.17, 0.24)
    return np.maximum(_soft(radius - np.hypot(x, y), 0.05), _soft(radius - np.hypot(x2, y2), 0.05))


def plaid(rng: np.random.Generator) -> Mask:
    count, cut = rng.integers(2, 4), rng.uniform(0.4, 0.7)
    a, b = (_soft(np.cos(2 * np.pi * count * t) - cut, 0.3) for t in (_ROWS, _COLUMNS))
    return 0.5 * (a + b)


def checks(rng: np.random.Generator) -> Mask:
    count = rng.integers(2, 4)
    a, b = (np.sin(2 * np.pi * count * t) for t in (_ROWS, _COLUMNS))
    return 0.75 * _soft(a * b - 0.12, 0.1)


def chevrons(rng: np.random.Generator) -> Mask:
    count = rng.integers(2, 4)
    zigzag = 0.5 * np.abs(np.mod(2 * _COLUMNS, 1) * 2 - 1)
    return _soft(np.cos(2 * np.pi * count * (_ROWS + zigzag / count)) - 0.4, 0.3)


def diamonds(rng: np.random.Generator) -> Mask:
    count = rng.integers(2, 4)
    x, y = (np.abs(np.mod(count * t, 1) - 0.5) for t in (_COLUMNS, _ROWS))
    return _soft(rng.uniform(0.27, 0.34) - (x + y), 0.05)


def grain(rng: np.random.Generator) -> Mask:
    """Wood: fine fibres along u with slow bands."""
    fibres, bands = noise(rng, 2.0, 40.0), noise(rng, 1.0, 6.0)
    return 0.4 + 0.17 * fibres + 0.17 * bands


def flames(rng: np.random.Generator) -> Mask:
    """Wood: year rings, cut aslant."""
    warp = noise(rng, 1.2, 2.5, 2.5)
    rings = np.sin(2 * np.pi * (rng.integers(5, 9) * _ROWS + 0.8 * warp))
    return 0.42 + 0.22 * rings + 0.08 * noise(rng, 3.0, 40.0)


def plaster(rng: np.random.Generator) -> Mask:
    return 0.3 + 0.14 * noise(rng, 4, 4)


def stucco(rng: np.random.Generator) -> Mask:
    return 0.3 + 0.10 * noise(rng, 30, 30) + 0.16 * noise(rng, 2, 2, 2.0)


def planks(rng: np.random.Generator) -> Mask:
    """Floor boards along u, four to a tile."""
    board = np.floor(4 * _ROWS).astype(int)
    tone, shift = rng.uniform(0, 0.45, 4)[board], rng.uniform(0, 1, 4)[board]
    fibres = np.clip(0.15 * noise(rng, 2.0, 40.0), -0.3, 0.3)
    gap = np.minimum(np.mod(4 * _ROWS, 1), np.mod(_COLUMNS + shift, 1) * 4) < 0.06
    return tone + 0.2 + fibres + 0.5 * gap


def tiles(rng: np.random.Generator) -> Mask:
    cell = (np.floor(2 * _ROWS) * 2 + np.floor(2 * _COLUMNS)).astype(int)
    gap = (np.mod(2 * _ROWS, 1) < 0.035) | (np.mod(2 * _COLUMNS, 1) < 0.035)
    return rng.uniform(0, 0.3, 4)[cell] + 0.07 * noise(rng, 6, 6) + 0.55 * gap


def parquet(rng: np.random.Generator) -> Mask:
    """Squares of four staves, alternately along u and along v."""
    x, y = 2 * _COLUMNS, 2 * _ROWS
    flip = (np.floor(x) + np.floor(y)) % 2 == 0
    stave = np.floor(4 * np.where(flip, y, x)).astype(int)
    tone = rng.uniform(0, 0.5, 16)[(stave + 8 * flip) % 16]
    gap = np.mod(4 * np.where(flip, y, x), 1) < 0.08
    fibres = np.where(flip, noise(rng, 2, 40), noise(rng, 40, 2))
    return tone + 0.15 + 0.1 * fibres + 0.4 * gap


def terrazzo(rng: np.random.Generator) -> Mask:
    chips = noise(rng, 20, 20, 2.0)
    dark, pale = _soft(chips - 1.2, 0.3), _soft(-chips - 1.2, 0.3)
    return 0.25 + 0.35 * dark - 0.25 * pale


def weave(rng: np.random.Generator) -> Mask:
    """Cloth: threads over and under."""
    thread = 0.5 + 0.5 * np.sin(2 * np.pi * 24 * _ROWS) * np.sin(2 * np.pi * 24 * _COLUMNS)
    return 0.25 * thread + 0.1 + 0.06 * noise(rng, 5, 5)


def twill(rng: np.random.Generator) -> Mask:
    """Cloth: a fine diagonal rib."""
    rib = 0.5 + 0.5 * np.sin(2 * np.pi * 20 * (_ROWS + _COLUMNS))
    return 0.25 * rib + 0.1 + 0.07 * noise(rng, 12, 12)


def wicker(rng: np.random.Generator) -> Mask:
    """Basketwork, rods going round: bricks that bulge."""
    row = np.floor(12 * _ROWS)
    over = np.abs(np.sin(np.pi * (6 * _COLUMNS + 0.5 * row)))
    round_ = np.abs(np.sin(np.pi * 12 * _ROWS))
    return 0.95 - 0.75 * over * round_ + 0.04 * noise(rng, 10, 10)


def rushes(rng: np.random.Generator) -> Mask:
    """Basketwork, coiled: thick rounds with stitches."""
    round_ = np.abs(np.sin(np.pi * 10 * _ROWS))
    stitch = np.cos(2 * np.pi * (8 * _COLUMNS + 4 * _ROWS)) > 0.6
    return 0.9 - 0.65 * round_ + 0.15 * stitch + 0.04 * noise(rng, 10, 10)


def speckles(rng: np.random.Generator) -> Mask:
    """Peel of fruit, glaze: faint spots."""
    return 0.12 + 0.12 * noise(rng, 14, 14)


def freckles(rng: np.random.Generator) -> Mask:
    return 0.08 + 0.3 * _soft(noise(rng, 16, 16, 2.0) - 1.5, 0.4)


PATTERNS: dict[str, Callable[[np.random.Generator], Mask]] = {
    pattern.__name__: pattern
    for pattern in (
        stripes, dots, plaid, checks, chevrons, diamonds, grain, flames, plaster, stucco, planks,
        tiles, parquet, terrazzo, weave, twill, wicker, rushes, speckles, freckles,
    )
}  # fmt: skip


def bitmap(family: str, rng: np.random.Generator, first: Rgb, second: Rgb) -> UInt8[np.ndarray, "s s 3"]:
    """sRGB: `first` where the family's pattern is 0, `second` where it is 1."""
    mask = np.clip(PATTERNS[family](rng), 0, 1)[..., None]
    mixed = (1 - mask) * np.array(first) + mask * np.array(second)
    return np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)
