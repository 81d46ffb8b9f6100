"""Fit the colours of photos: python -m world.mini.photo_colors PHOTO_FOLDER... [--rooms ROOM...] --output FILE

Gives `mini` one vector for each of the 11 colours, in the space of its image network, from masks as `graph` cuts them
on photos: those that scikit-image ships and those of the folders. A mask's colours are the shares of its pixels that
people call by each basic term (`color_names`). Each mask is met as it is and repainted, with hues turned or in
another colour, its colours counted anew, and then in another light, with shadows, highlights and haze, which change
no colour: people see the colour of a thing and not that of its light. For the same reason the brightest pixels of a
photo count as white. Of rooms of world/scenes the colours are known. The vectors are those of a softmax over cosines;
the same photos give the same vectors on one machine.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import skimage
from jaxtyping import Float32, Float64
from PIL import Image
from safetensors.numpy import save_file
from scipy.optimize import minimize
from skimage.color import lab2rgb, rgb2lab

from drsplat.base.arrays import Mask, Pixels
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.encoder import INPUT_SIDE_PIXELS
from drsplat.photos.models.mini.lexicon import COLORS
from drsplat.scene.masks.crops import crop

from .color_names import term_shares

SHIPPED_PHOTOS = (
    "astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg", "motorcycle_left.png", "motorcycle_right.png",
    "color.png", "camera.png", "coins.png", "brick.png", "grass.png", "gravel.png", "clock_motion.png",
)  # fmt: skip
MAX_PHOTOS = 14  # of a folder, evenly chosen
MIN_PIXELS = 60  # of a mask at SIDE pixels
UNCHANGED, REPAINTED = 2, 5  # times that each mask is met
WHITE_QUANTILE, MAX_GAIN = 0.98, 2.0  # of a photo's pixels, what is white there, and how much light that may take
GAMMA = 2.2
NEUTRAL_WEIGHT = 0.6  # of black, white and grey pixels: shadows and highlights of a red thing are no colours of it
SHARPNESS = 1.5  # exponent of shares: a mask is called by its main colour
MOSTLY_ONE_THING = 0.7  # share of a mask's pixels in a room that show one thing
SCALE, ITERATIONS = 40.0, 150  # of cosines in the softmax, and of L-BFGS
NEUTRAL = np.isin(COLORS, ("black", "white", "grey"))

Cut = tuple[Pixels, Mask]
Learned = tuple[Float32[np.ndarray, "n d"], Float64[np.ndarray, "n 11"]]


def cuts(photo: Pixels, segmenter: GraphSegmenter) -> Iterator[tuple[Cut, np.ndarray]]:
    """Yield the pixels and mask of each large enough segment, at SIDE pixels at most, and its part of the photo."""
    masks = segmenter.segment(photo)["large"]
    for number, (part, box) in enumerate(zip(masks.parts, masks.boxes, strict=True)):
        x0, y0, x1, y1 = box.tolist()
        scale = min(1, INPUT_SIDE_PIXELS / max(x1 - x0, y1 - y0))
        size = max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale))
        mask = np.asarray(Image.fromarray(part.astype(np.uint8) * 255).resize(size, Image.Resampling.BOX)) >= 128
        pixels = Image.fromarray(photo[y0:y1, x0:x1]).resize(size, Image.Resampling.BOX)
        if mask.sum() >= MIN_PIXELS:
            yield (np.asarray(pixels), mask), masks.full(number)


def repainted(cut: Cut, palette: Sequence[np.ndarray], rng: np.random.Generator) -> Cut:
    """Return a cut in another colour, with turned hues or as it is. palette: CIELAB colours of each term."""
    pixels, mask = cut
    lab = rgb2lab(pixels)
    kind = rng.random()
    if kind < 0.45:
        colors = palette[int(rng.integers(len(palette)))]
        lab = _painted(lab, lab[mask].mean(0), colors[rng.integers(len(colors))] + rng.normal(0, 4, 3), rng)
    elif kind < 0.8:
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        lab = np.concatenate([lab[..., :1], lab[..., 1:] @ turn * np.exp(rng.uniform(-0.7, 0.7))], -1)
    return (np.clip(_rgb_of(lab), 0, 1) * 255).astype(np.uint8), mask


def in_other_light(cut: Cut, rng: np.random.Generator) -> Cut:
    """Return a cut under another white balance and exposure, some with a shadow, shading or a highlight, and noise."""
    pixels, mask = cut
    lit = np.clip(_lit((pixels / 255) ** GAMMA, rng), 0, 1) ** (1 / GAMMA) * 255 + rng.normal(0, 2, pixels.shape)
    return np.clip(lit, 0, 255).astype(np.uint8), mask


def _painted(lab: np.ndarray, middle: np.ndarray, color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return CIELAB pixels around another colour, with shades of their own, darker ones less colourful."""
    light = color[0] + (lab[..., :1] - middle[0]) * rng.uniform(0.4, 1.1)
    hues = color[1:] * np.clip(light / max(color[0], 5), 0.2, 1.3) + (lab[..., 1:] - middle[1:]) * rng.uniform(0, 1)
    return np.concatenate([light, hues], -1)


