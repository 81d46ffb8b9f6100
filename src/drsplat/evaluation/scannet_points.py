"""scannet-points@1: semantic segmentation as OpenGaussian measures it.

Gaussians are frozen at the labelled points, one each and in their order. The class of each is the one
whose text it is most similar to; IoU and accuracy count Gaussians. Points of other classes and
Gaussians fainter than 0.1 are left out. Means are over the classes of a scene, then over scenes.

Source: OpenGaussian (Wu et al. 2024), its evaluation on ScanNet.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ..base.arrays import Ids
from ..base.contents import Document
from ..errors import MismatchError
from .predictions import read_manifests
from .scannet import ScannetScene, predict_classes, predicted_classes, segmentation_document, segmentation_record

PROTOCOL = "scannet-points@1"
FAINT_OPACITY = 0.1
MAX_MOVED_SHARE = 1e-3  # of the scene's extent

predict = partial(predict_classes, protocol=PROTOCOL)


def score(scenes: Sequence[ScannetScene], folder: Path) -> Document:
    """Score the predictions in a folder. A scene without predicted labels scores 0.

    Raises: InputError: no scene, or one without predictions. MismatchError: Gaussians that are not
    at the points. FormatError: damaged predictions.
    """
    manifests = read_manifests(folder, [scene.name for scene in scenes], PROTOCOL)
    truths = [(scene, frozen_truth(scene)) for scene in scenes]
    records = [segmentation_record(predicted_classes(one, folder), truth, one.labels) for one, truth in truths]
    return segmentation_document(PROTOCOL, scenes, manifests, records)


def frozen_truth(scene: ScannetScene) -> Ids:
    """Return the class of each Gaussian, which is that of its point; 0 for faint ones.

    Raises: MismatchError: not one Gaussian per point, or not at its place.
    """
    means, positions = scene.gaussians.positions, scene.points.positions
    if len(means) != len(positions):
        raise MismatchError(
            f"'{scene.name}': {len(means)} Gaussians for {len(positions)} labelled points: this protocol needs a "
            "scene trained with Gaussians frozen at the points; for free ones use scannet-volume@1"
        )
    moved = float(np.abs(means - positions).max(initial=0))
    if moved > MAX_MOVED_SHARE * float(np.ptp(positions, axis=0).max(initial=0)):
        raise MismatchError(
            f"'{scene.name}': Gaussians are up to {moved:.3g} away from their points: they were not frozen, or "
            "are in another order; for free ones use scannet-volume@1"
        )
    return np.where(scene.gaussians.opacities < FAINT_OPACITY, 0, scene.points.labels).astype(np.int32)
