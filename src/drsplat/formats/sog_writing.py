"""Writing SOG, version 2: lossless WebP pictures of quantised planes, the format of PlayCanvas and SuperSplat.

Rows follow a Morton curve, which the format asks for, so they are others than those of the scene. The object and the
relevancy of each Gaussian, which the format has no place for, are pictures of their own beside those of the format,
and names and boxes a JSON; `meta.json` names the three under "drsplat", a key that other readers step over.

Positions are 16 bits an axis of a logarithm over the extent of the scene, rotations 8 bits a component. Scales and
colours are each of a codebook of 256, further harmonics of a palette of 65,536 whose numbers are of another codebook.
The same bytes for the same scene.

Source: developer.playcanvas.com, "The SOG Format".
"""

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..base.arrays import (
    Array,
    ByteRows,
    ByteValues,
    Doubles,
    Embeddings,
    Float32,
    Harmonics,
    Numbers,
    OtherEmbeddings,
    Quats,
    SmallIds,
    UInt8,
    Vectors,
)
from ..errors import InputError
from ..kernels import pq_encode
from ..kernels.kmeans import train_centroids
from ..scene.gaussians import Gaussians
from ..scene.labelled import LabelledScene
from ..scene.morton import morton_order
from .activation import refuse_unwritable
from .labels import has_labels, labels_bytes
from .sog import ANTIALIASED, MAX_PALETTE_ENTRIES, META, OWN, PALETTE_ROW_ENTRIES, SURFELS

VERSION, GENERATOR = 2, "drsplat"
CODEBOOK_ENTRIES = 256
LLOYD_STEPS = 12  # for a codebook of single numbers
HISTOGRAM_BINS = 4096  # likewise
CELL_ROWS = 2048  # of a cell of the palette's rows, whose entries are learnt together
FIRST_TAG = 252  # of the largest component of a rotation
MAX_OBJECT_ID = (1 << 24) - 2  # three bytes, 0 for none
OTHER_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # of a rotation, by the largest
MAX_ROWS = 1 << 26
SEED = 0
Importance = Callable[[np.ndarray], np.ndarray]  # of ascending values, what a squared error weighs there
LABELS, OBJECTS, RELEVANCIES = "drsplat_labels.json", "drsplat_objects.webp", "drsplat_relevancy.webp"


