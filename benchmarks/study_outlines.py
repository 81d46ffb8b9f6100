"""How good outlines of photos are: against HED's edges, and by the regions that they bound.

    python benchmarks/study_outlines.py CAPTURE... [--maps MAPS] [--pictures FOLDER]

CAPTURE: a folder with images/ whose things are outlined (`tests/support/*_outlines.json`). MAPS: HED's edges of its
photos, as `python -m world.outlines.teacher` writes them. The rivals: HED where there are maps, the network that ships
(`photos/models/outlines`), the borders that `graph`'s network sees, both also in the photo at one size alone, a plain
gradient of colours, and for regions the masks of `graph`. The first table holds each against HED's edges of half a
strength or more, thinned, within TOLERANCE_PIXELS; the second says how well the best region of a hierarchy fits each
outlined thing, and by how much better than with `outlines`, with the standard error of that difference. A hierarchy is
a watershed of the strength, whose regions are merged by the mean strength of their common border, weakest first.
FOLDER gets pictures: photo, HED, outlines, `graph`.
"""

import argparse
import heapq
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage
from skimage.color import rgb2lab
from skimage.morphology import skeletonize
from skimage.segmentation import watershed

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe, interleaved
from benchmarks.suite.outlines import iou, outlines_path, read_outlines
from benchmarks.suite.tables import markdown
from drsplat.drawing.pictures import contact_sheet, write_picture
from drsplat.kernels.photo_regions import BORDER_STEPS
from drsplat.kernels.photo_regions import look as look_through
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.graph.segmenter import look, shipped_network, working_image
from drsplat.photos.models.outlines import outlines, shipped_outlines

TOLERANCE_PIXELS = 3
THRESHOLDS = 24  # at which edges are compared, at even shares of a rival's pixels
FLAT = 0.02  # strength below which everything is one basin


class Shown(NamedTuple):
    """A photo at the size that is worked at. truth: HED's strength, None without maps. things: outlined, by name."""

    capture: str
    name: str
    image: np.ndarray
    truth: np.ndarray | None
    things: Mapping[str, np.ndarray]


def shown(capture: Path, maps: Path | None) -> Iterator[Shown]:
    """Yield the photos that have outlined things or a map."""
    drawn = read_outlines(outlines_path(capture.name))
    for path in sorted((capture / "images").iterdir()):
        stored = maps / f"{path.stem}.npy" if maps else None
        truth = np.load(stored).astype(np.float32) / 255 if stored and stored.exists() else None
        if path.name in drawn or truth is not None:
            photo = np.asarray(Image.open(path).convert("RGB"))
            image, corners = working_image(photo), drawn.get(path.name, {})
            scale = np.divide(image.shape[1::-1], photo.shape[1::-1])
            things = {thing: filled(np.array(c) * scale, image.shape[:2]) for thing, c in corners.items()}
            yield Shown(capture.name, path.stem, image, truth, things)


