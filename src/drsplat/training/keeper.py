"""Everything about a run that is not a step: its files, how it goes on, and its measures.

A run that was killed and goes on ends with the same bits as one that was not.
"""

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..errors import FormatError, InputError, MismatchError, warn
from ..formats.captures import SparsePoints
from ..formats.tensors import hash_file, read_tensors, write_tensors
from ..scene.views import View
from .evaluation import Evaluation, evaluate
from .model_folder import ModelFolder
from .run import Job, Run, Training
from .settings import same_until
from .start import Split
from .start_points import Start
from .training_photos import TrainingPhotos
from .transients import with_masks, without_transients

CHECKPOINT_S = 120.0
MAX_SCORED_TRAIN_PHOTOS = 16
VERSION = "3"


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
    if texts.get("version") != VERSION:
        raise FormatError(f"{path}: expected a checkpoint of version {VERSION}: remove it to start anew")
    settings = _differing(texts["settings"], run.settings.fingerprint)
    changed = [f"settings ({', '.join(settings)})"] if settings else []
    changed += _differing(texts["capture"], capture)
    if changed:
        raise MismatchError(
            f"{path} is of a run with other {' and '.join(changed)}: go on with the same ones, name another "
            "output folder, or start anew with overwrite=True"
        )
    try:
        run.restore(arrays, texts)
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"{path}: damaged: {error}: remove it to start anew") from error
    _check_length(path, run, int(texts["iterations"]))


def _differing(before: str, now: str) -> list[str]:
    """Return the names of what differs between two objects in JSON."""
    old, new = json.loads(before), json.loads(now)
    return [name for name in new | old if old.get(name) != new.get(name)]


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
        warn(
            f"{path}: the run was planned for {planned:,} iterations and left out an opacity reset near its end: the "
            f"scene will not be the one of a run planned for {run.settings.iterations:,}; overwrite=True makes that "
            "one",
            4,
        )


class Keeper:
    """One sitting of a run, with its folder or without one. place: for what lasts as long as the sitting."""

    def __init__(self, run: Run, split: Split, folder: ModelFolder | None, job: Job, place: Path) -> None:
        self.run, self.split, self.folder, self.job = run, split, folder, job
        self.masks = place if folder is None else folder.masks
        self.test_photos = TrainingPhotos(split.test, run.settings.photo_memory_bytes)
        self.capture = ""
        self.num_transient = 0
        self.saved = time.monotonic()

    def begin(self, points: SparsePoints | None, start: Start) -> None:
        """Go on with what is in the folder, or write what a run begins with."""
        run, folder = self.run, self.folder
        run.start = start.plain()
        if folder is None:
            return
        views = sorted(self._views, key=lambda view: view.name)
        self.capture = capture_fingerprint(views, points)
        views = [view.relative_to(-run.origin) for view in views]
        if folder.goes_on:
            load_checkpoint(folder.checkpoint, run, self.capture)
            if 0 < run.settings.transients_at < run.iteration:
                self._show(with_masks(self._views, self.masks))
            folder.results.unlink(missing_ok=True)  # until there are those of this length
        else:
            folder.write_start(views, start.points.moved(run.origin))
        folder.write_settings(views, run.settings)
        if not folder.goes_on:
            self._checkpoint(folder)  # whatever is written from here on can be gone on with

    def leave_transients_out(self) -> None:
        """Look for what moves between the photos, and train on without it; keep the masks."""
        begin = time.perf_counter()
        train, held_out = self.split
        gaussians, threads = self.run.optimizer.gaussians(), self.job.threads
        self._show(without_transients(train, gaussians, self.masks, held_out=held_out, threads=threads))
        self.run.seconds += time.perf_counter() - begin

    def _show(self, views: Sequence[View]) -> None:
        """Train on with the masks of these views. Held-out photos are measured as before: masks hide what fails."""
        self.num_transient = sum(new is not old for new, old in zip(views, self._views, strict=True))
        self.run.show(views[: len(self.split.train)])

    @property
    def _views(self) -> list[View]:
        return [*self.split.train, *self.split.test]

    def after_step(self, interrupted: bool) -> None:
        """Evaluate and save where it is time. Raises: KeyboardInterrupt: `interrupted`; all is in the checkpoint."""
        run, settings, folder = self.run, self.run.settings, self.folder
        if run.iteration == settings.iterations:
            return
        if settings.evaluate_every and run.iteration % settings.evaluate_every == 0:
            self._note()
        at = f"after iteration {run.iteration:,} of {settings.iterations:,}"
        if folder is not None:
            if run.iteration in self.job.save_at:
                folder.write_scene(run.iteration, run.gaussians())
            late = time.monotonic() - self.saved > CHECKPOINT_S
            # from the last but one, a longer run goes on as if it had been planned so
            last = run.iteration == settings.iterations - 1
            if late or last or interrupted or run.iteration % self.job.checkpoint_every == 0:
                self._checkpoint(folder)
            at = f"{at}, which {folder.checkpoint} holds: the same command, without overwrite=True, goes on from there"
        if interrupted:
            raise KeyboardInterrupt(at)

    def _checkpoint(self, folder: ModelFolder) -> None:
        save_checkpoint(folder.checkpoint, self.run, self.capture)
        self.saved = time.monotonic()

    def _note(self) -> None:
        scores = self._evaluated(self.split.test, self.test_photos)
        if scores is not None:
            self.run.history.append(
                {
                    "iteration": self.run.iteration, "psnr_test": scores.psnr, "ssim_test": scores.ssim,
                    "num_gaussians": len(self.run.optimizer), "seconds": self.run.seconds,
                }
            )  # fmt: skip

    def _evaluated(
        self, views: Sequence[View], photos: TrainingPhotos, pictures: Path | None = None
    ) -> Evaluation | None:
        run = self.run
        return evaluate(
            run.optimizer.on_host(), views, photos, run.settings,
            near=run.near, pictures=pictures, threads=self.job.threads,
        )  # fmt: skip

    def finish(self) -> Training:
        """Measure, write the scene and, last, the results. The checkpoint stays, for a longer run."""
        run, folder = self.run, self.folder
        gaussians = run.gaussians()
        if folder is not None:
            folder.write_scene(run.settings.iterations, gaussians)
        pictures = folder.test_pictures if folder else None
        evaluation = self._evaluated(self.split.test, self.test_photos, pictures)
        # of as many photos that it was trained on, evenly spaced
        views, count = self.split.train, min(max(len(self.split.test), 1), MAX_SCORED_TRAIN_PHOTOS)
        chosen = np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int)
        some = [views[index] for index in chosen]
        scores = self._evaluated(some, TrainingPhotos(some, 0))
        train = scores.psnr if scores else float("nan")
        training = Training(
            gaussians, run.settings, evaluation, run.seconds, run.stage_seconds, run.history, train, run.start,
            sum(view.mask_path is not None for view in self._views), self.num_transient,
        )  # fmt: skip
        if evaluation is not None and training.held_out_far_below:
            warn(
                f"held-out photos are rendered at {evaluation.psnr:.1f} dB, those trained on at {train:.1f}: the scene "
                "looks right only from where it was photographed, as fog does, and searching it will disappoint. More "
                "photos from places in between help, as do sharper ones, right poses, and points to start from "
                "(points=FILE)",
                3,
            )
        if folder is not None:
            details = {"history": run.history, "test": asdict(evaluation) if evaluation else None}
            folder.write_json("results.json", training.measures() | details)
        return training
