"""Answers as files: a scene with columns, a picture, a flight."""

import io
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ...authoring.filming.looking import looking_at, swing
from ...base.arrays import Pixels, Vector3
from ...base.contents import AnyPath
from ...drawing.pictures import as_pixels
from ...errors import InputError
from ...formats.gaussian_ply import write_gaussians
from ...formats.replacing import replacing
from ...kernels import render_channels
from ...scene.views import View
from . import results
from .session import Session
from .tiled import TiledSession

BACKGROUND = np.array([0.078, 0.086, 0.106], np.float32)
GIF_SIZE_PIXELS, GIF_FRAMES, GIF_FRAME_MS = (480, 360), 40, 60
GIF_COLORS = 128
MAX_FILES, MAX_BYTES = 200, 8 << 30  # of a session
MAX_SENT_BYTES = 64 << 20  # of a file for a browser


def save_scene(path: AnyPath, session: Session, *, selected_only: bool = False) -> int:
    """Write what is not hidden as PLY with `relevancy` and `match_id`, -1 for none; returns how many.

    Raises: InputError: the file exists; nothing is selected where `selected_only`.
    """
    gaussians, ids = session.edited(selected_only=selected_only)
    count = len(session.scene.gaussians)
    own = ids < count  # what edits added answers nothing
    columns = {"relevancy": np.zeros(len(ids), np.float32), "match_id": np.full(len(ids), -1, np.int32)}
    columns["relevancy"][own] = results.relevancy(session.results, count)[ids[own]]
    columns["match_id"][own] = results.match_ids(session.results, count)[ids[own]]
    write_gaussians(path, gaussians, columns, is_edited=session.edits.is_edited)
    return len(gaussians)


def picture_of(session: Session, view: View) -> Pixels:
    """Render what the viewer shows from a camera in the world."""
    if isinstance(session, TiledSession):
        seen, colors = session.seen_with_colors(view)
        drawn = render_channels(seen.splats, view, colors, BACKGROUND, threads=session.scene.threads)
        return as_pixels(drawn.channels)
    splats = session.edits.splats if session.edits.is_edited else session.here.splats
    drawn = render_channels(splats, view, session.drawn_colors, BACKGROUND, threads=session.scene.threads)
    return as_pixels(drawn.channels)


def flight_gif(session: Session, eye: Vector3, target: Vector3, up: Vector3, frames: int = GIF_FRAMES) -> bytes:
    """Render a swing around a target in the world as an endless GIF."""
    places = swing(eye, target, up, frames)
    pictures = [picture_of(session, looking_at(at, target, up, GIF_SIZE_PIXELS)) for at in places]
    return gif_of(pictures)


def gif_of(pictures: Sequence[Pixels]) -> bytes:
    """Write frames with one palette, so that colours do not flicker."""
    palette = Image.fromarray(pictures[0]).quantize(GIF_COLORS)
    frames = [Image.fromarray(one).quantize(palette=palette) for one in pictures]
    out = io.BytesIO()
    frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=GIF_FRAME_MS, loop=0)
    return out.getvalue()


class Saves:
    """Files of one session, to a folder or, without one, only to the browser that asked; never over another file.

    folder: made when something is first saved; None for none.
    """

    def __init__(self, folder: Path | None, most_files: int = MAX_FILES, most_bytes: int = MAX_BYTES) -> None:
        self.folder, self.files_left, self.bytes_left = folder, most_files, most_bytes

    def save(self, stem: str, suffix: str, write: Callable[[Path], object]) -> tuple[Path, bytes]:
        """Save a file and return its path and content, which is empty if it is too large for a browser.

        write: makes a file of a name. Raises: InputError: this session has saved enough; the file is too
        large for a browser and there is no folder.
        """
        if self.files_left < 1 or self.bytes_left < 1:
            raise InputError("this session has saved enough: start drsplat view anew to save more")
        if self.folder is None:
            with tempfile.TemporaryDirectory() as folder:
                return self._saved(Path(folder) / f"{stem}{suffix}", write)
        self.folder.mkdir(parents=True, exist_ok=True)
        return self._saved(new_name(self.folder, stem, suffix), write)

    def _saved(self, path: Path, write: Callable[[Path], object]) -> tuple[Path, bytes]:
        self.files_left -= 1
        write(path)
        size = path.stat().st_size
        self.bytes_left -= size
        if size <= MAX_SENT_BYTES:
            return path, path.read_bytes()
        if self.folder is None:
            raise InputError(f"{size / 1e6:,.0f} MB are too much to send: start drsplat view with --save-dir FOLDER")
        return path, b""


def new_name(folder: Path, stem: str, suffix: str) -> Path:
    """Return the path of a new file in the folder: stem, or stem-2 and so on."""
    path, number = folder / f"{stem}{suffix}", 1
    while os.path.lexists(path):
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path


def write_bytes(path: Path, data: bytes) -> None:
    with replacing(path, overwrite=False) as file:
        file.write(data)