def filled(corners: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    drawn = Image.new("L", size[::-1])
    ImageDraw.Draw(drawn).polygon([(x, y) for x, y in corners], fill=1)
    return np.asarray(drawn, bool)


def of_graph(image: np.ndarray) -> np.ndarray:
    return look(image, shipped_network()[0]).borders.astype(np.float32) / BORDER_STEPS


def of_one_size(image: np.ndarray) -> np.ndarray:
    return look_through(image, shipped_outlines()[0]).borders.astype(np.float32) / BORDER_STEPS


def of_graph_at_both_sizes(image: np.ndarray) -> np.ndarray:
    """As `outlines` looks at a photo."""
    size = image.shape[1::-1]
    half = Image.fromarray(image).resize([(side + 1) // 2 for side in size], Image.Resampling.BOX)
    enlarged = Image.fromarray(of_graph(np.asarray(half))).resize(size, Image.Resampling.BILINEAR)
    return (of_graph(image) + np.asarray(enlarged)) / 2


def gradient(image: np.ndarray) -> np.ndarray:
    """Steepest slope of CIELAB under a Gaussian of one pixel, the hundredth highest as 1."""
    lab = rgb2lab(image)
    slopes = [ndimage.gaussian_gradient_magnitude(lab[..., c], 1) for c in range(3)]
    steep = np.linalg.norm(slopes, axis=0)
    return np.clip(steep / np.quantile(steep, 0.99), 0, 1).astype(np.float32)


RIVALS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "outlines": outlines, "outlines at one size": of_one_size, "`graph`'s borders": of_graph_at_both_sizes,
    "`graph`'s borders at one size": of_graph, "gradient": gradient,
}  # fmt: skip


def agreement(pairs: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float, float]:
    """Return average precision, best F and correlation of (strength, truth) of several photos."""
    values = np.concatenate([strength.ravel() for strength, _ in pairs])
    cuts = np.unique(np.quantile(values, 1 - np.geomspace(0.01, 0.6, THRESHOLDS)))[::-1]
    truths = [skeletonize(truth >= 0.5) for _, truth in pairs]
    far = [ndimage.distance_transform_edt(~truth) for truth in truths]
    counts = np.zeros((len(cuts), 3))  # edges found, of them true, true ones that are found
    for (strength, _), truth, distance in zip(pairs, truths, far, strict=True):
        for row, cut in zip(counts, cuts, strict=True):
            found = skeletonize(strength >= cut)
            reached = ndimage.distance_transform_edt(~found)[truth] <= TOLERANCE_PIXELS
            row += found.sum(), (distance[found] <= TOLERANCE_PIXELS).sum(), reached.sum()
    precision = counts[:, 1] / np.maximum(counts[:, 0], 1)
    recall = np.maximum.accumulate(counts[:, 2] / sum(truth.sum() for truth in truths))
    best = (2 * precision * recall / np.maximum(precision + recall, 1e-9)).max()
    correlations = [np.corrcoef(strength.ravel(), truth.ravel())[0, 1] for strength, truth in pairs]
    return float(np.sum(np.diff(recall, prepend=0) * precision)), float(best), float(np.mean(correlations))


def basins(strength: np.ndarray) -> np.ndarray:
    """Return the number of each pixel's region, from 0, by watershed."""
    smooth = ndimage.gaussian_filter(strength, 1)
    markers, _ = ndimage.label(smooth <= np.maximum(ndimage.minimum_filter(smooth, 7), FLAT))
    labels: np.ndarray = watershed(smooth, markers) - 1
    return labels


def borders(labels: np.ndarray, strength: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """Return, of each two regions that touch, the sum of strengths across their border and its length."""
    sides = np.s_[:, :-1], np.s_[:, 1:], np.s_[:-1], np.s_[1:]
    ends = [np.stack([labels[a], labels[b]], -1).reshape(-1, 2) for a, b in (sides[:2], sides[2:])]
    height = [np.maximum(strength[a], strength[b]).ravel() for a, b in (sides[:2], sides[2:])]
    pairs, values = np.sort(np.concatenate(ends), axis=1), np.concatenate(height)
    apart = pairs[:, 0] != pairs[:, 1]
    unique, number = np.unique(pairs[apart], axis=0, return_inverse=True)
    sums, lengths = np.bincount(number.ravel(), values[apart]), np.bincount(number.ravel())
    return {(int(a), int(b)): np.array(both) for (a, b), *both in zip(unique, sums, lengths, strict=True)}


def merges(count: int, between: Mapping[tuple[int, int], np.ndarray]) -> Iterator[tuple[int, int]]:
    """Yield which two become one, of the weakest common border first; it gets the next number after `count`."""
    beside: dict[int, dict[int, np.ndarray]] = {node: {} for node in range(count)}
    for (a, b), border in between.items():
        beside[a][b] = beside[b][a] = border
    queue = [(border[0] / border[1], a, b) for (a, b), border in between.items()]
    heapq.heapify(queue)
    while queue:
        _, a, b = heapq.heappop(queue)
        if a not in beside or b not in beside:
            continue
        yield a, b
        joined: dict[int, np.ndarray] = {}
        for one, other in ((a, b), (b, a)):
            for neighbour, border in beside.pop(one).items():
                if neighbour != other:
                    beside[neighbour].pop(one)
                    joined[neighbour] = joined.get(neighbour, 0) + border
        for neighbour, border in joined.items():
            beside[neighbour][count] = border
            heapq.heappush(queue, (border[0] / border[1], neighbour, count))
        beside[count] = joined
        count += 1


def best_fits(strength: np.ndarray, things: Mapping[str, np.ndarray]) -> list[float]:
    """Return the best IoU of each thing with a region of the hierarchy."""
    labels = basins(strength)
    count = int(labels.max()) + 1
    areas = list(np.bincount(labels.ravel(), minlength=count))
    inside = list(np.stack([np.bincount(labels[mask], minlength=count) for mask in things.values()], 1))
    for a, b in merges(count, borders(labels, strength)):
        areas.append(areas[a] + areas[b])
        inside.append(inside[a] + inside[b])
    whole = np.array([mask.sum() for mask in things.values()])
    both = np.array(inside)
    fits: np.ndarray = (both / (np.array(areas)[:, None] + whole - both)).max(0)
    return list(map(float, fits))


def fits_of_graph(image: np.ndarray, things: Mapping[str, np.ndarray]) -> list[float]:
    masks = GraphSegmenter().segment(image)["large"]
    return [max(iou(masks.full(i), thing) for i in range(len(masks))) for thing in things.values()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--maps", type=Path)
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    print(describe())
    photos = [one for capture in arguments.captures for one in shown(capture.resolve(), arguments.maps)]
    strengths = {name: [rival(photo.image) for photo in photos] for name, rival in RIVALS.items()}
    if any(photo.truth is not None for photo in photos):
        edges_table(photos, strengths)
    regions_table(photos, strengths)
    timed(photos[0].image)
    if arguments.pictures:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
        for photo, *seen in zip(photos, strengths["outlines"], strengths["`graph`'s borders"], strict=True):
            grey = [np.uint8(255 * (1 - strength)) for strength in (photo.truth, *seen) if strength is not None]
            sheet = contact_sheet([photo.image, *(np.repeat(one[..., None], 3, axis=2) for one in grey)], 2)
            write_picture(arguments.pictures / f"{photo.capture}_{photo.name}.jpg", sheet, overwrite=True)


def edges_table(photos: list[Shown], strengths: Mapping[str, list[np.ndarray]]) -> None:
    mapped = [i for i, photo in enumerate(photos) if photo.truth is not None]
    places = Counter(photos[i].capture for i in mapped)
    rows = []
    for name, seen in ({"HED": [photo.truth for photo in photos]} | strengths).items():
        pairs = [[(seen[i], photos[i].truth) for i in mapped if photos[i].capture == place] for place in places]
        rows.append((name, *(", ".join(f"{score:.2f}" for score in agreement(some)) for some in pairs)))
    print("\naverage precision, best F, correlation with HED, by capture (photos):\n")
    print(markdown(("", *(f"{place} ({count})" for place, count in places.items())), rows))


def regions_table(photos: list[Shown], strengths: Mapping[str, list[np.ndarray]]) -> None:
    chosen = [i for i, photo in enumerate(photos) if photo.things]
    known = {"HED": [photo.truth for photo in photos]} if all(photos[i].truth is not None for i in chosen) else {}
    fits = {name: [best_fits(seen[i], photos[i].things) for i in chosen] for name, seen in (known | strengths).items()}
    fits["masks of `graph`"] = [fits_of_graph(photos[i].image, photos[i].things) for i in chosen]
    captures = np.repeat([photos[i].capture for i in chosen], [len(photos[i].things) for i in chosen])
    places, usual = Counter(captures.tolist()), np.concatenate(fits["outlines"])
    rows = []
    for name, found in fits.items():
        values = np.concatenate(found)
        parts = [*(values[captures == place] for place in places), values]
        gains = values - usual
        gain = f"{gains.mean():+.3f} ± {gains.std() / len(gains) ** 0.5:.3f}"
        rows.append((name, *(f"{part.mean():.3f} ({(part > 0.7).mean():.2f})" for part in parts), gain))
    print("\nmean IoU of the best region (share above 0.7), by capture (outlines), and better than outlines by:\n")
    heads = *(f"{place} ({count})" for place, count in places.items()), f"all ({len(usual)})", "better by"
    print(markdown(("", *heads), rows))


def timed(image: np.ndarray) -> None:
    for threads in (1, 2):
        rival = {"outlines": lambda threads=threads: outlines(image, threads=threads)}
        print(f"\n{threads} threads: {np.median(interleaved(rival, 5)['outlines']):.3f} s, {image.shape[:2]}")


if __name__ == "__main__":
    main()
