"""The state of an unfinished run in one file, and going on from it.

A run that was killed and goes on ends with the same bits as one that was not.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import FormatError, MismatchError
from ..formats.captures import SparsePoints
from ..formats.tensors import check_tensors, read_tensors, write_tensors
from ..views import View
from .run import Run

VERSION = "1"
_ROWS = {
    "means": "n axis", "log_scales": "n axis", "quats": "n four", "logits": "n",
    "sh": "n coefficient axis",
}  # fmt: skip
EXPECTED = {
    f"{group}.{name}": ("float32", dimensions)
    for group in ("parameters", "first", "second")
    for name, dimensions in _ROWS.items()
} | {"order.pending": ("int64", "pending")}
OF_DENSITY = {f"density.{name}": ("float32", "n") for name in ("pull", "times_seen", "radii")}
TEXTS = ("iteration", "rng", "seconds", "stage_seconds", "history", "settings", "capture")


def capture_fingerprint(views: Sequence[View], points: SparsePoints | None) -> str:
    """Of names, poses, cameras and points: what a run was started on, but for the photos' pixels."""
    digest = hashlib.blake2b(digest_size=16)
    for view in views:
        digest.update(f"{view.name}\0{view.width}x{view.height} {view.distortion}\0".encode())
        digest.update(view.K.tobytes() + view.cam_from_world.tobytes())
    if points is not None:
        digest.update(np.ascontiguousarray(points.positions).tobytes())
        digest.update(np.ascontiguousarray(points.colors).tobytes())
    return digest.hexdigest()


def save_checkpoint(path: Path, run: Run, capture: str) -> None:
    """Write the run's state in place of the one before, whole or not at all.

    Raises: InputError: the disk is full.
    """
    arrays, texts = run.state()
    texts |= {"version": VERSION, "settings": run.settings.fingerprint, "capture": capture}
    write_tensors(path, arrays, texts, overwrite=True)


def load_checkpoint(path: Path, run: Run, capture: str) -> None:
    """Bring a fresh run of the same settings on the same capture to where the checkpoint was taken.

    Raises: FormatError: a damaged file. MismatchError: it is of other settings or another capture.
    """
    try:
        arrays, texts = read_tensors(path)
    except FormatError as error:
        raise FormatError(f"{error}: remove it to start anew") from error
    if texts.get("version") != VERSION or not all(name in texts for name in TEXTS):
        raise FormatError(
            f"{path}: expected a checkpoint of version {VERSION}: remove it to start anew"
        )
    for name, given in (("settings", run.settings.fingerprint), ("capture", capture)):
        if texts[name] != given:
            raise MismatchError(
                f"{path} is of an unfinished run with other {name}: go on with the same ones, name "
                "another output folder, or start anew with overwrite=True"
            )
    is_default = run.settings.strategy == "default"
    check_tensors(arrays, EXPECTED | (OF_DENSITY if is_default else {}), str(path))
    try:
        _check_values(arrays, texts, run)
        run.restore(arrays, texts)
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{path}: damaged: {error}: remove it to start anew") from error


def _check_values(arrays: Mapping[str, np.ndarray], texts: Mapping[str, str], run: Run) -> None:
    """Raises: ValueError: sizes or indices that a run of these settings cannot have."""
    for name, array in run.optimizer.state().items():
        if arrays[name].shape[1:] != array.shape[1:]:
            raise ValueError(f"{name} has rows {arrays[name].shape[1:]}, not {array.shape[1:]}")
    pending = arrays["order.pending"]
    if len(pending) and not (pending.min() >= 0 and pending.max() < len(run.views)):
        raise ValueError(f"a view beyond the {len(run.views)} there are")
    if not 0 < int(texts["iteration"]) <= run.settings.iterations:
        raise ValueError(f"iteration {texts['iteration']}")
