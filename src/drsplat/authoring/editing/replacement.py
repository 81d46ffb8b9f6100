"""An object of another scene in the place of one, and changes that look at the scene once, when they are made."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.arrays import Matrix4, RowIds, Spans, Vector3
from ...base.contents import AnyPath
from ...errors import InputError, MismatchError, warn
from ...formats.json_files import are_rows, ids_of, is_text, spans_of
from ...formats.scenes import read_gaussians
from ...kernels.boxes import box_of
from ...query.objects import match_of, objects_of
from ...query.opening import find_scene, open_scene, registered_scene
from ...scene.boxes import Box, solid
from ...scene.gaussians import Gaussians
from ...scene.moving import still
from ...scene.similarity import similarity_of
from .draft import Draft, Scale, most_rows

MIN_BOX_LENGTH = 1e-9  # of a box that something can be fitted to


@dataclass(frozen=True, eq=False)
class Replace:
    """Replacement: the target is removed, and rows of another scene stand in its place.

    scene: its file. fingerprint: of its Gaussians. spans: its rows, None for all. matrix: 4x4, from its world to that
    of the scene that is edited; `fitted` makes one. What comes belongs to the object that goes.

    Raises: InputError: no path, rows that do not ascend, or a matrix that is no rotation, scale and translation.
    """

    scene: str
    fingerprint: str
    matrix: Matrix4
    spans: Spans | None = None

    def __post_init__(self) -> None:
        if not self.scene or not is_text(self.scene):
            raise InputError("replace: expected the path of a scene")
        if self.spans is not None and not are_rows(self.spans):
            raise InputError("replace: spans: expected ascending rows of the other scene, one or more")
        similarity_of(self.matrix)

    def apply(self, draft: Draft, ids: RowIds) -> None:
        other = draft.read(self.scene)
        if draft.rows.antialiased != other.antialiased:
            kinds = ("antialiased (mip)", "not") if other.antialiased else ("not antialiased", "antialiased (mip)")
            warn(
                f"replace: what comes was trained to be drawn {kinds[0]}, the scene {kinds[1]}: drawn as the scene is, "
                "its small Gaussians look somewhat too solid or too faint from afar",
                3,
            )
        draft.most = max(draft.most, most_rows(len(other)))
        draft.present[ids] = False
        # the number of the object that most of some rows belong to, or a new number
        owners = np.empty(0, np.int64) if draft.owners is None else draft.owners[ids]
        owners = owners[owners >= 0].astype(np.int64)
        number = int(np.bincount(owners).argmax()) if len(owners) else draft.next_object()
        draft.add(similarity_of(self.matrix).moved(self._part(other)), number)

    def _part(self, other: Gaussians) -> Gaussians:
        if other.fingerprint != self.fingerprint:
            raise MismatchError(
                f"{self.scene}: has become another scene ({other.fingerprint}) than was meant ({self.fingerprint}): "
                "undo this edit and make it anew"
            )
        if self.spans is None:
            return other
        if int(self.spans[-1, 1]) > len(other):
            raise InputError(
                f"replace: has row {self.spans[-1, 1] - 1:,} of {self.scene}, which has {len(other):,}: undo this edit "
                "and make it anew"
            )
        return other.subset(ids_of(self.spans))


def fitted(goes: Box, comes: Box) -> Matrix4:
    """Return the matrix that puts one upright box into another: same floor, same middle, the largest size that fits.

    Upright: the third axis is up. Long sides lie along long sides. Raises: InputError: a box without a length.
    """
    if not (goes.extent.max() > MIN_BOX_LENGTH and comes.extent.max() > MIN_BOX_LENGTH):
        raise InputError("replace: expected two things with a size, got a single point")
    scale = float((np.maximum(goes.extent, MIN_BOX_LENGTH) / np.maximum(comes.extent, MIN_BOX_LENGTH)).min())
    rotation = goes.axes.T @ comes.axes
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = _foot(goes) - scale * rotation @ _foot(comes)
    return matrix


def _foot(box: Box) -> Vector3:
    return box.center - box.axes[2] * box.extent[2] / 2


def scaled_on_its_foot(part: Gaussians, factor: float, up: Vector3 | None) -> Scale:
    """Scale about the middle of where something stands; about its own middle where nothing tells what is up."""
    if up is None or not len(part):
        return Scale(factor)
    x, y, z = _foot(box_of(part, solid(part, np.arange(len(part))), up)).tolist()
    return Scale(factor, (x, y, z))


def replaced_by(part: Gaussians, up: Vector3, other: AnyPath, number: int | None, folder: Path) -> Replace:
    """Replace `part` by another scene, or by an object of the field in a folder. folder: where edits are kept.

    Up is as here in a scene that does not tell. Raises: InputError: no such scene or object; as `read_gaussians`.
    """
    path, up_there, spans = Path(other), up, None
    if number is None:
        gaussians = read_gaussians(path)
        ids = np.arange(len(gaussians))
    else:
        scene = open_scene(path)
        path, found = registered_scene(find_scene(path), scene.field)
        gaussians = still(found)
        up_there = up if scene.up is None else scene.up
        ids = match_of(scene.field, objects_of(scene.field).thing(number)).gaussian_ids
        spans = spans_of(ids)
    goes = box_of(part, solid(part, np.arange(len(part))), up)
    matrix = fitted(goes, box_of(gaussians, solid(gaussians, ids), up_there))
    return Replace(os.path.relpath(path.resolve(), folder.resolve()), gaussians.fingerprint, matrix, spans)
