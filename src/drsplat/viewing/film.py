"""The controls of a film: key frames taken from the present view, the path played, saved and filmed."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..errors import InputError
from ..filming.encoding import ffmpeg
from ..filming.looking import before
from ..filming.path_files import path_of, write_path
from ..filming.paths import CameraPath, KeyFrame, frame_count
from ..filming.writing import write_film
from ..formats.json_files import document_in
from ..terminal import counted
from . import saving
from .actions import Actions
from .choosing import Maker
from .texts import paragraphs, printable
from .uploads import MOST_BYTES
from .window import Window

FPS, SIZE = 24.0, (960, 720)
LEAST_S, MOST_S, SECONDS = 1.0, 60.0, 8.0
MOST_KEYS = 200
STEP_S = 1 / 30  # between two places of a camera that flies along the path
SUFFIXES = (".mp4", ".webm", ".webp", ".gif")
NONE_YET = "No key frames. Move the camera, and add what you see."


@runtime_checkable
class Saver(Protocol):
    """Who gives a file to the browser that a press came from: event, stem, suffix, and what writes it."""

    def __call__(self, event: Any, stem: str, suffix: str, write: Callable[[Path], None], /) -> None: ...


@runtime_checkable
class Taker(Protocol):
    """Who makes a button that takes a file in: label, the kind of file, what is done with it."""

    def __call__(self, label: str, mime_type: str, act: Callable[[Any], None], /) -> Any: ...


class FilmControls:
    """A folder of controls; all who look at the scene share the key frames. button, upload, save: who makes, takes
    in and hands out.

    flights: where a camera is moved, so that nothing else waits for it.
    """

    def __init__(self, window: Window, button: Maker, upload: Taker, save: Saver, flights: Actions) -> None:
        self.window, self.save, self.flights = window, save, flights
        self.keys: list[KeyFrame] = []
        self.even = self.is_playing = False
        gui = window.server.gui
        with gui.add_folder("Film", expand_by_default=False):
            button("Add key frame", self.add)
            button("Remove the last", self.remove)
            self.seconds = gui.add_slider("Seconds", LEAST_S, MOST_S, 1.0, SECONDS)
            self.closed = gui.add_checkbox("Back to the first", False)
            self.playing = button("Play", self.play)
            self.suffix = gui.add_dropdown("As", SUFFIXES if ffmpeg() else SUFFIXES[2:])
            button("Save the film", self.film)
            button("Save the path", self.save_path)
            self.file = upload("Load a path", "application/json", self.load_path)
            self.said = gui.add_html(paragraphs(NONE_YET))

    def path(self) -> CameraPath:
        """Raises: InputError: fewer than two key frames."""
        if len(self.keys) < 2:
            raise InputError(f"a path goes through two key frames or more, and there are {len(self.keys)}: add some")
        seconds = float(np.clip(self.seconds.value, LEAST_S, MOST_S))
        return CameraPath(tuple(self.keys), bool(self.closed.value), self.even, seconds, FPS, SIZE)

    def add(self, event: Any) -> None:
        """What the browser that pressed sees. Raises: InputError: there are enough."""
        if len(self.keys) >= MOST_KEYS:
            raise InputError(f"a path of the viewer has up to {MOST_KEYS} key frames: remove some")
        self.keys = [replace(key, seconds=None) for key in self.keys]  # nobody says when a new one is passed
        self.keys.append(KeyFrame.of(self.window.seen_by(event.client, SIZE)))
        self._tell()

    def remove(self, _: Any) -> None:
        if self.keys:
            self.keys.pop()
        self._tell()

    def play(self, event: Any) -> None:
        """Along the path, or stop there where it is on its way."""
        if self.is_playing:
            self.is_playing = False
            return
        path = self.path()
        self.is_playing = True
        self.flights.do("film", lambda: self._fly(event.client, path))

    def save_path(self, event: Any) -> None:
        path = self.path()
        self.save(event, "path", ".json", lambda file: write_path(file, path))

    def load_path(self, event: Any) -> None:
        """Of a file, in place of the key frames that there are: ours, or nerfstudio's. Flies to its first one.

        Raises: InputError: empty or too large. FormatError: it is no path.
        """
        data, name = self.file.value.content, printable(self.file.value.name, 60)
        if not 0 < len(data) <= MOST_BYTES:
            raise InputError(f"{name}: expected a path of 1 to {MOST_BYTES:,} bytes")
        path = path_of(document_in(data, name), name)
        self.keys, self.even, self.closed.value = list(path.keys), path.even, path.closed
        lasts = path.seconds or (path.keys[-1].seconds or 0) - (path.keys[0].seconds or 0) or SECONDS
        self.seconds.value = float(np.clip(round(lasts), LEAST_S, MOST_S))
        self._tell()
        self.window.stand(event.client, self.keys[0])

    def film(self, event: Any) -> None:
        """As the viewer shows the scene now, by this package's own renderer."""
        path, session = self.path(), self.window.session
        views = path.views(frame_count(path.seconds or SECONDS, FPS), SIZE)
        suffix = self.suffix.value if self.suffix.value in SUFFIXES else SUFFIXES[2]
        self.said.content = paragraphs(f"Drawing {counted(len(views), 'picture')} ...")
        pictures = (saving.picture_of(session, view) for view in views)
        try:
            self.save(event, "film", suffix, lambda file: write_film(file, pictures, FPS))
        finally:
            self._tell()

    def _tell(self) -> None:
        self.said.content = paragraphs(counted(len(self.keys), "key frame") if self.keys else NONE_YET)

    def _fly(self, client: Any, path: CameraPath) -> None:
        """A browser that has gone ends it; what it does then is not ours to tell."""
        self.playing.label = "Stop"
        begin, lasts = time.monotonic(), path.seconds or SECONDS
        try:
            with suppress(Exception):
                at = 0.0
                while self.is_playing and at < 1.0:
                    at = min((time.monotonic() - begin) / lasts, 1.0)
                    (key,) = path.at(np.array([at]))
                    self.window.stand(client, key)
                    time.sleep(STEP_S)
        finally:
            self.is_playing, self.playing.label = False, "Play"


def save_swing(window: Window, save: Saver, event: Any) -> None:
    """A swing around the best match, else what the browser looks at, as GIF."""
    session, camera = window.session, event.client.camera
    eye, target = (session.shown.frame.world(np.array(x)) for x in (camera.position, camera.look_at))
    found = [match for result in session.results for match in result.matches]
    if found:
        eye, target = before(found[0], session.scene.gaussians, session.scene.views, window.up), found[0].center
    data = saving.flight_gif(session, eye, target, window.up)
    save(event, "found", ".gif", lambda path: saving.write_bytes(path, data))
