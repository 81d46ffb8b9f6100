"""What pages begin with: toy models and data under the names that they have for a reader's own."""

import json
import shutil
from pathlib import Path

import numpy as np

import drsplat as ds
from lvis_files import write_set
from toy_capture import NEGATIVES, THINGS, balls_field, write_toy_capture
from written_captures import model_of, write_colmap_text

DIM = 128  # what 128 sub-vectors divide


def write_own(folder: Path) -> None:
    """A reader's own scene, photos with features, texts and field, and a folder of two scenes."""
    balls_field(write_toy_capture(folder)).save(folder / "scene.field")


def write_tour(folder: Path, clip: str) -> Path:
    """A scene, its photos without features, models, data sets. Needs transformers."""
    from tiny_encoders import write_model

    write_toy_capture(folder)
    shutil.rmtree(folder / "capture/language_features")
    write_poses_and_points(folder)
    write_model(folder / clip, "clip", dim=DIM, tokens=40)  # for the longest noun
    encoder = ds.load_encoder(str(folder / clip), "cpu")
    texts = [*THINGS, *NEGATIVES]
    vectors = dict(zip(texts, encoder.encode_texts(texts).tolist(), strict=True))
    (folder / "clip_texts.json").write_text(json.dumps(vectors))
    write_set(folder).rename(folder / "lvis_v1_train.json")
    (folder / "images").rename(folder / "coco")
    write_lerf(folder)
    (folder / "scenes/mugs").mkdir(parents=True)
    (folder / "scenes/mugs/scene.ply").symlink_to(folder / "scene.ply")
    (folder / "scenes/mugs/mugs.field").symlink_to(folder / "scene.field")
    return folder


def write_poses_and_points(folder: Path) -> None:
    """The capture's cameras as COLMAP has them, with points: training starts from some, not from 100,000."""
    means = ds.read_gaussians(folder / "scene.ply").means[::30].tolist()
    points = [(n, tuple(mean), (128, 128, 128)) for n, mean in enumerate(means, 1)]
    write_colmap_text(folder / "capture/sparse/0", *model_of(ds.read_views(folder / "capture")), points)
    (folder / "capture/cameras.json").unlink()


def write_lerf(folder: Path) -> None:
    """lerf_ovs/ with one scene, teatime: the capture, with the mug labelled in its first photo."""
    labels = folder / "lerf_ovs/label/teatime"
    labels.mkdir(parents=True)
    (folder / "lerf_ovs/teatime").symlink_to(folder / "capture")
    (folder / "teatime.ply").symlink_to(folder / "scene.ply")
    (folder / "teatime.field").symlink_to(folder / "scene.field")
    view = ds.read_views(folder / "capture")[0]
    box = [30, 20, 60, 50]
    corners = [[30, 20], [60, 20], [60, 50], [30, 50]]
    thing = {"category": "red mug", "bbox": box, "segmentation": corners}
    info = {"name": view.name, "width": view.width, "height": view.height}
    document = {"info": info, "objects": [thing]}
    (labels / view.name).with_suffix(".json").write_text(json.dumps(document))


def write_peers(folder: Path) -> None:
    """Features of other systems: a row for each Gaussian of the toy, and of a packed room."""
    count = len(ds.read_gaussians(folder / "scene.ply")) // len(THINGS)
    np.save(folder / "features.npy", np.repeat(ds.WordEncoder().encode_texts(list(THINGS)), count, axis=0))
    (folder / "world").symlink_to(Path(__file__).resolve().parents[2] / "world")
    room = ds.read_gaussians(folder / "world/scenes/room_5/scene.compressed.ply")
    rows = np.random.default_rng(0).standard_normal((len(room), ds.MiniEncoder().identity.dim))
    np.save(folder / "per_gaussian.npy", rows.astype(np.float16))
