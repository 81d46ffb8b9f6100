"""Small scenes that move, for tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from drsplat import Mixture, Scene, View, ViewFeatures, WordEncoder, register
from drsplat.formats.langsplat import write_features
from drsplat.formats.moving_scenes import write_moving
from drsplat.kernels import render_channels, splat_arrays
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.moving import Frames, Moving
from fields import with_flat_objects
from scenes import gaussians_at, look_at_view, random_gaussians
from written_captures import model_of, transforms_document, write_json, write_photo


def still(gaussians: Gaussians, times: np.ndarray | None = None) -> Moving:
    """A scene whose frames are all the same."""
    stamps = np.array([0.0, 0.5, 1.0]) if times is None else times
    return Moving(gaussians, stamps, Frames(stamps, lambda _: replace(gaussians)))


def drifting(count: int = 120, seed: int = 0, times: np.ndarray | None = None) -> Moving:
    """Each row along a line of its own, turning about an axis of its own."""
    gaussians = random_gaussians(count, seed)
    rng = np.random.default_rng([seed, 1])
    speed, spin = rng.normal(0, 0.5, (count, 3)), rng.normal(0, 0.3, (count, 4))
    stamps = np.linspace(0, 2, 5) if times is None else times

    def frame(number: int) -> Gaussians:
        quats = gaussians.quats + spin * stamps[number]
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        means = gaussians.means + speed * stamps[number]
        return replace(gaussians, means=means.astype(np.float32), quats=quats.astype(np.float32))

    return Moving(frame(0), stamps, Frames(stamps, frame))


WORDS = ("red car", "white vase", "brown table")
STEPS = 6


def passing() -> Moving:
    """A car (rows 0 to 99) that goes along +y, in front of a vase (100 to 199), above a table (200 to 299)."""
    rng = np.random.default_rng(3)
    car, vase = (rng.uniform(-0.2, 0.2, (100, 3)) + center for center in ((0.0, -1.0, 0.2), (-0.6, 0.05, 0.2)))
    table = rng.uniform((-1, -1.5, -0.2), (1, 1.5, -0.05), (100, 3))
    scales = np.repeat([0.05, 0.05, 0.15], 100)[:, None]
    gaussians = gaussians_at(np.concatenate([car, vase, table]), scales)
    stamps = np.linspace(0, 1, STEPS)

    def frame(number: int) -> Gaussians:
        moved = gaussians.means.copy()
        moved[:100, 1] += np.float32(2 * stamps[number])
        return replace(gaussians, means=moved)

    return Moving(gaussians, stamps, Frames(stamps, frame))


def passing_views(moving: Moving) -> list[View]:
    """Two cameras, each at every time."""
    eyes = {"cam0": (3.0, 0.3, 1.5), "cam1": (2.0, -1.5, 2.0)}
    return [
        replace(look_at_view(eye, width=80, height=60), name=f"{camera}/{number:02d}.png", time=float(time))
        for camera, eye in eyes.items()
        for number, time in enumerate(moving.times)
    ]


def label_masks(moving: Moving, views: list[View], labels: np.ndarray, words: tuple[str, ...]) -> dict:
    """Features by view: masks of what most of each pixel's weight belongs to, and their words' vectors."""
    vectors, found = WordEncoder().encode_texts(words), {}
    for view in views:
        assert view.time is not None
        at = moving.at(view.time)
        drawn = render_channels(splat_arrays(at), view, np.eye(len(words), dtype=np.float32)[labels])
        masks = np.where(drawn.alpha > 0.5, drawn.channels.argmax(2), -1).astype(np.int32)
        found[view.name] = ViewFeatures(masks, np.asarray(vectors, np.float32))
    return found


def passing_scene(objects: bool = False) -> Scene:
    moving = passing()
    views = passing_views(moving)
    labels = np.repeat(np.arange(3), 100)
    features = label_masks(moving, views, labels, WORDS)
    field = replace(register(moving, views, features), encoder=WordEncoder.identity).to_field(Mixture())
    if objects:
        field = with_flat_objects(field, moving.canonical, labels[field.gaussian_ids])
    return Scene(field, moving, views)


def passing_red_scene() -> Scene:
    """With objects, and the thing that moves in red, so that a picture tells."""
    made = passing_scene(objects=True)
    moving: Moving = made.moving
    red = np.where(np.arange(300)[:, None, None] < 100, [[[1.7, -1.7, -1.7]]], 0).astype(np.float32)
    moving.canonical.sh[:] = red
    return made


def write_film(folder: Path) -> None:
    """The passing car: numbered PLY files, photos by camera and frame, whose names alone have times."""
    moving = passing()
    write_moving(folder / "frames", moving)
    views = passing_views(moving)
    for view in views:
        write_photo(folder / "capture/images" / view.name, view.width, view.height)
    write_json(folder / "capture/transforms.json", transforms_document(*model_of(views)))
    for name, one in label_masks(moving, views, np.repeat(np.arange(3), 100), WORDS).items():
        stem = str(Path(name).with_suffix(""))
        write_features(folder / "capture/language_features", stem, one.mask_ids, one.embeddings, form="compact")
