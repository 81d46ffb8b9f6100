"""A small capture, made with the library's own writers: a red ball and a blue one, seen in four photos.

Masks and the embeddings of their words are in LangSplat's files.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import drsplat as ds
from drsplat.formats.langsplat import write_features
from drsplat.formats.moving_scenes import write_moving
from drsplat.formats.poses import write_cameras_json
from drsplat.scene.moving import Frames, Moving
from fields import with_flat_objects
from scenes import gaussians_at, look_at_view

EYES = ((0.0, -4.0, 1.0), (3.0, -3.0, 1.5), (-3.0, -3.0, 0.5), (0.5, -4.5, 0.0))
THINGS = {"red mug": (-0.7, 0.0, 0.0), "blue plate": (0.7, 0.0, 0.0)}
NEGATIVES = ["object", "things", "stuff", "texture"]
WIDTH, HEIGHT, PER_THING = 96, 72, 150


def balls() -> ds.Gaussians:
    """PER_THING Gaussians on a sphere of radius 0.3 about each place, in the order of THINGS."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(len(THINGS) * PER_THING, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = 0.3 * directions + np.repeat(list(THINGS.values()), PER_THING, axis=0)
    colors = np.repeat([(1.2, -1.2, -1.2), (-1.2, -1.2, 1.2)], PER_THING, axis=0)
    return replace(gaussians_at(means, 0.05), sh=colors.astype(np.float32)[:, None])


def sliding(gaussians: ds.Gaussians) -> Moving:
    """The red ball a little further along at each of as many times as there are photos."""
    times = np.arange(float(len(EYES)))

    def frame(number: int) -> ds.Gaussians:
        means = gaussians.means.copy()
        means[:PER_THING, 1] += np.float32(0.02 * number)
        return replace(gaussians, means=means)

    return Moving(frame(0), times, Frames(times, frame))


def masks(gaussians: ds.Gaussians, view: ds.View) -> np.ndarray:
    """Per pixel the thing that covers more than half of it, or -1."""
    members = np.repeat(np.eye(len(THINGS), dtype=np.float32), PER_THING, axis=0)
    share = ds.render(gaussians, view, values=members).channels
    return np.where(share.max(2) > 0.5, share.argmax(2), -1).astype(np.int32)


def write_toy_capture(folder: Path) -> Path:
    """scene.ply, points.ply, frames/, capture/ and clip_texts.json in a folder, as the documents name them."""
    for name in ("capture/images", "capture/language_features"):
        (folder / name).mkdir(parents=True)
    gaussians, encoder = balls(), ds.WordEncoder()
    views = []
    for index, eye in enumerate(EYES):
        at = look_at_view(eye, width=WIDTH, height=HEIGHT)
        views.append(ds.View(f"photo_{index}.png", at.K, at.cam_from_world, WIDTH, HEIGHT))
    for view in views:
        pixels = np.clip(ds.render(gaussians, view).rgb * 255, 0, 255).astype(np.uint8)
        Image.fromarray(pixels).save(folder / "capture/images" / view.name)
        ids = np.repeat(masks(gaussians, view)[None], 4, axis=0)
        rows = encoder.encode_texts(list(THINGS))
        write_features(folder / "capture/language_features", Path(view.name).stem, ids, rows)
    ds.write_gaussians(folder / "scene.ply", gaussians)
    write_moving(folder / "frames", sliding(gaussians))
    ds.write_gaussians(folder / "points.ply", gaussians)  # of which the positions are read
    write_cameras_json(folder / "capture/cameras.json", views)
    texts = [*THINGS, *NEGATIVES]
    vectors = dict(zip(texts, encoder.encode_texts(texts).tolist(), strict=True))
    (folder / "clip_texts.json").write_text(json.dumps(vectors))
    return folder


def balls_field(folder: Path, gaussians: ds.Gaussians | None = None) -> ds.LanguageField:
    """The field of a toy capture, of its own scene unless others are given; both balls are objects."""
    scene = ds.read_gaussians(folder / "scene.ply") if gaussians is None else gaussians
    features = ds.read_features(folder / "capture/language_features", encoder=ds.WordEncoder.identity)
    field = ds.register(scene, ds.read_views(folder / "capture"), features).to_field()
    rows = scene.extra.get("source_row", np.arange(len(scene)))[field.gaussian_ids]
    return with_flat_objects(field, scene, rows // PER_THING)


def write_balls(folder: Path) -> Path:
    """A room to edit: scene.ply, room.field, which knows both balls as objects, and capture/ in a folder."""
    write_toy_capture(folder)
    (folder / "points.ply").unlink()  # it has the same places: another scene beside the field
    balls_field(folder).save(folder / "room.field")
    return folder