def sog_bytes(scene: LabelledScene) -> bytes:
    """Encode a scene as a bundled SOG, a ZIP of `sog_files`. Raises: InputError: as `sog_files`."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        for name, content in sog_files(scene).items():
            archive.writestr(zipfile.ZipInfo(name), content)  # of 1980, so the same bytes at any time
    return out.getvalue()


def sog_files(scene: LabelledScene) -> dict[str, bytes]:
    """Encode a scene as the files of an unpacked SOG, by name; meta.json comes first.

    Positions are written relative to the scene's `origin`, which our reader adds again.

    Raises: InputError: a scene without Gaussians, or too many for the format's pictures or for an object's number.
    """
    count = len(scene.gaussians)
    if not 0 < count <= MAX_ROWS:
        raise InputError(f"SOG: expected 1 to {MAX_ROWS:,} Gaussians, got {count:,}: cut the scene into tiles")
    refuse_unwritable(scene.gaussians)
    gaussians = replace(scene.gaussians, extra=scene.columns).subset(morton_order(scene.gaussians.means))
    return ordered_files(gaussians, labels_bytes(scene) if has_labels(scene) else b"")


def ordered_files(gaussians: Gaussians, labels: bytes = b"") -> dict[str, bytes]:
    """Encode Gaussians in their order, which is along a Morton curve, as the files of an unpacked SOG.

    Args:
        gaussians: the extra columns "object_id" and "relevancy" go along, others do not.
        labels: the names of the objects, as `labels_bytes` writes them; none if empty.

    Raises: InputError: too many objects for the numbers of a picture.
    """
    own, own_files = _own_parts(gaussians, labels)
    means, mean_files = _means(gaussians.means)
    scales, scale_codes = coded(np.log(gaussians.scales), sizes)
    colours, colour_codes = coded(gaussians.sh[:, 0])
    alpha = np.rint(gaussians.opacities * 255).astype(np.uint8)
    further, further_files = _further(gaussians.sh[:, 1:])
    model = SURFELS if gaussians.surfels else ANTIALIASED if gaussians.antialiased else ""
    meta: dict[str, object] = {
        "version": VERSION,
        "asset": {"generator": GENERATOR},
        "count": len(gaussians),
        **({"model": model} if model else {}),
        "means": means,
        "scales": {"codebook": scales, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colours, "files": ["sh0.webp"]},
        **further,
        **own,
    }
    return {
        META: json.dumps(meta, separators=(",", ":")).encode(),
        **mean_files,
        "quats.webp": picture(_quats(gaussians.quats)),
        "scales.webp": picture(scale_codes),
        "sh0.webp": picture(np.column_stack([colour_codes, alpha])),
        **further_files,
        **own_files,
    }


def picture(rows: ByteRows, width: int = 0) -> bytes:
    """Encode rows of up to four bytes as the pixels of a lossless WebP; missing bytes are 0, and alpha 255."""
    from PIL import Image

    side = width or -(-int(np.ceil(np.sqrt(len(rows)))) // 4) * 4
    height = -(-len(rows) // side)
    height, width = height if width else -(-height // 4) * 4, side
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(rows), : rows.shape[1]] = rows
    out = io.BytesIO()
    Image.fromarray(pixels.reshape(height, width, 4)).save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def coded(
    values: Float32[Array, "..."], importance: Importance = np.ones_like
) -> tuple[list[float], UInt8[Array, "..."]]:
    """Return a codebook of 256 numbers, ascending, and the nearest of them for each value; see `codebook`."""
    book = codebook(values, importance)
    codes = np.searchsorted((book[1:] + book[:-1]) / 2, values.astype(np.float64)).astype(np.uint8)
    return [float(number) for number in book.astype(np.float32)], codes


def codebook(values: Float32[Array, "..."], importance: Importance = np.ones_like) -> Doubles:
    """Return the weighted k-means of single numbers, by Lloyd's algorithm on the sorted values.

    At most 256 distinct values are kept exactly. Cells of sorted numbers are runs, so a step costs 256 look-ups. The
    start is near the best already: of many codes as dense as the cube root of what values there weigh.

    importance: what a squared error weighs at each value.
    Source: Panter and Dite (1951), "Quantization distortion in pulse-count modulation with nonuniform spacing".
    """
    ascending = np.sort(values, axis=None).astype(np.float64)
    distinct = ascending[np.concatenate([[True], ascending[1:] > ascending[:-1]])]
    if len(distinct) <= CODEBOOK_ENTRIES:
        return np.pad(distinct, (0, CODEBOOK_ENTRIES - len(distinct)), mode="edge")
    weights = importance(ascending)
    masses, moments = (np.concatenate([[0.0], np.cumsum(part)]) for part in (weights, weights * ascending))
    counted, edges = np.histogram(ascending, HISTOGRAM_BINS, weights=weights)
    reached = np.concatenate([[0.0], np.cumsum(np.cbrt(counted))])
    book: Array = np.interp((np.arange(CODEBOOK_ENTRIES) + 0.5) / CODEBOOK_ENTRIES * reached[-1], reached, edges)
    for _ in range(LLOYD_STEPS):
        ends = np.concatenate([[0], np.searchsorted(ascending, (book[1:] + book[:-1]) / 2), [len(ascending)]])
        mass, moment = (sums[ends[1:]] - sums[ends[:-1]] for sums in (masses, moments))
        book = np.where(mass > 0, moment / np.where(mass > 0, mass, 1), book)
    return np.sort(book)


def sizes(logs: Doubles) -> Doubles:
    """Return what squared errors of logarithms of scales weigh: the scale.

    It lies between the logarithm alone, which weighs 1, and what a picture sees: edges move by the error times the
    scale, squared, which would leave thin Gaussians with hardly a code.
    """
    return np.exp(logs)


def _means(means: Vectors) -> tuple[dict[str, object], dict[str, bytes]]:
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    files = {"means_l.webp": picture(steps.astype(np.uint8)), "means_u.webp": picture((steps >> 8).astype(np.uint8))}
    return {"mins": low.tolist(), "maxs": high.tolist(), "files": list(files)}, files


def _quats(quats: Quats) -> UInt8[Array, "n 4"]:
    largest = np.abs(quats).argmax(1)
    signs = np.where(np.take_along_axis(quats, largest[:, None], 1) < 0, -1, 1)
    three = np.take_along_axis(quats, OTHER_COMPONENTS[largest], 1) * signs * np.sqrt(2)
    steps = np.clip(np.rint((three * 0.5 + 0.5) * 255), 0, 255)
    return np.column_stack([steps, FIRST_TAG + largest]).astype(np.uint8)


def _further(rest: Harmonics) -> tuple[dict[str, object], dict[str, bytes]]:
    """Encode harmonics beyond the constant one as a palette and a label of each row."""
    coefficients = rest.shape[1]
    if not coefficients:
        return {}, {}
    palette, labels = harmonics_palette(rest.reshape(len(rest), -1))
    book, codes = coded(palette)
    entries = codes.reshape(-1, 3)
    width = PALETTE_ROW_ENTRIES * coefficients
    padded = np.zeros((-(-len(entries) // width) * width, 3), np.uint8)
    padded[: len(entries)] = entries
    files = {
        "shN_centroids.webp": picture(padded, width),
        "shN_labels.webp": picture(np.column_stack([labels.astype(np.uint8), (labels >> 8).astype(np.uint8)])),
    }
    bands = {3: 1, 8: 2, 15: 3}[coefficients]
    return {"shN": {"count": len(palette), "bands": bands, "codebook": book, "files": list(files)}}, files


def harmonics_palette(rows: Embeddings) -> tuple[OtherEmbeddings, SmallIds]:
    """Return at most 65,536 entries and the entry of each row; the rows themselves where they are no more.

    Otherwise 256 cells of 256 entries, k-means of k-means, so that a row is compared with 512 centroids.
    """
    if len(rows) <= MAX_PALETTE_ENTRIES:
        palette, labels = np.unique(rows, axis=0, return_inverse=True)
        return palette, labels.reshape(-1).astype(np.uint16)
    rows = np.ascontiguousarray(rows)
    cell_of = _nearest(rows, _centroids(rows, MAX_PALETTE_ENTRIES))
    palette, labels = np.empty((0, rows.shape[1]), np.float32), np.empty(len(rows), np.int64)
    parts = []
    start = 0
    for cell in range(CODEBOOK_ENTRIES):
        own = np.flatnonzero(cell_of == cell)
        if len(own):
            entries = _centroids(rows[own], CELL_ROWS)
            used, labels_here = np.unique(_nearest(rows[own], entries), return_inverse=True)
            labels[own] = start + labels_here.reshape(-1)
            parts.append(entries[used])
            start += len(used)
    palette = np.concatenate(parts)
    return palette, labels.astype(np.uint16)


def _centroids(rows: Embeddings, most: int) -> OtherEmbeddings:
    """Return 256 k-means of at most so many of the rows, evenly chosen."""
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(np.int64)
    return train_centroids(np.ascontiguousarray(rows[chosen]), 1, SEED)[0]


def _nearest(rows: Embeddings, centroids: OtherEmbeddings) -> ByteValues:
    return pq_encode(np.ascontiguousarray(rows), centroids[None])[:, 0]


def _own_parts(gaussians: Gaussians, labels: bytes) -> tuple[dict[str, object], dict[str, bytes]]:
    """Encode what the format has no place for: objects, relevancy and an origin."""
    part: dict[str, object] = {"version": 1}
    files: dict[str, bytes] = {}
    if gaussians.origin.any():
        part["origin"] = gaussians.origin.tolist()
    if labels:
        part["labels"], files[LABELS] = LABELS, labels
    if "object_id" in gaussians.extra:
        # encode numbers of objects, increased by 1, as three bytes, the lowest first
        object_of = gaussians.extra["object_id"]
        if object_of.max() > MAX_OBJECT_ID:
            raise InputError(f"SOG: expected at most {MAX_OBJECT_ID + 1:,} objects, got the number {object_of.max():,}")
        ids = object_of.astype(np.int64) + 1
        rows = np.column_stack([(ids >> shift).astype(np.uint8) for shift in (0, 8, 16)])
        part["object_id"], files[OBJECTS] = ({"files": [OBJECTS]}, picture(rows))
    if "relevancy" in gaussians.extra:
        part["relevancy"], files[RELEVANCIES] = _relevancy(gaussians.extra["relevancy"])
    return ({OWN: part} if len(part) > 1 else {}), files


def _relevancy(relevancy: Numbers) -> tuple[Mapping[str, object], bytes]:
    """Encode relevancies as 16 bits between the least and the greatest."""
    low, high = float(relevancy.min()), float(relevancy.max())
    steps = np.rint((relevancy.astype(np.float64) - low) / max(high - low, 1e-30) * 65535).astype(np.uint16)
    rows = np.column_stack([steps.astype(np.uint8), (steps >> 8).astype(np.uint8)])
    return {"min": low, "max": high, "files": [RELEVANCIES]}, picture(rows)