def _rgb_of(lab: np.ndarray) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colours that no screen shows are clipped
        return lab2rgb(np.clip(lab, [0, -110, -110], [100, 110, 110]))


def _lit(linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    linear = linear * np.exp(rng.normal(0, 0.08, 3)) * np.exp(rng.uniform(-0.6, 0.3)) + rng.uniform(0, 0.03)
    height, width = linear.shape[:2]
    y, x = np.mgrid[:height, :width] / [[[height]], [[width]]]
    angle, kind = rng.uniform(0, 2 * np.pi), rng.random()
    along = (x - 0.5) * np.cos(angle) + (y - 0.5) * np.sin(angle)
    if kind < 0.3:
        linear = linear * np.where(along > rng.uniform(-0.3, 0.3), rng.uniform(0.25, 0.8), 1)[..., None]
    elif kind < 0.5:
        linear = linear * np.exp(along * rng.uniform(-1.5, 1.5))[..., None]
    if rng.random() < 0.25:
        from_spot = ((x - rng.random()) ** 2 + (y - rng.random()) ** 2) / rng.uniform(0.005, 0.05)
        linear = linear + rng.uniform(0.3, 1) * np.exp(-from_spot)[..., None]
    return linear


def wanted(cut: Cut) -> Float64[np.ndarray, " 11"]:
    """Return how much a cut should be called by each colour, 1 in all."""
    pixels, mask = cut
    shares = term_shares(pixels[mask]).mean(0, dtype=np.float64) * np.where(NEUTRAL, NEUTRAL_WEIGHT, 1)
    sharp = (shares / shares.sum()) ** SHARPNESS
    return sharp / sharp.sum()


def embedded(some: Sequence[Cut], encoder: MiniEncoder) -> Float32[np.ndarray, "n d"]:
    """Return the embeddings of cuts, cropped as masks are."""
    return encoder.encode_images([crop(pixels, mask, (0, 0, *mask.shape[::-1])) for pixels, mask in some])


def learned_from_photos(photos: Iterable[Path], encoder: MiniEncoder, seed: int = 0) -> Learned:
    """Return the embeddings and colours of the masks of photos, as they are and repainted."""
    segmenter, rng, palette = GraphSegmenter(), np.random.default_rng(seed), _palette()
    plain: list[Cut] = []
    seen: list[Cut] = []
    for photo in map(_read, photos):
        some = [cut for cut, _ in cuts(photo, segmenter)]
        gain = gain_of(photo)
        plain += some
        seen += [(_exposed(pixels, gain), mask) for pixels, mask in some]
    painted = [repainted(cut, palette, rng) for _ in range(REPAINTED) for cut in seen]
    shown = plain * UNCHANGED + [in_other_light(cut, rng) for cut in painted]
    return embedded(shown, encoder), np.stack([wanted(cut) for cut in seen * UNCHANGED + painted])


def gain_of(photo: Pixels) -> float:
    """Return how many times brighter the linear pixels would be if the brightest were white: eyes adapt to that."""
    brightest = max(float(np.quantile(photo.max(2), WHITE_QUANTILE)), 1.0) / 255
    return float(np.clip(brightest**-GAMMA, 1, MAX_GAIN))


def _exposed(pixels: Pixels, gain: float) -> Pixels:
    return np.clip(pixels * gain ** (1 / GAMMA), 0, 255).astype(np.uint8)


def learned_from_room(folder: Path, encoder: MiniEncoder) -> Learned:
    """Return the embeddings and true colours of the masks of every third photo of a packed room."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    colors = {thing["id"]: COLORS.index(thing["color"]) for thing in truth["objects"]}
    segmenter, some, right = GraphSegmenter(), [], []
    for photo in sorted((folder / "images").iterdir())[::3]:
        ids = np.asarray(Image.open(folder / "ids" / f"{photo.stem}.png")).astype(np.int64)
        for cut, full in cuts(_read(photo), segmenter):
            counts = np.bincount(ids[full])
            thing = int(counts.argmax()) - 1
            if counts.max() >= MOSTLY_ONE_THING * counts.sum() and thing in colors:
                some.append(cut)
                right.append(colors[thing])
    every = np.eye(len(COLORS))[right]
    return np.tile(embedded(some, encoder), (UNCHANGED, 1)), np.tile(every, (UNCHANGED, 1))


def fitted(embeddings: Float32[np.ndarray, "n d"], shares: Float64[np.ndarray, "n 11"]) -> Float32[np.ndarray, "11 d"]:
    """Return the unit vectors whose softmax over cosines is nearest to the shares, all colours being as frequent."""
    pictures = embeddings.astype(np.float64)
    weights = (shares / shares.sum(0)).sum(1, keepdims=True) / len(COLORS)

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        free = flat.reshape(len(COLORS), -1)
        norms = np.linalg.norm(free, axis=1, keepdims=True)
        units = free / norms
        logits = SCALE * pictures @ units.T
        logs = logits - np.logaddexp.reduce(logits, axis=1, keepdims=True)
        slopes = SCALE * (weights * (np.exp(logs) - shares)).T @ pictures
        slopes = (slopes - (slopes * units).sum(1, keepdims=True) * units) / norms
        return -float((weights * shares * logs).sum()), slopes.ravel()

    start = shares.T @ pictures - shares.sum(0)[:, None] * pictures.mean(0)
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    best = minimize(loss, start.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
    vectors = best.x.reshape(len(COLORS), -1)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


def _palette() -> list[np.ndarray]:
    """Return CIELAB colours of each term: those of a grid that are mostly called so."""
    levels = np.arange(4, 256, 24, dtype=np.uint8)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1).reshape(-1, 3)
    shares = term_shares(grid)
    return [rgb2lab(grid[None, shares[:, term] > 0.5] / 255)[0] for term in range(len(COLORS))]


def _read(path: Path) -> Pixels:
    return np.asarray(Image.open(path).convert("RGB"))


def _photos_in(folder: Path) -> list[Path]:
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".jpg", ".jpeg", ".png"))
    return [found[row] for row in np.unique(np.linspace(0, len(found) - 1, MAX_PHOTOS).astype(int))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path, nargs="*")
    parser.add_argument("--rooms", type=Path, nargs="*", default=[])
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    encoder = MiniEncoder()
    shipped = [Path(skimage.__file__).parent / "data" / name for name in SHIPPED_PHOTOS]
    parts = [learned_from_photos([*shipped, *(p for one in arguments.photos for p in _photos_in(one))], encoder)]
    parts += [learned_from_room(room, encoder) for room in arguments.rooms]
    embeddings, shares = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    vectors = fitted(embeddings, shares)
    save_file({"photo_colors": vectors}, arguments.output)
    told = (embeddings @ vectors.T).argmax(1) == shares.argmax(1)
    print(f"{len(embeddings)} crops, of {told[shares.max(1) > 0.5].mean():.3f} that have one main colour it is nearest")


if __name__ == "__main__":
    main()
