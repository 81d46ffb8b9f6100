"""Which of the 11 basic colour terms people call a pixel by, from the names of the xkcd colour survey.

The survey (Munroe 2010, https://xkcd.com/color/rgb/, public domain by CC0) has 949 names, each with the colour that
people gave it to; matplotlib ships them. A name counts as the basic term that it ends with, or that its last word is
known to mean, and half as much as the terms before it: "reddish brown" is two thirds brown. A pixel is called as the
mean of the names nearest to it by CIEDE2000. The plain distance in CIELAB is no substitute: it takes pale things for
grey, an orange of little light for pink and a dark green for black, since it gives chroma as much room as hue.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np
from jaxtyping import Float32, Float64
from skimage.color import deltaE_ciede2000, rgb2lab

from drsplat.base.arrays import Colors, OtherPoints, Points
from drsplat.photos.models.mini.lexicon import COLORS

NEAREST_NAMES = 6
SHIFT, LEVELS = 3, 32  # bits of a channel that are dropped, and the values that are left
MODIFIER_WEIGHT = 0.5  # of a term before the last word
WHOLE_NAMES: dict[str, tuple[str, ...]] = {
    "light grey": ("grey", "white"), "pale grey": ("grey", "white"), "very light grey": ("grey", "white"),
    "silver": ("grey", "white"), "dark grey": ("black", "grey"), "charcoal grey": ("black", "grey"),
}  # fmt: skip
MIXTURES: dict[str, tuple[str, ...]] = {
    "peach": ("orange", "pink"), "salmon": ("orange", "pink"), "coral": ("orange", "red", "pink"),
    "teal": ("blue", "green"), "turquoise": ("blue", "green"), "terracotta": ("brown", "orange"),
    "cotta": ("brown", "orange"), "rust": ("brown", "orange"), "copper": ("brown", "orange"),
    "clay": ("brown", "orange"), "maroon": ("red", "brown"),
}  # fmt: skip
MEANT = {
    "black": "dark midnight charcoal",
    "grey": "steel cement stone gunmetal greyish slate",
    "white": "ivory cream eggshell ice creme",
    "red": "crimson scarlet carmine ruby cherry blood burgundy claret tomato vermillion cranberry reddish cerise",
    "brown": "chocolate coffee sepia umber mocha cocoa chestnut tan beige sand khaki taupe camel caramel cinnamon "
    "leather sienna brownish fawn mud earth bronze mahogany",
    "orange": "tangerine pumpkin orangeish orangish apricot mango",
    "yellow": "gold golden lemon mustard canary sunflower banana yellowish goldenrod",
    "green": "olive lime mint sage moss forest emerald jade fern grass leaf pine seafoam greenish avocado spruce "
    "evergreen asparagus kiwi seaweed",
    "blue": "navy azure cerulean cobalt sapphire sky cyan aqua denim bluish lightblue darkblue cornflower marine "
    "ultramarine azul",
    "purple": "violet lavender lilac plum indigo eggplant grape mauve orchid aubergine amethyst purplish purpley "
    "purply",
    "pink": "magenta rose fuchsia pinkish blush watermelon bubblegum",
}
"""Last words that mean a basic term; names with other last words are left out."""

TERMS: dict[str, tuple[str, ...]] = {word: (color,) for color, words in MEANT.items() for word in words.split()}
TERMS |= MIXTURES | {color: (color,) for color in COLORS}
STEMS = {"redd": "red", "purpl": "purple", "blu": "blue", "orang": "orange"}  # of "reddish", "purply" ...


def terms_of(name: str) -> Mapping[str, float] | None:
    """Return how much a name of the survey means each basic term, 1 in all; None for a name that is left out."""
    words = name.replace("/", " ").split()
    if name.startswith(("very dark", "almost")):
        return {"black": 1.0}
    last = WHOLE_NAMES.get(name) or TERMS.get(words[-1])
    if last is None:
        return None
    weights = {term: 1 / len(last) for term in last}
    for term in () if name in WHOLE_NAMES else map(_stem, words[:-1]):
        if term in COLORS:
            weights[term] = weights.get(term, 0.0) + MODIFIER_WEIGHT
    total = sum(weights.values())
    return {term: weight / total for term, weight in weights.items()}


def _stem(word: str) -> str:
    """Return the colour of "greyish" or "bluey", other words as they are."""
    bare = next((word.removesuffix(end) for end in ("ish", "y") if word.endswith(end) and word not in COLORS), word)
    return STEMS.get(bare, bare)


def term_shares(pixels: Colors) -> Float32[np.ndarray, "n 11"]:
    """Return how far each sRGB pixel is called by each of COLORS, 1 in all."""
    red, green, blue = (pixels >> SHIFT).T
    return _cube()[red, green, blue]


@cache
def _cube() -> Float32[np.ndarray, "32 32 32 11"]:
    """Return the shares of colours on a grid of sRGB."""
    lab, weights = _survey()
    middles = (np.arange(LEVELS) + 0.5) / LEVELS
    grid = rgb2lab(np.stack(np.meshgrid(middles, middles, middles, indexing="ij"), -1)).reshape(-1, 3)
    shares = [weights[_nearest(some, lab)].mean(1) for some in np.split(grid, LEVELS)]
    return np.concatenate(shares).reshape(LEVELS, LEVELS, LEVELS, -1).astype(np.float32)


def _nearest(colors: Points, names: OtherPoints) -> np.ndarray:
    distances = deltaE_ciede2000(colors[:, None], names[None])
    return np.argpartition(distances, NEAREST_NAMES, axis=1)[:, :NEAREST_NAMES]


def _survey() -> tuple[OtherPoints, Float64[np.ndarray, "m 11"]]:
    """Return the CIELAB colours of the names that mean a basic term, and how much they mean each."""
    from matplotlib.colors import XKCD_COLORS, to_rgb

    meant = [(to_rgb(value), terms_of(name.removeprefix("xkcd:"))) for name, value in XKCD_COLORS.items()]
    used = [(rgb, terms) for rgb, terms in meant if terms is not None]
    lab = rgb2lab(np.array([[rgb for rgb, _ in used]]))[0]
    return lab, np.array([[terms.get(color, 0.0) for color in COLORS] for _, terms in used])
