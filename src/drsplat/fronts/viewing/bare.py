"""A scene that nobody has registered: to look at."""

from pathlib import Path

import numpy as np

from ...errors import InputError
from ...field import LanguageField
from ...field.codes import Codebook, PQCode
from ...formats.captures import read_views
from ...formats.moving_scenes import is_moving
from ...formats.tiles import TILES
from ...kernels.scan import GROUP_ROWS
from ...query import Scene
from ...query.opening import tiles_or_scene
from ...scene.encoders import Encoder, EncoderIdentity
from ...scene.moving import Moving, canonical_of

NO_FIELD = "this scene has no field, so nothing can be asked: drsplat embed and drsplat register make one"
CAMERAS_FILE = "cameras.json"  # of a trained model


def is_bare(path: Path) -> bool:
    """Return True for a scene's file, or a trained model's folder without a field."""
    if not path.is_dir():
        return path.is_file()
    if any(path.glob("*.field")):
        return False
    return (path / "point_cloud").is_dir() or (path / TILES).is_file() or is_moving(path)


def open_bare(path: Path, capture: str | None = None, threads: int = 0) -> Scene:
    """Open the scene of a file or a trained model's folder, with an empty field.

    capture: its photos; None takes the cameras of the model's folder, if they are there.

    Raises: as `read_scene` and `read_views`.
    """
    own = path if path.is_dir() and (path / CAMERAS_FILE).is_file() else None
    cameras = capture if capture is not None else own
    views = () if cameras is None else tuple(read_views(cameras))
    scene, name = tiles_or_scene(path), path.resolve().stem
    rows = canonical_of(scene) if isinstance(scene, Moving) else scene
    nobody = EncoderIdentity("none", 1)
    code = PQCode(
        Codebook(np.zeros((1, 256, 1), np.float32), None, nobody),
        np.empty((0, 1, GROUP_ROWS), np.uint8),
        None,
        np.empty(0, np.float32),
    )
    return Scene(
        LanguageField(np.empty(0, np.uint32), code, nobody, rows.fingerprint, len(rows)),
        scene,
        views,
        _no_encoder,
        name=name,
        threads=threads,
        path=path,
    )


def _no_encoder() -> Encoder:
    raise InputError(NO_FIELD)
