"""Cameras as browsers send them, in their frame, and as views of the world."""

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from ....authoring.filming.looking import looking_at
from ....authoring.filming.paths import CameraPath, KeyFrame
from ....errors import InputError
from ....scene.views import View
from ..page import film_document
from .stage import Stage

MOST_TEXT = 500  # characters that are typed
MOST_SIDE = 1600  # pixels of a picture that is drawn
MOST_KEYS = 200
MOST_SECONDS, SECONDS = 60.0, 8.0  # of a film
FPS, FILM_SIZE = 24.0, (960, 720)

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
Point = tuple[Finite, Finite, Finite]
Span = tuple[Finite, Finite]
Text = Annotated[str, StringConstraints(min_length=1, max_length=MOST_TEXT)]
Degrees = Annotated[float, Field(ge=1, le=170, allow_inf_nan=False)]
Side = Annotated[int, Field(ge=16, le=8192)]
Number = Annotated[int, Field(ge=0, le=2**31 - 1)]


class Body(BaseModel):
    """A JSON object of a request. Unknown keys are refused: a misspelt one would be ignored in silence."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Key(Body):
    """A key frame of a film. fov: degrees from the top to the bottom of the picture."""

    eye: Point
    target: Point
    fov: Degrees


class Camera(Key):
    """The camera of a browser. width, height: of its picture in pixels."""

    width: Side
    height: Side


class Path(Body):
    """A path through key frames. closed: the last leads to the first."""

    keys: Annotated[list[Key], Field(min_length=2, max_length=MOST_KEYS)]
    seconds: Annotated[float, Field(gt=0, le=MOST_SECONDS, allow_inf_nan=False)] = SECONDS
    closed: bool = False


def view_of(stage: Stage, camera: Camera, most_side: int = MOST_SIDE) -> View:
    """Return a camera in the world, with pixels of the same shape but not too many.

    Raises: InputError: it stands where it looks.
    """
    return _view(stage, camera, (camera.width, camera.height)).limited(most_side)


def path_through(stage: Stage, path: Path) -> CameraPath:
    """Return a path in the world. Raises: InputError: a key frame stands where it looks."""
    keys = [KeyFrame.of(_view(stage, key, FILM_SIZE)) for key in path.keys]
    return CameraPath(tuple(keys), path.closed, False, path.seconds, FPS, FILM_SIZE)


def flight_document(stage: Stage, path: Path) -> dict[str, Any]:
    """Return the places that a browser flies through: those of the film that would be saved.

    Raises: InputError: a key frame stands where it looks.
    """
    frame = stage.session.shown.frame
    return film_document(frame, path_through(stage, path), frame.world(np.array(path.keys[0].target, np.float64)))


def path_document(stage: Stage, path: CameraPath) -> dict[str, Any]:
    """Return a path of the world as browsers take it. Raises: InputError: more key frames than they take."""
    if len(path.keys) > MOST_KEYS:
        raise InputError(f"a path of the viewer has up to {MOST_KEYS} key frames, this one has {len(path.keys):,}")
    lasts = path.seconds or (path.keys[-1].seconds or 0) - (path.keys[0].seconds or 0) or SECONDS
    frame = stage.session.shown.frame
    keys = [
        {"eye": frame.shown(key.eye).tolist(), "target": (frame.shown(key.eye) + key.rotation[2]).tolist(),
         "fov": key.fov_degrees}
        for key in path.keys
    ]  # fmt: skip
    return {"keys": keys, "seconds": float(np.clip(lasts, 1.0, MOST_SECONDS)), "closed": path.closed}


def _view(stage: Stage, key: Key, size: tuple[int, int]) -> View:
    frame = stage.session.shown.frame
    eye, target = (frame.world(np.array(place, np.float64)) for place in (key.eye, key.target))
    return looking_at(eye, target, stage.up, size, key.fov)
