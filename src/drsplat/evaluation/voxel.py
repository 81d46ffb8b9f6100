"""voxel@1: volumes by Eq. 4, which significance approximates.

A voxel's score for a label is the sum of alpha_i N(v | mu_i, Sigma_i) over the Gaussians that have it, v
the voxel's centre. Voxels with too small a sum are empty; the others have the label of the highest
score. Truth and prediction are compared voxel by voxel. `study` is Fig. S3.

Source: Dr. Splat Sec. C "Volume awareness of the proposed metric".
"""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Array, DoubleRows, Doubles, Ids, Indices, Int64, OtherIds, OtherIndices, Points, Vector3
from ..base.contents import Document
from ..errors import InputError
from ..scene.gaussians import Gaussians
from . import scannet_volume, scorers
from .predictions import read_manifests
from .scannet import ScannetScene, over_scenes, predict_classes, predicted_classes, segmentation_record

PROTOCOL = "voxel@1"
VOXEL_SIDE = 0.05  # scene units; ScanNet's are metres
MIN_MASS = 1e-3  # sum of alpha N(v) times the volume of a voxel
CUT_OFF_SIGMAS = 3.0
MAX_VOXELS = 1 << 27
SLAB_SCORES = 1 << 22
MAX_PAIRS = 1 << 19
MIN_SCENES = 8

