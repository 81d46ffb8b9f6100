"""voxel@1: volumes by Eq. 4, which significance approximates.

A voxel's score for a label is the sum of alpha_i N(v | mu_i, Sigma_i) over the Gaussians that have it, v
the voxel's centre. Voxels with too small a sum are empty; the others have the label of the highest
score. Truth and prediction are compared voxel by voxel. `study` is Fig. S3.

Source: Dr. Splat Sec. C "Volume awareness of the proposed metric".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Array, Float64, Ids, Int32, OtherIds, Points, Vector3
from ..base.contents import Document
from ..errors import InputError
from ..scene.gaussians import Gaussians
from . import scannet_volume, scorers
from .predictions import read_manifests
from .pseudo_labels import near_pairs
from .scannet import ScannetScene, predict_classes, predicted_classes, segmentation_document, segmentation_record

PROTOCOL = "voxel@1"
VOXEL_SIDE = 0.05  # scene units; ScanNet's are metres
MIN_MASS = 1e-3  # sum of alpha N(v) times the volume of a voxel
CUT_OFF_SIGMAS = 3.0
MAX_VOXELS = 1 << 27
SLAB_SCORES = 1 << 22
MIN_SCENES = 8
CORRELATIONS = {"pearson": scorers.pearson, "spearman": scorers.spearman}

predict = partial(predict_classes, protocol=PROTOCOL)


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Grid of cubes; `origin` is the low corner of the first."""

    origin: Vector3
    side: float
    shape: tuple[int, int, int]

    def centers(self, begin: int = 0, end: int | None = None) -> Points:
        """Return the centres of the voxels, x slowest, in the order of `voxel_labels`; of a run along x if given."""
        along = np.arange(self.shape[0])[begin:end], *map(np.arange, self.shape[1:])
        at = np.stack(np.meshgrid(*along, indexing="ij"), -1).reshape(-1, 3)
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
    rows = max(1, SLAB_SCORES // (grid.shape[1] * grid.shape[2] * num_labels))
    slabs = (grid.centers(x, x + rows) for x in range(0, grid.shape[0], rows))
    parts = [_slab(gaussians, labellings, num_labels, slab, MIN_MASS / grid.side**3, threads) for slab in slabs]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def score(scenes: Sequence[ScannetScene], folder: Path, *, side: float = VOXEL_SIDE, threads: int = 0) -> Document:
    """Score predictions in voxels, and beside it by Eq. 3 with and without significance.

    Predictions of scannet-volume@1 are read, too. The study's correlations are NaN below 3 scenes.

    Raises: InputError: no scene, or one without predictions. FormatError: damaged predictions.
    """
    manifests = read_manifests(folder, [scene.name for scene in scenes], PROTOCOL, scannet_volume.PROTOCOL)
    records = [voxel_record(scene, folder, side=side, threads=threads) for scene in scenes]
    compared = [
        {
            "scene": scene.name,
            "voxel": record["miou"],
            "weighted": scannet_volume.segmentation(scene, folder)["miou"],
            "unweighted": scannet_volume.segmentation(scene, folder, weighted=False)["miou"],
        }
        for scene, record in zip(scenes, records, strict=True)
    ]
    document = segmentation_document(PROTOCOL, scenes, manifests, records)
    return document | {"voxel_side": side, "study": study(compared)}


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
    columns = {kind: [float(row[kind]) for row in compared] for kind in ("voxel", "weighted", "unweighted")}
    correlations = {
        kind: {name: of(columns["voxel"], columns[kind]) for name, of in CORRELATIONS.items()}
        for kind in ("weighted", "unweighted")
        if len(compared) > 2
    }
    return {
        "scenes": [dict(row) for row in compared],
        "correlations": correlations,
        "enough_scenes": len(compared) >= MIN_SCENES,
    }


def _slab(
    gaussians: Gaussians,
    labellings: Sequence[Ids],
    num_labels: int,
    centers: Float64[Array, "v 3"],
    least: float,
    threads: int,
) -> list[Int32[Array, " v"]]:
    """Return the labels of some voxels for each labelling. least: sum of a voxel that is not empty."""
    sums, scales = [np.zeros(len(centers) * num_labels) for _ in labellings], gaussians.scales.astype(np.float64)
    reach, along = CUT_OFF_SIGMAS * (1 + 1e-6) * scales.max(1), gaussians.positions[:, 0]
    (ids,) = np.nonzero((along + reach >= centers[0, 0]) & (along - reach <= centers[-1, 0]))
    near = gaussians.subset(ids)
    whiten, means = near.whitening().astype(np.float32).astype(np.float64), near.positions
    peaks = near.opacities / ((2 * np.pi) ** 1.5 * scales[ids].prod(1))
    for run, owner, at in near_pairs(cKDTree(centers), means, reach[ids], 1, threads):
        offsets = centers[at] - means[run][owner]
        squared = (np.einsum("pij,pj->pi", whiten[run][owner], offsets) ** 2).sum(1)
        mass = np.where(squared <= CUT_OFF_SIGMAS**2, peaks[run][owner] * np.exp(-squared / 2), 0)
        for total, labels in zip(sums, labellings, strict=True):
            np.add.at(total, at * num_labels + labels[ids[run]][owner], mass)
    tables = [total.reshape(-1, num_labels) for total in sums]
    return [np.where(table.sum(1) > least, table.argmax(1), -1).astype(np.int32) for table in tables]
