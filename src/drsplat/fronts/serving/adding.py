"""A thread that has views which wait added to their scenes, one scene after another, in a process of its own.

Nothing is lost with that process: views are on disk, and another process goes on with them.
"""

import json
import logging
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from threading import Condition, Thread

from ...errors import DrSplatError
from ...formats.live_views import LiveViews
from ...query import SceneFiles
from .live import ADD, REFUSE, capture_of
from .metrics import Metrics
from .replies import BUG, LostError, Reply
from .scene_folder import SceneFolder, without_paths
from .workbench import Job, WorkerProcess
from .worker import Workplace

RETRY_S = 5.0  # after something went wrong that may be right later
_log = logging.getLogger(__name__)


class Adding:
    """The thread. `start` begins with all scenes that have views, `notice` has one looked at."""

    def __init__(self, scene_folder: SceneFolder, place: Workplace, metrics: Metrics) -> None:
        self._scene_folder, self._metrics = scene_folder, metrics
        self._worker = WorkerProcess(replace(place, limits=replace(place.limits, workers=1)))
        self._turn = Condition()
        self._due: list[str] = []
        self._working: tuple[str, frozenset[str]] = "", frozenset()
        self._problems: dict[str, str] = {}
        self._counts: dict[str, int] = {}
        self._closed = False
        self._thread: Thread | None = None

    def start(self) -> None:
        """Begin with the scenes that have views which wait."""
        self._notice(self._scene_folder.folders())

    def notice(self, scene: str) -> None:
        """Add the views of a scene soon, as another one has come."""
        self._count(scene, self._counts.get(scene, 0) + 1)
        self._metrics.view_taken()
        self._notice([scene])

    def working(self, scene: str) -> list[str]:
        """Return the views of a scene that are being added now."""
        at, names = self._working
        return sorted(names) if at == scene else []

    def problem(self, scene: str) -> str:
        """Return why the views of a scene go on waiting, or ""."""
        return self._problems.get(scene, "")

    def close(self) -> None:
        """End the thread and its process. What is being added waits for the next start."""
        with self._turn:
            self._closed = True
            self._turn.notify_all()
        self._worker.kill()
        if self._thread is not None:
            self._thread.join()
        self._worker.close()

    def _notice(self, scenes: Iterable[str]) -> None:
        with self._turn:
            self._due += [scene for scene in scenes if scene not in self._due]
            if self._thread is None and not self._closed:
                self._thread = Thread(target=self._run, name="adding views", daemon=True)
                self._thread.start()
            self._turn.notify_all()

    def _run(self) -> None:
        while True:
            with self._turn:
                while not self._due and not self._closed:
                    if not self._turn.wait(RETRY_S if self._problems else None):
                        self._due = list(self._problems)
                if self._closed:
                    return
                scene = self._due.pop(0)
            self._problems.pop(scene, None)
            try:
                self._add_all(scene)
            except Exception as error:
                if not self._closed:
                    self._problems[scene] = self._reason(scene, error)

    def _reason(self, scene: str, error: Exception) -> str:
        """Return why views go on waiting, without folders of this machine; log a fault of ours."""
        if isinstance(error, DrSplatError):
            return without_paths(str(error), self._scene_folder.roots)
        _log.error("views of %r were not added", scene, exc_info=error)
        return BUG

    def _add_all(self, scene: str) -> None:
        """Add the views that wait, until none does. Raises: DrSplatError: they go on waiting."""
        files = self._scene_folder.files(scene)
        while names := self._waiting(scene, files):
            try:
                self._add(scene, names)
            except LostError:
                self._add_alone(scene, names)
            if self._waiting(scene, files)[:1] == names[:1]:
                raise DrSplatError("views of this scene are not added: the log of the service says why")

    def _waiting(self, scene: str, files: SceneFiles) -> list[str]:
        names = [view.name for view in LiveViews(capture_of(files)).every("waiting")]
        self._count(scene, len(names))
        return names

    def _count(self, scene: str, number: int) -> None:
        self._counts[scene] = number
        self._metrics.views_waiting.set(sum(self._counts.values()))

    def _add_alone(self, scene: str, names: list[str]) -> None:
        """Add views one by one after the process ended, and refuse the one that ends it again and again."""
        for name in names:
            for last in (False, True):
                try:
                    self._add(scene, [name])
                    break
                except LostError as error:
                    if self._closed:
                        raise
                    if last:
                        self._ask(Job(REFUSE, scene, {"name": name, "reason": str(error)}))
                        self._metrics.views_done((), 1)

    def _add(self, scene: str, names: list[str]) -> None:
        self._working = scene, frozenset(names)
        try:
            done = json.loads(self._ask(Job(ADD, scene, {"names": names})).body)
            self._metrics.views_done(done["seconds"], done["num_refused"])
        finally:
            self._working = "", frozenset()

    def _ask(self, job: Job) -> Reply:
        """Ask the process to do something. Raises: LostError: it ended. DrSplatError: it could not."""
        reply = self._worker.answer(job)
        if reply.status == 200:
            return reply
        reason = "this cannot be added"
        with suppress(ValueError, KeyError):
            reason = json.loads(reply.body)["error"]
        raise DrSplatError(reason)