predict = partial(predict_classes, protocol=PROTOCOL)


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Grid of cubes; `origin` is the low corner of the first."""

    origin: Vector3
    side: float
    shape: tuple[int, int, int]

    @property
    def centers(self) -> Points:
        """Centres of the voxels, x slowest, in the order of `voxel_labels`."""
        at = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), -1).reshape(-1, 3)
        return self.origin + (at + 0.5) * self.side


def grid_over(positions: Array, side: float = VOXEL_SIDE) -> VoxelGrid:
    """Return voxels that cover points. Raises: InputError: no positive side, or too many voxels for memory."""
    if not side > 0:
        raise InputError(f"voxel side: expected a positive length, got {side}")
    low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
    shape = np.floor((high - low) / side) + 1
    if shape.prod() > MAX_VOXELS:
        raise InputError(
            f"voxels of {side:g} would be {shape.prod():.3g}: give a longer side than "
            f"{side * (shape.prod() / MAX_VOXELS) ** (1 / 3):.3g}"
        )
    return VoxelGrid(low, side, (int(shape[0]), int(shape[1]), int(shape[2])))


def voxel_labels(
    gaussians: Gaussians, labellings: Sequence[Ids], num_labels: int, grid: VoxelGrid, *, threads: int = 0
) -> list[OtherIds]:
    """Return, for each labelling, the label of every voxel, 0 to num_labels - 1; -1 where it is empty.

    Ties go to the lowest label. Each Gaussian counts within three standard deviations. Slabs of voxels are processed in
    turn to bound memory; the result is the same for any number of threads.

    Source: Dr. Splat Eq. 4.
    """
    sources = _Sources(gaussians, grid)
    rows = max(1, SLAB_SCORES // (grid.shape[1] * grid.shape[2] * num_labels))
    slabs = [(x, min(x + rows, grid.shape[0])) for x in range(0, grid.shape[0], rows)]
    work = partial(_slab, sources, labellings, num_labels)
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        parts = list(pool.map(work, slabs))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def score(scenes: Sequence[ScannetScene], folder: Path, *, side: float = VOXEL_SIDE, threads: int = 0) -> Document:
    """Score predictions in voxels, and beside it by Eq. 3 with and without significance.

    Predictions of scannet-volume@1 are read, too. The study's correlations are NaN below 3 scenes.

    Raises: InputError: no scene, or one without predictions. FormatError: damaged predictions.
    """
    manifests = read_manifests(folder, [scene.name for scene in scenes], PROTOCOL, scannet_volume.PROTOCOL)
    by_scene = {scene.name: voxel_record(scene, folder, side=side, threads=threads) for scene in scenes}
    compared = [
        {
            "scene": scene.name,
            "voxel": by_scene[scene.name]["miou"],
            "weighted": scannet_volume.segmentation(scene, folder)["miou"],
            "unweighted": scannet_volume.segmentation(scene, folder, weighted=False)["miou"],
        }
        for scene in scenes
    ]
    return {
        "protocol": PROTOCOL,
        "method": manifests[0].method,
        "label_set": scenes[0].labels.name,
        "thresholds": {"argmax": "the class of the highest score; no threshold"},
        "voxel_side": side,
        "segmentation": {"scene_macro": over_scenes(list(by_scene.values()), ("miou", "macc")), "by_scene": by_scene},
        "study": study(compared),
        "scenes": [{"name": m.scene, "inputs": dict(m.inputs)} for m in manifests],
    }


def voxel_record(scene: ScannetScene, folder: Path, *, side: float = VOXEL_SIDE, threads: int = 0) -> Document:
    """Return IoU and accuracy of the classes of one scene, in voxels."""
    predictions, truth = predicted_classes(scene, folder), scene.pseudo_labels
    labelled = np.flatnonzero(truth > 0)
    grid = grid_over(scene.points.positions, side)
    labellings = [truth[labelled], predictions[labelled]]
    true, predicted = voxel_labels(
        scene.gaussians.subset(labelled), labellings, len(scene.labels) + 1, grid, threads=threads
    )
    filled = true >= 0
    return {**segmentation_record(predicted[filled], true[filled], scene.labels), "voxels": int(filled.sum())}


def study(compared: Sequence[Mapping[str, Any]]) -> Document:
    """Correlate, over scenes, mIoU by Gaussians with and without significance with mIoU by voxels.

    compared: scene, voxel, weighted and unweighted mIoU of each.

    Source: Dr. Splat Fig. S3, which has eight scenes.
    """
    reference = [float(row["voxel"]) for row in compared]
    correlations = {
        kind: {
            "pearson": scorers.pearson(reference, [float(row[kind]) for row in compared]),
            "spearman": scorers.spearman(reference, [float(row[kind]) for row in compared]),
        }
        for kind in ("weighted", "unweighted")
        if len(compared) > 2
    }
    return {
        "scenes": [dict(row) for row in compared],
        "correlations": correlations,
        "enough_scenes": len(compared) >= MIN_SCENES,
    }


class _Sources:
    """Gaussians with the box of voxels that each reaches."""

    def __init__(self, gaussians: Gaussians, grid: VoxelGrid) -> None:
        self.grid, self.means = grid, gaussians.positions
        self.whiten = gaussians.whitening().astype(np.float32).astype(np.float64)
        scales = gaussians.scales.astype(np.float64)
        self.peaks = gaussians.opacities / ((2 * np.pi) ** 1.5 * scales.prod(1))
        reach = CUT_OFF_SIGMAS * np.sqrt(gaussians.covariances()[:, [0, 3, 5]])
        low, high = ((self.means + sign * reach - grid.origin) / grid.side - 0.5 for sign in (-1, 1))
        self.low = np.maximum(np.ceil(low), 0).astype(np.int64)
        self.high = np.minimum(np.floor(high), np.array(grid.shape) - 1).astype(np.int64)


def _slab(sources: _Sources, labellings: Sequence[Ids], num_labels: int, slab: tuple[int, int]) -> list[OtherIds]:
    """Return the labels of the voxels with x in [slab[0], slab[1])."""
    low, high = sources.low.copy(), sources.high.copy()
    low[:, 0], high[:, 0] = np.maximum(low[:, 0], slab[0]), np.minimum(high[:, 0], slab[1] - 1)
    spans = np.maximum(high - low + 1, 0)
    ids = np.flatnonzero(spans.prod(1))
    _, ny, nz = sources.grid.shape
    voxels = (slab[1] - slab[0]) * ny * nz
    sums = [np.zeros(voxels * num_labels) for _ in labellings]
    ends = np.cumsum(spans[ids].prod(1))
    start = 0
    while start < len(ids):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + MAX_PAIRS)))
        batch = ids[start:stop]
        owner, at, mass = _pairs(sources, batch, low[batch], spans[batch])
        place = ((at[:, 0] - slab[0]) * ny + at[:, 1]) * nz + at[:, 2]
        for total, labels in zip(sums, labellings, strict=True):
            np.add.at(total, place * num_labels + labels[owner], mass)
        start = stop
    least = MIN_MASS / sources.grid.side**3
    return [_winners(total.reshape(voxels, num_labels), least) for total in sums]


def _pairs(
    sources: _Sources, ids: OtherIndices, low: Int64[Array, "m 3"], spans: Int64[Array, "m 3"]
) -> tuple[Indices, Int64[Array, "n 3"], Doubles]:
    """Return Gaussian, voxel and alpha N(v) of all pairs within the cut-off."""
    counts = spans.prod(1)
    row = np.repeat(np.arange(len(ids)), counts)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    rest, z = np.divmod(nth, spans[row, 2])
    x, y = np.divmod(rest, spans[row, 1])
    at = low[row] + np.stack([x, y, z], 1)
    offsets = sources.grid.origin + (at + 0.5) * sources.grid.side - sources.means[ids][row]
    along = np.einsum("pij,pj->pi", sources.whiten[ids][row], offsets)
    squared = (along**2).sum(1)
    near = squared <= CUT_OFF_SIGMAS**2
    owner = ids[row[near]]
    return owner, at[near], sources.peaks[owner] * np.exp(-squared[near] / 2)


def _winners(scores: DoubleRows, least: float) -> Ids:
    filled = scores.sum(1) > least
    return np.where(filled, scores.argmax(1), -1).astype(np.int32)
