"""The state of an unfinished run in one file, and going on from it.

A run that was killed and goes on ends with the same bits as one that was not.
"""

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import DrSplatWarning, FormatError, InputError, MismatchError
from ..formats.captures import SparsePoints
from ..formats.checksums import hash_file
from ..formats.tensors import check_tensors, read_tensors, write_tensors
from ..scene.views import View
from .run import Run
from .schedules import same_until

VERSION = "2"
_ROWS = {"means": "n axis", "log_scales": "n axis", "quats": "n four", "logits": "n", "sh": "n coefficient axis"}
EXPECTED = {
    f"{group}.{name}": ("float32", dimensions)
    for group in ("parameters", "first", "second")
    for name, dimensions in _ROWS.items()
} | {"order.pending": ("int64", "pending")}
OF_DENSITY = {f"density.{name}": ("float32", "n") for name in ("pull", "times_seen", "radii")}
TEXTS = ("iteration", "iterations", "rng", "seconds", "stage_seconds", "history", "start", "settings", "capture")


def capture_fingerprint(views: Sequence[View], points: SparsePoints | None) -> str:
    """Hash, as JSON, poses and cameras by name, the photos' files, the points that were given, and masks if any.

    Raises: InputError: a photo cannot be read.
    """
    poses, photos, start, masks = (hashlib.blake2b(digest_size=16) for _ in range(4))
    for view in views:
        poses.update(f"{view.name}\0{view.width}x{view.height} {view.distortion}\0".encode())
        poses.update(view.K.tobytes() + view.cam_from_world.tobytes())
        photos.update(_file_hash(view.image_path))
        masks.update(f"{view.name}\0{view.mask_inverted}".encode() + _file_hash(view.mask_path))
    if points is not None:
        start.update(np.ascontiguousarray(points.positions).tobytes())
        start.update(np.ascontiguousarray(points.colors).tobytes())
    named = {"poses": poses, "photos": photos, "points": start}
    if any(view.mask_path is not None for view in views):
        named["masks"] = masks
    return json.dumps({name: digest.hexdigest() for name, digest in named.items()})


def _file_hash(path: Path | None) -> bytes:
    if path is None:
        return b""
    try:
        return bytes.fromhex(hash_file(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def save_checkpoint(path: Path, run: Run, capture: str) -> None:
    """Write the run's state in place of the one before, whole or not at all. Raises: InputError: the disk is full."""
    arrays, texts = run.state()
    texts |= {"version": VERSION, "settings": run.settings.fingerprint, "capture": capture}
    texts["iterations"] = str(run.settings.iterations)
    write_tensors(path, arrays, texts, overwrite=True)


def load_checkpoint(path: Path, run: Run, capture: str) -> None:
    """Bring a fresh run of the same settings on the same capture to where the checkpoint was taken.

    The number of iterations may be another one, unless so many are done.

    Raises: FormatError: a damaged file. MismatchError: of other settings, poses, photos or points.
    """
    try:
        arrays, texts = read_tensors(path)
    except FormatError as error:
        raise FormatError(f"{error}: remove it to start anew") from error
    if texts.get("version") != VERSION or not all(name in texts for name in TEXTS):
        raise FormatError(f"{path}: expected a checkpoint of version {VERSION}: remove it to start anew")
    changed = _changed(texts, run, capture)
    if changed:
        raise MismatchError(
            f"{path} is of a run with other {' and '.join(changed)}: go on with the same ones, name another "
            "output folder, or start anew with overwrite=True"
        )
    is_default = run.settings.strategy == "default"
    check_tensors(arrays, EXPECTED | (OF_DENSITY if is_default else {}), str(path))
    try:
        _check_values(arrays, texts, run)
        run.restore(arrays, texts)
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{path}: damaged: {error}: remove it to start anew") from error
    _check_length(path, run, int(texts["iterations"]))


def _changed(texts: Mapping[str, str], run: Run, capture: str) -> list[str]:
    """Return what differs: settings, poses, photos, points."""
    names = [] if texts["settings"] == run.settings.fingerprint else [_settings_text(texts["settings"], run)]
    if texts["capture"] == capture:
        return names
    try:
        before, now = json.loads(texts["capture"]), json.loads(capture)
        return names + [name for name in now | before if before.get(name) != now.get(name)]
    except (ValueError, AttributeError):
        return [*names, "inputs"]


def _settings_text(before: str, run: Run) -> str:
    """Return "settings" with the names of those that differ, where the checkpoint tells."""
    try:
        then, now = json.loads(before), json.loads(run.settings.fingerprint)
        names = sorted(name for name in then | now if then.get(name) != now.get(name))
    except (ValueError, TypeError, AttributeError):
        return "settings"
    return f"settings ({', '.join(names)})"


def _check_length(path: Path, run: Run, planned: int) -> None:
    """Check the planned iterations of a checkpoint: `run` may have others, but not fewer than it has done.

    Raises: MismatchError: it has done as many already.
    Warns: DrSplatWarning: a run planned for so many would be another by now.
    """
    if run.iteration >= run.settings.iterations:
        raise MismatchError(
            f"{path}: the run has done {run.iteration:,} iterations already, {run.settings.iterations:,} are asked "
            "for: ask for more, or start anew with overwrite=True"
        )
    if not same_until(replace(run.settings, iterations=planned), run.settings, run.iteration):
        warnings.warn(
            f"{path}: the run was planned for {planned:,} iterations and left out an opacity reset near its end: the "
            f"scene will not be the one of a run planned for {run.settings.iterations:,}; overwrite=True makes that "
            "one",
            DrSplatWarning,
            stacklevel=4,
        )


def _check_values(arrays: Mapping[str, np.ndarray], texts: Mapping[str, str], run: Run) -> None:
    """Check a checkpoint's values. Raises: ValueError: sizes or indices that a run of these settings cannot have."""
    for name, array in run.optimizer.state().items():
        if arrays[name].shape[1:] != array.shape[1:]:
            raise ValueError(f"{name} has rows {arrays[name].shape[1:]}, not {array.shape[1:]}")
    pending = arrays["order.pending"]
    if len(pending) and not (pending.min() >= 0 and pending.max() < len(run.views)):
        raise ValueError(f"a view beyond the {len(run.views)} there are")
    if not 0 <= int(texts["iteration"]) < int(texts["iterations"]):
        raise ValueError(f"iteration {texts['iteration']}")
