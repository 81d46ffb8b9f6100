"""Answers as files: a scene with columns, a picture, a flight."""

import io
import os
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
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
    count, found = len(session.scene.gaussians), session.results
    columns = {
        "relevancy": results.taken(results.relevancy(found, count), ids),
        "match_id": results.taken(results.match_ids(found, count), ids, fill=-1),
    }
    write_gaussians(path, gaussians, columns, is_edited=session.edits.is_edited)
    return len(gaussians)


def picture_of(session: Session, view: View) -> Pixels:
    """Render what the viewer shows from a camera in the world."""
    seen = session.seen(view)
    drawn = render_channels(seen.splats, view, session.seen_colors(seen), BACKGROUND, threads=session.scene.threads)
    return as_pixels(drawn.channels)


def flight_gif(session: Session, eye: Vector3, target: Vector3, up: Vector3, frames: int = GIF_FRAMES) -> bytes:
    """Render a swing around a target in the world as an endless GIF, with one palette: colours do not flicker."""
    places = swing(eye, target, up, frames)
    drawn = [Image.fromarray(picture_of(session, looking_at(at, target, up, GIF_SIZE_PIXELS))) for at in places]
    palette = drawn[0].quantize(GIF_COLORS)
    first, *others = (picture.quantize(palette=palette) for picture in drawn)
    out = io.BytesIO()
    first.save(out, "GIF", save_all=True, append_images=others, duration=GIF_FRAME_MS, loop=0)
    return out.getvalue()


class Saves:
    """Files of one session, to a folder or, without one, only to the browser that asked; never over another file.

    folder: made when something is first saved; None for none. films: pictures that are done and all, of those that
    are being drawn, by the names that browsers gave them.
    """

    def __init__(self, folder: Path | None, most_files: int = MAX_FILES, most_bytes: int = MAX_BYTES) -> None:
        self.folder, self.files_left, self.bytes_left = folder, most_files, most_bytes
        self.films: dict[str, tuple[int, int]] = {}

    def save(self, stem: str, suffix: str, write: Callable[[Path], object]) -> tuple[Path, bytes]:
        """Save a file under a new name and return its path and content, which is empty where that is too large to send.

        write: makes a file of a name. Raises: InputError: this session has saved enough; the file is too
        large for a browser and there is no folder.
        """
        if self.files_left < 1 or self.bytes_left < 1:
            raise InputError("this session has saved enough: start drsplat view anew to save more")
        with tempfile.TemporaryDirectory() if self.folder is None else nullcontext(self.folder) as place:
            folder, number = Path(place), 1
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{stem}{suffix}"
            while os.path.lexists(path):
                number += 1
                path = folder / f"{stem}-{number}{suffix}"
            self.files_left -= 1
            write(path)
            size = path.stat().st_size
            self.bytes_left -= size
            if size <= MAX_SENT_BYTES:
                return path, path.read_bytes()
        if self.folder is None:
            raise InputError(f"{size / 1e6:,.0f} MB are too much to send: start drsplat view with --save-dir FOLDER")
        return path, b""


def write_bytes(path: Path, data: bytes) -> None:
    with replacing(path, overwrite=False) as file:
        file.write(data)
