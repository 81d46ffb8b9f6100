"""What surfaces look like: named colours, materials, textures; and what train and test may use."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from .textures import Rgb, bitmap

COLORS: dict[str, tuple[tuple[int, int, int], ...]] = {
    "red": ((200, 30, 35), (165, 22, 30), (215, 45, 40)), "orange": ((242, 128, 20), (232, 112, 22), (248, 145, 45)),
    "yellow": ((246, 206, 40), (238, 194, 20), (250, 220, 95)),
    "green": ((50, 140, 60), (95, 165, 60), (30, 100, 58), (125, 180, 80)),
    "blue": ((30, 82, 175), (50, 112, 205), (28, 52, 125), (85, 150, 218)),
    "purple": ((110, 50, 150), (138, 80, 172), (85, 40, 122)),
    "pink": ((240, 140, 175), (236, 112, 160), (248, 178, 200)), "brown": ((110, 66, 36), (140, 92, 56), (86, 52, 32)),
    "black": ((24, 24, 27), (38, 36, 38)), "white": ((240, 240, 236), (230, 229, 226)),
    "grey": ((128, 129, 132), (100, 102, 106), (156, 157, 158)),
}  # fmt: skip
"""The eleven basic colour terms of English; a colour of a name is a mixture of its anchors (sRGB)."""

VIVID = ("red", "orange", "yellow", "green", "blue", "purple", "pink")
PAINTS = (*VIVID, "black", "white", "grey", "brown")


MATERIALS = {
    "ceramic": 0.10, "plastic": 0.18, "glass": 0.05, "rubber": 0.35, "wood": 0.38, "leather": 0.32, "wax": 0.45,
    "peel": 0.25, "leaf": 0.40, "metal": 0.22, "fabric": None, "paper": None, "cardboard": None, "wicker": None,
    "plush": None, "plaster": None, "flame": None, "screen": 0.2,
}  # fmt: skip
"""How rough the gloss over each is, of metal its surface; None for what has no gloss."""


@dataclass(frozen=True)
class Split:
    """A part of all worlds: seeds in [first, last) and the texture families for each use."""

    name: str
    first: int
    last: int
    families: dict[str, tuple[str, ...]] = field(hash=False)

    def rng(self, seed: int, *stream: int) -> np.random.Generator:
        """The random numbers of one of this split's seeds; streams are independent of each other.

        Raises: ValueError: the split has no such seed.
        """
        if not 0 <= seed < self.last - self.first:
            raise ValueError(f"split '{self.name}': expected a seed in 0..{self.last - self.first - 1}, got {seed}")
        return np.random.default_rng([self.first + seed, *stream])


TRAIN = Split(
    "train", 0, 1_000_000,
    {"pattern": ("stripes", "dots", "plaid"), "wood": ("grain",), "wall": ("plaster",),
     "floor": ("planks", "tiles"), "cloth": ("weave",), "wicker": ("wicker",), "spots": ("speckles",)},
)  # fmt: skip
TEST = Split(
    "test", 1_000_000, 2_000_000,
    {"pattern": ("checks", "chevrons", "diamonds"), "wood": ("flames",), "wall": ("stucco",),
     "floor": ("parquet", "terrazzo"), "cloth": ("twill",), "wicker": ("rushes",), "spots": ("freckles",)},
)  # fmt: skip
SPLITS = {split.name: split for split in (TRAIN, TEST)}


@dataclass(frozen=True)
class Color:
    word: str
    rgb: Rgb


@dataclass(frozen=True, eq=False)
class Texture:
    """family: of `textures.PATTERNS`. metres: what one repeat covers on the surface."""

    family: str
    bitmap: UInt8[np.ndarray, "s s 3"]
    metres: float


@dataclass(frozen=True, eq=False)
class Look:
    material: str
    rgb: Rgb
    texture: Texture | None = None


def color(rng: np.random.Generator, *words: str) -> Color:
    """One of the words (all paints if none is given), and a shade of it."""
    word = str(rng.choice(words or PAINTS))
    weights = rng.dirichlet(np.ones(len(COLORS[word])))
    shade = weights @ np.array(COLORS[word]) / 255 + rng.normal(0, 0.008, 3)
    return Color(word, _rgb(np.clip(shade, 0.03, 0.96)))


def _rgb(values: np.ndarray) -> Rgb:
    r, g, b = np.asarray(values, float).tolist()
    return (r, g, b)


def shaded(rgb: Rgb, factor: float) -> Rgb:
    """Darker below 1, nearer to white above."""
    values = np.array(rgb)
    return _rgb(values * factor if factor <= 1 else 1 - (1 - values) * (2 - factor))


def washed(rgb: Rgb, white: float, share: float) -> Rgb:
    """A share of the colour over this much white."""
    return _rgb(white + share * np.array(rgb))


def plain(material: str, shade: Color | Rgb) -> Look:
    return Look(material, shade.rgb if isinstance(shade, Color) else shade)


@dataclass(frozen=True)
class Wardrobe:
    """Dresses surfaces with what a split may use."""

    split: Split
    rng: np.random.Generator

    def textured(self, use: str, material: str, first: Rgb, second: Rgb, metres: float) -> Look:
        """A texture of one of the families of this use."""
        family = str(self.rng.choice(self.split.families[use]))
        image = bitmap(family, self.rng, first, second)
        return Look(material, first, Texture(family, image, metres))

    def wood(self, shade: Color, metres: float = 0.5) -> Look:
        return self.textured("wood", "wood", shaded(shade.rgb, 1.12), shaded(shade.rgb, 0.62), metres)

    def cloth(self, shade: Color, material: str = "fabric", metres: float = 0.12) -> Look:
        return self.textured("cloth", material, shade.rgb, shaded(shade.rgb, 0.5), metres)

    def spotted(self, shade: Color, material: str, metres: float = 0.08) -> Look:
        return self.textured("spots", material, shade.rgb, shaded(shade.rgb, 0.62), metres)

    def patterned(self, shade: Color, material: str, metres: float) -> Look:
        """The shade with a pattern of white, or of a deeper shade of it where it is pale."""
        pale = min(shade.rgb) > 0.6
        other = shaded(shade.rgb, 0.55) if pale or self.rng.random() < 0.4 else (0.93, 0.92, 0.88)
        if shade.word == "black":
            other = (0.42, 0.42, 0.44)
        return self.textured("pattern", material, shade.rgb, other, metres)

    def maybe_patterned(self, shade: Color, material: str, metres: float, chance: float) -> Look:
        if self.rng.random() < chance:
            return self.patterned(shade, material, metres)
        return plain(material, shade)
