"""Which threshold suits fields of `mini`: python -m world.mini.cutting ROOM [ROOM ...]

Masks of the segmenter `graph` on Gaussians placed by depth; each name and each "colour name" of what is in a
room is asked, and each name of what is not. Prints per threshold the mean IoU over Gaussians and how often
nothing is found where there is nothing. "0.2, 0.6" is `threshold_above(scores, 0.2)` with that CUT.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32

from drsplat import LanguageField, MiniEncoder, ViewFeatures, load_image, register
from drsplat.masks.crops import crop
from drsplat.models.graph import GraphSegmenter
from drsplat.models.mini.lexicon import NAMES
from drsplat.query.thresholds import PEAK
from drsplat.registration import Registration

from ..depth_scenes import read_views, scene_of
from ..truth import Truth, read_truth

LEASTS, CUTS = (0.125, 0.15, 0.175, 0.2, 0.25, 0.3), (0.0, 0.5, 0.6, 0.7)
VISIBLE = 80  # Gaussians of a thing that is asked for


@dataclass(frozen=True, eq=False)
class Asked:
    scores: Float32[np.ndarray, " r"]
    truth: Bool[np.ndarray, " r"]

    def result(self, least: float, cut: float) -> float:
        """IoU; where nothing is meant 1 for nothing found."""
        found = self.scores > max(least, cut * float(np.sort(self.scores)[-PEAK]))
        if not self.truth.any():
            return float(found.sum() < PEAK)
        return float((found & self.truth).sum() / (found | self.truth).sum())


def questions(folder: Path) -> list[Asked]:
    truth, encoder, segmenter = read_truth(folder), MiniEncoder(), GraphSegmenter()
    views = read_views(folder, truth.known)
    gaussians, labels = scene_of(folder, views)
    features = {}
    for view in views:
        photo = load_image(view)
        masks = segmenter.segment(photo)["large"]
        ids = np.full(photo.shape[:2], -1, np.int32)
        for k in range(len(masks)):
            ids[masks.full(k)] = k
        crops = [crop(photo, part, box) for part, box in zip(masks.parts, masks.boxes, strict=True)]
        features[view.name] = ViewFeatures(ids, encoder.encode_images(crops))
    made = register(gaussians, views, features)
    field = Registration(made.evidence, made.scene, encoder.identity).to_field()
    return _ask(field, labels[field.gaussian_ids], truth, encoder)


def _ask(field: LanguageField, labels: np.ndarray, truth: Truth, encoder: MiniEncoder) -> list[Asked]:
    meant: dict[str, list[int]] = {}
    for number in truth.objects:
        name, color, _ = truth.labels[number]
        if (labels == number).sum() > VISIBLE:
            for text in (name, f"{color} {name}"):
                meant.setdefault(text, []).append(number)
    there = {truth.labels[number][0] for number in truth.objects}
    meant |= {name: [] for name in NAMES if name not in there}
    return [Asked(field.scores(encoder.encode_texts([text])[0]), np.isin(labels, ids)) for text, ids in meant.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", type=Path, nargs="+")
    asked = [one for room in parser.parse_args().rooms for one in questions(room)]
    present = [one for one in asked if one.truth.any()]
    absent = [one for one in asked if not one.truth.any()]
    print(f"{len(present)} queries of what is there, {len(absent)} of what is not")
    for least in LEASTS:
        for cut in CUTS:
            iou = np.mean([one.result(least, cut) for one in present])
            none = np.mean([one.result(least, cut) for one in absent])
            print(f"{least}, {cut}: mIoU {iou:.3f}, rightly nothing {none:.3f}")


if __name__ == "__main__":
    main()
