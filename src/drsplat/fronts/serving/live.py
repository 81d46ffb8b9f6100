"""Views that are sent to a scene: requests, answers, and what a worker does for them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from ...formats.live_views import LiveView, LiveViews
from ...photos.arriving.adding import GrowingScene, add_waiting, refuse_view
from ...photos.arriving.models import ModelNames, ModelShelf
from ...photos.arriving.taking import SentView, Target, take_view
from ...query import SceneFiles, registered_scene
from ...scene.gaussians import Gaussians
from ...scene.moving import Moving
from .guards import Limits
from .models import Body
from .query_fields import LIMITS, Finite, Request, examples
from .replies import Reply, from_base64
from .scene_folder import SceneFolder, Sources, without_paths

TAKE, LIST, ADD, REFUSE = "take-view", "list-views", "add-views", "refuse-view"
ACTS = (TAKE, LIST, ADD, REFUSE)
ACTS_ON_FILES = (LIST, ADD, REFUSE)
"""Acts for which the scene need not be open."""
MAX_VIEWS_LISTED = 1000
Numbers4 = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Numbers3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Size = Annotated[int, Field(ge=1, le=1 << 17)]
Base64 = Annotated[str, Field(min_length=1, max_length=LIMITS.body_bytes)]
EXAMPLE = {
    "name": "robot/0001.jpg",
    "picture": "/9j/4AAQSkZJRg==",
    "pose": {"quaternion": [1.0, 0.0, 0.0, 0.0], "translation": [0.0, 0.0, 2.5]},
    "lens": {"fx": 525.0, "fy": 525.0, "cx": 320.0, "cy": 240.0},
}


class Pose(Request):
    """Place and direction of the camera, in the scene's coordinates: exactly one of three forms."""

    cam_from_world: Annotated[list[Numbers4], Field(min_length=4, max_length=4)] | None = None
    """4x4, row by row: x_cam = M x_world; camera axes x right, y down, z forward (OpenCV)"""
    quaternion: Numbers4 | None = None
    """w, x, y, z of the rotation of cam_from_world, as COLMAP has it; translation with it"""
    translation: Numbers3 | None = None
    transform_matrix: Annotated[list[Numbers4], Field(min_length=3, max_length=4)] | None = None
    """camera to world, camera axes x right, y up, z backward (OpenGL), as ARKit and nerfstudio"""


class Lens(Request):
    """OpenCV's pinhole with distortion, in pixels; the centre of the first pixel is at 0.5, 0.5."""

    fx: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
    fy: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    """default: fx"""
    cx: Finite | None = None
    """default: the middle"""
    cy: Finite | None = None
    k1: Finite | None = None
    """distortion k1, k2, p1, p2; default: none"""
    k2: Finite | None = None
    p1: Finite | None = None
    p2: Finite | None = None
    width: Size | None = None
    """raster of these numbers, if it is not the picture's"""
    height: Size | None = None


class NewView(Request):
    """A posed photo for the scene."""

    name: Annotated[str, Field(min_length=1, max_length=500)]
    """of the photo, with .jpg, .jpeg or .png"""
    picture: Base64
    """base64 of a JPEG or PNG"""
    pose: Pose
    lens: Lens
    time: Finite | None = None
    """when it was taken, in the unit of the times of a scene that moves"""
    features: Base64 | None = None
    """base64 of NAME.features.safetensors: its masks and their embeddings, made by the sender"""

    model_config = examples(EXAMPLE)


class ViewState(Body):
    """A view that was sent."""

    name: str
    state: Literal["waiting", "working", "added", "refused"]
    arrived: float
    """seconds since 1970"""
    ended: float | None
    """when it was added or refused"""
    reason: str = ""
    """why it was refused"""


class ViewList(Body):
    num_waiting: int
    views: list[ViewState]
    """the last ones, in the order of arrival"""
    problem: str = ""
    """why views go on waiting, if something is wrong"""


