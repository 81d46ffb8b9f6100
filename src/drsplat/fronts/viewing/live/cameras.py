"""Cameras and paths as browsers send them, and other values of requests with their bounds."""

from typing import Annotated

import numpy as np
from pydantic import Field, StringConstraints

from ....authoring.filming.looking import looking_at
from ....authoring.filming.paths import CameraPath, KeyFrame
from ....base.contents import Document
from ....errors import InputError
from ....scene.views import View
from ...serving.query_fields import Strict
from ..stage import FILM_S, MAX_FILM_S, Stage

MAX_TEXT_CHARACTERS = 500
MAX_SIDE_PIXELS = 1600  # of a picture that is drawn
MAX_KEYS = 200
FPS, FILM_SIZE_PIXELS = 24.0, (960, 720)

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
Point = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]  # a list, as JSON has it
Span = Annotated[tuple[Finite, Finite], Field(strict=False)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=MAX_TEXT_CHARACTERS)]
Degrees = Annotated[float, Field(ge=1, le=170, allow_inf_nan=False)]
Side = Annotated[int, Field(ge=16, le=8192)]
Number = Annotated[int, Field(ge=0, le=2**31 - 1)]


class Key(Strict):
    """A key frame of a film. fov: degrees from the top to the bottom of the picture."""

    eye: Point
    target: Point
    fov: Degrees


class Camera(Key):
    """The camera of a browser. width, height: of its picture in pixels."""

    width: Side
    height: Side


class Path(Strict):
    """A path through key frames. closed: the last leads to the first."""

    keys: Annotated[list[Key], Field(min_length=2, max_length=MAX_KEYS)]
    seconds: Annotated[float, Field(gt=0, le=MAX_FILM_S, allow_inf_nan=False)] = FILM_S
    closed: bool = False


def view_of(stage: Stage, camera: Camera, most_side: int = MAX_SIDE_PIXELS) -> View:
    """Return a camera in the world, with pixels of the same shape but not too many.

    Raises: InputError: it stands where it looks.
    """
    return _view(stage, camera, (camera.width, camera.height)).limited(most_side)


def path_through(stage: Stage, path: Path) -> CameraPath:
    """Return a path in the world. Raises: InputError: a key frame stands where it looks."""
    keys = [KeyFrame.of(_view(stage, key, FILM_SIZE_PIXELS)) for key in path.keys]
    return CameraPath(tuple(keys), path.closed, False, path.seconds, FPS, FILM_SIZE_PIXELS)


def flight_document(stage: Stage, path: Path) -> Document:
    """Return the places that a browser flies through: those of the film that would be saved.

    Raises: InputError: a key frame stands where it looks.
    """
    target = stage.session.shown.frame.world(np.array(path.keys[0].target, np.float64))
    return stage.film_document(path_through(stage, path), target)


def path_document(stage: Stage, path: CameraPath) -> Document:
    """Return a path of the world as browsers take it. Raises: InputError: more key frames than they take."""
    if len(path.keys) > MAX_KEYS:
        raise InputError(f"a path of the viewer has up to {MAX_KEYS} key frames, this one has {len(path.keys):,}")
    lasts = path.seconds or (path.keys[-1].seconds or 0) - (path.keys[0].seconds or 0) or FILM_S
    frame = stage.session.shown.frame
    keys = [
        {"eye": frame.shown(key.eye).tolist(), "target": (frame.shown(key.eye) + key.rotation[2]).tolist(),
         "fov": key.fov_degrees}
        for key in path.keys
    ]  # fmt: skip
    return {"keys": keys, "seconds": float(np.clip(lasts, 1.0, MAX_FILM_S)), "closed": path.closed}


def _view(stage: Stage, key: Key, size: tuple[int, int]) -> View:
    frame = stage.session.shown.frame
    eye, target = (frame.world(np.array(place, np.float64)) for place in (key.eye, key.target))
    return looking_at(eye, target, stage.up, size, key.fov)
