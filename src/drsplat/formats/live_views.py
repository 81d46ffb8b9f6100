"""Views that arrive while a scene is in use: live_views/ beside its capture.

images/NAME                    a photo, as it was sent
features/STEM.features.safetensors   its masks and embeddings, where they were sent as well
waiting/STEM.json              its pose and lens; the view is to be added
added/STEM.json                the same; the view is in the field
refused/STEM.json              the same and why; its photo is gone

NAME is the view's, STEM is NAME without suffix. The JSON is written last and moved as a whole, so a view is in one
state at any time. Only added views are part of the capture.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

from ..base.arrays import Matrix4
from ..base.contents import open_file
from ..errors import DrSplatError, FormatError, InputError
from ..scene.views import View
from .embedding_record import COMPACT
from .json_files import as_count, as_document, as_kind, as_matrix, as_number, as_vector, document_in
from .photo_files import PHOTO_SUFFIXES, on_raster, safe_name
from .poses import pinhole, pose, posed_view, rotation_from_quaternion
from .replacing import replacing, sync_folder
from .tensors import check_seal, sealed
from .transforms import cam_from_transform

FOLDER, ADDED_POSES = "live_views", "live_views/added"
FORMAT = "drsplat live view 1"
IMAGES, FEATURES = "images", "features"
State = Literal["waiting", "added", "refused"]
STATES: tuple[State, ...] = ("waiting", "added", "refused")
POSES = ("cam_from_world", "quaternion", "transform_matrix")
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "width", "height")
CURE = "Remove it, and send its photo again"


class TakenNameError(InputError):
    """Error for a name that another view has."""


class FullError(DrSplatError):
    """Error for a scene for which many views wait."""


@dataclass(frozen=True)
class LiveView:
    """A view that was sent.

    Attributes:
        name: of the photo, with suffix; it may have folders.
        pose: one of POSES, as it was sent; translation beside quaternion.
        lens: of LENS, those that were sent.
        time: when the photo was taken, in the unit of the scene's times, or None.
        has_features: True where masks and embeddings were sent, too.
        content: hash of all that was sent.
        arrived, ended: seconds since 1970; ended is 0 while the view waits.
        state: waiting, added or refused.
        reason: why the view was refused, or "".
    """

    name: str
    pose: Mapping[str, object]
    lens: Mapping[str, object]
    time: float | None
    has_features: bool
    content: str
    arrived: float
    ended: float = 0.0
    state: State = "waiting"
    reason: str = ""

    @property
    def stem(self) -> str:
        return stem_of(self.name)


class LiveViews:
    """The live views of a capture's folder."""

    def __init__(self, capture: Path) -> None:
        self.folder = capture / FOLDER

    def find(self, name: str) -> LiveView | None:
        """Return the view of that name but for the suffix, or None."""
        views = (_read(self._entry(state, stem_of(name)), state) for state in STATES)
        return next((view for view in views if view is not None), None)

    def every(self, *states: State) -> list[LiveView]:
        """Return the views in some states, or in all, in the order of arrival."""
        views: dict[str, LiveView] = {}
        for state in states or STATES:  # in this order, a view that changes its state meanwhile is in one of them
            entries = (_read(path, state) for path in _entries(self.folder / state))
            views |= {view.stem: view for view in entries if view is not None}
        return sorted(views.values(), key=lambda view: (view.arrived, view.name))

    def count_waiting(self) -> int:
        return len(_entries(self.folder / "waiting"))

    def photo(self, view: LiveView) -> Path:
        """Return the path of a view's photo."""
        return self.folder / IMAGES / view.name

    @property
    def features(self) -> Path:
        """Folder of the features that were sent."""
        return self.folder / FEATURES

    def keep(self, view: LiveView, photo: bytes, features: bytes | None) -> None:
        """Write a view that waits. It is on disk when this returns, or not there at all.

        Raises: NoRoom: the disk is full.
        """
        try:
            _write(self.photo(view), photo)
            if features is not None:
                _write(self._features_of(view), features)
            self._write(view)
        except BaseException:
            self._drop_files(view)
            raise
        self._entry("refused", view.stem).unlink(missing_ok=True)

    def mark_added(self, view: LiveView, when: float) -> None:
        """Move a view that waits to those of the field."""
        self._write(replace(view, state="added", ended=when))
        self._forget_waiting(view)

    def refuse(self, view: LiveView, reason: str, when: float) -> None:
        """Move a view that waits to those that were refused, and remove its photo."""
        self._write(replace(view, state="refused", ended=when, reason=reason))
        self._drop_files(view)  # while it waits, nobody sends the photo again
        self._forget_waiting(view)

    def posed(self, view: LiveView) -> View:
        """Return a view with its photo, K and size on the photo's raster.

        Raises: FormatError: a pose, lens or photo that is none. MismatchError: a photo of another shape than its lens.
        """
        from ..scene.photos import photo_size

        photo = self.photo(view)
        return replace(posed(view, photo_size(photo)), image_path=photo)

    def _write(self, view: LiveView) -> None:
        document = json.dumps(sealed({"format": FORMAT, **asdict(view)}), indent=1) + "\n"
        _write(self._entry(view.state, view.stem), document.encode())

    def _forget_waiting(self, view: LiveView) -> None:
        """Remove the file that says that a view waits, after that of its last state was written."""
        waiting = self._entry("waiting", view.stem)
        waiting.unlink(missing_ok=True)
        sync_folder(waiting.parent)

    def _drop_files(self, view: LiveView) -> None:
        for path in (self.photo(view), self._features_of(view)):
            path.unlink(missing_ok=True)

    def _features_of(self, view: LiveView) -> Path:
        return self.features / f"{view.stem}{COMPACT}"

    def _entry(self, state: State, stem: str) -> Path:
        return self.folder / state / f"{stem}.json"


