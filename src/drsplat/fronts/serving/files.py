"""A scene as a file that is sent: as `drsplat export` writes it, of a bounded size."""

import tempfile
from pathlib import Path

from ...authoring.editing.resolving import object_rows
from ...authoring.exporting import labelled
from ...authoring.exporting.labelling import Only, kept_edits
from ...authoring.exporting.writing import written
from ...errors import InputError
from ...query import Scene
from ...scene.gaussians import Gaussians
from .limits import Limits
from .query_fields import asks_something, query_of
from .replies import GLB, PLY, Reply
from .requests import Export

BYTES_BESIDE_HARMONICS = 48  # of a Gaussian: place, rotation, scales, opacity, point's colour
BYTES_PER_COEFFICIENT = 12
# Seconds of a Gaussian on two busy cores, rounded up: writing it, completing an object, and applying an edit.
WRITING_S, COMPLETING_S, EDITING_S = 6e-6, 25e-6, 0.3e-6


def exported(scene: Scene, asked: Export, limits: Limits) -> Reply:
    """Return a scene as a file.

    Raises: InputError: options that do not go together, a scene that is too large to send or takes too long; as
    `labelled`.
    """
    query = query_of(asked, limits) if asks_something(asked) else None
    if asked.only and (query is None or asked.object is not None):
        raise InputError("only: what matches is that of a query: pass text, and no object")
    if scene.tiles is not None:
        raise InputError(
            f"this scene of {len(scene.rows):,} Gaussians is in tiles, which are not sent as one file: "
            "/objects/NUMBER/ply sends an object, and `drsplat export` writes all of it as 3D Tiles where the scene is"
        )
    _refuse_large(scene.gaussians, limits)
    _refuse_slow(scene, asked, limits)
    only: Only = "matches" if asked.only else None
    if asked.object is not None:
        only = object_rows(scene, asked.object)
    carried = labelled(scene, query, only=only, time=asked.time, edits=asked.edits, embeddings=asked.embeddings)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"scene.{asked.format}"
        written(path, carried)
        return Reply(path.read_bytes(), GLB if asked.format == "glb" else PLY)


def _refuse_large(gaussians: Gaussians, limits: Limits) -> None:
    size = len(gaussians) * (BYTES_BESIDE_HARMONICS + BYTES_PER_COEFFICIENT * gaussians.sh.shape[1])
    if size > limits.file_bytes:
        raise InputError(
            f"this scene would be a file of about {size / 1e6:,.0f} MB, and up to {limits.file_bytes / 1e6:,.0f} are "
            "sent: `drsplat export` writes it where the scene is"
        )


def _refuse_slow(scene: Scene, asked: Export, limits: Limits) -> None:
    """Refuse before it begins what would be ended before it is done. Raises: InputError; as `kept_edits`."""
    num_edits = kept_edits(scene.path, scene.gaussians, asked.edits).done
    each_s = WRITING_S + EDITING_S * num_edits + (0 if asked.object is None else COMPLETING_S)
    seconds = len(scene.gaussians) * each_s
    if seconds > limits.seconds:
        part = "" if asked.object is None else f" --object {asked.object}"  # of `drsplat export`
        raise InputError(
            f"of {len(scene.gaussians):,} Gaussians this takes about {seconds:,.0f} s, and answers take up to "
            f"{limits.seconds:g}: `drsplat export FOLDER{part} --edits {asked.edits} -o scene.{asked.format}` does it"
        )