class Adder:
    """Grower of scenes in a process of its own; the Gaussians and models of the last scene stay loaded."""

    def __init__(self, scene_folder: SceneFolder) -> None:
        sources = scene_folder.sources
        self._threads, self._shelf = sources.threads, ModelShelf(model_names(sources), scene_folder.load)
        self._last: tuple[tuple[object, ...], Gaussians | Moving] | None = None

    def add(self, files: SceneFiles, asked: Mapping[str, Any]) -> Reply:
        """Add the views that wait, those of `names` or all. Raises: DrSplatError: they go on waiting."""
        stats = [(path, path.stat()) for path in files.scenes]
        stamp = tuple((str(path), now.st_ino, now.st_size, now.st_mtime_ns) for path, now in stats)
        if self._last is None or self._last[0] != stamp:
            self._last = None  # before another takes its room
            self._last = stamp, registered_scene(files)[1]
        target = GrowingScene(files.field, capture_of(files), self._last[1], self._threads)
        outcome = add_waiting(target, self._shelf.models, asked["names"])
        seconds = [view.ended - view.arrived for view in outcome.added]
        document = {"seconds": seconds, "num_refused": len(outcome.refused)}
        return Reply(json.dumps(document).encode())


def capture_of(files: SceneFiles) -> Path:
    """Return the folder that a scene's live views are in: of its capture, or its own where it has none."""
    return files.field.parent if files.capture is None else files.capture


def model_names(sources: Sources) -> ModelNames:
    return ModelNames(sources.segmenter, sources.encoder, sources.device, sources.threads)


def take(scene_folder: SceneFolder, name: str, asked: Mapping[str, Any], limits: Limits) -> Reply:
    """Keep a view. Raises: as `take_view`."""
    scene, view = scene_folder.scene(name), NewView(**asked)
    features = None if view.features is None else from_base64(view.features, "features")
    pose, lens = view.pose.model_dump(exclude_none=True), view.lens.model_dump(exclude_none=True)
    sent = SentView(view.name, from_base64(view.picture, "picture"), pose, lens, view.time, features)
    photos = tuple(photo.name for photo in scene.views)
    target = Target(capture_of(scene_folder.files(name)), scene.field, photos, scene.motion is not None)
    taken, is_new = take_view(
        target, sent, model_names(scene_folder.sources), most_pixels=limits.pixels, most_waiting=limits.views
    )
    return Reply(_state(taken).model_dump_json().encode(), status=202 if is_new else 200)


def list_views(files: SceneFiles, asked: Mapping[str, Any]) -> Reply:
    """List the views that were sent. asked: `working`, names that are being added; `problem`."""
    working, capture = set(asked["working"]), capture_of(files)
    views = LiveViews(capture).every()
    states = [_state(view, view.name in working) for view in views[-MAX_VIEWS_LISTED:]]
    for state in states:
        state.reason = without_paths(state.reason, (capture, capture.resolve()))
    waiting = sum(view.state == "waiting" for view in views)
    answer = ViewList(num_waiting=waiting, views=states, problem=asked["problem"])
    return Reply(answer.model_dump_json().encode())


def live_reply(scene_folder: SceneFolder, adder: Adder, act: str, scene: str, asked: Any, limits: Limits) -> Reply:
    """Answer one of ACTS. Raises: DrSplatError."""
    if act == TAKE:
        return take(scene_folder, scene, asked, limits)
    files = scene_folder.files(scene)
    if act == REFUSE:
        refuse_view(capture_of(files), asked["name"], asked["reason"])
        return Reply(b"{}")
    return list_views(files, asked) if act == LIST else adder.add(files, asked)


def _state(view: LiveView, working: bool = False) -> ViewState:
    state = "working" if working and view.state == "waiting" else view.state
    return ViewState(
        name=view.name, state=state, arrived=view.arrived, ended=view.ended or None, reason=view.reason  # type: ignore[arg-type]
    )  # fmt: skip