def stem_of(name: str) -> str:
    """Return the name of a photo without its suffix."""
    return PurePosixPath(name).with_suffix("").as_posix()


def live_name(name: str) -> str:
    """Return the name of a photo that is sent, checked. Raises: FormatError: no such name, or no photo's suffix."""
    checked = safe_name(name, "name")
    if any(part.startswith(".") for part in checked.split("/")) or not checked.endswith(PHOTO_SUFFIXES):
        raise FormatError(f"name: expected the name of a photo such as 'front/0001.jpg', got {ascii(name)[:200]}")
    return checked


def posed(view: LiveView, size: tuple[int, int]) -> View:
    """Return a view without its photo. size: width and height of the photo. Raises: as `LiveViews.posed`."""
    where = f"view {view.name!a}"
    lens = {name: as_number(view.lens[name], f"{where}: lens.{name}") for name in LENS if _has(view.lens, name)}
    unknown = sorted(view.lens.keys() - set(LENS))
    if unknown or "fx" not in lens or ("width" in lens) != ("height" in lens):
        raise FormatError(
            f"{where}: lens: expected fx, and fy, cx, cy, k1, k2, p1, p2 (pixels; OpenCV's), width and height where "
            f"they are others than the photo's, got {', '.join(sorted(view.lens)) or 'nothing'}"
        )
    raster = size
    if "width" in lens:
        raster = as_count(lens["width"], f"{where}: lens.width"), as_count(lens["height"], f"{where}: lens.height")
    center = lens.get("cx", raster[0] / 2), lens.get("cy", raster[1] / 2)
    K = pinhole(lens["fx"], lens.get("fy", lens["fx"]), *center)
    distortion = tuple(lens.get(name, 0.0) for name in ("k1", "k2", "p1", "p2"))
    at = posed_view(where, view.name, K, _cam_from_world(view.pose, where), raster, distortion)
    return on_raster(replace(at, time=view.time), size, where)


def read_live_views(capture: Path) -> list[View]:
    """Read the views of a capture's folder that arrived and were added; none where there are none.

    Raises: FormatError: a damaged file. InputError: a photo is missing.
    """
    live = LiveViews(capture)
    return [live.posed(view) for view in live.every("added")]


def _cam_from_world(sent: Mapping[str, object], where: str) -> Matrix4:
    """Return the pose in the form that it was sent. Raises: FormatError: not exactly one form, or no rigid motion."""
    forms = [name for name in POSES if _has(sent, name)]
    if len(forms) != 1 or ("quaternion" in forms) != _has(sent, "translation"):
        raise FormatError(
            f"{where}: pose: expected cam_from_world (4x4), or quaternion (w, x, y, z) and translation of it, or "
            f"transform_matrix (camera to world, OpenGL axes), got {', '.join(sorted(sent)) or 'nothing'}"
        )
    rows = sent[forms[0]]
    if forms == ["transform_matrix"]:
        return cam_from_transform(rows, f"{where}: transform_matrix")
    if forms == ["quaternion"]:
        turn = tuple(as_vector(rows, 4, f"{where}: quaternion").tolist())
        shift = as_vector(sent["translation"], 3, f"{where}: translation")
        return pose(rotation_from_quaternion(turn, f"{where}: quaternion"), shift)
    matrix = as_matrix(rows, 4, 4, f"{where}: cam_from_world")
    if (matrix[3] != (0, 0, 0, 1)).any():
        raise FormatError(f"{where}: cam_from_world: expected the last row 0 0 0 1, got {matrix[3]}")
    return matrix


def _has(sent: Mapping[str, object], name: str) -> bool:
    return sent.get(name) is not None


def _entries(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.json") if not path.name.startswith("."))


def _read(path: Path, state: State) -> LiveView | None:
    """Return the view of a file, or None where there is none. Raises: FormatError: it is not what was written."""
    try:
        with open_file(path) as file:
            document = document_in(file.read(), str(path))
    except FileNotFoundError:
        return None
    check_seal(as_document(document, str(path), FORMAT, cure=CURE), f"{path}", cure=CURE)
    try:
        view: LiveView = replace(as_kind(document, LiveView, str(path)), state=state)
        live_name(view.name)
    except FormatError as error:  # sealed, but by another program
        raise FormatError(f"{error}. {CURE}") from error
    return view


def _write(path: Path, content: bytes) -> None:
    """Write a file, and its folders where there are none."""
    missing = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        sync_folder(folder.parent)
    with replacing(path, overwrite=True) as file:
        file.write(content)
