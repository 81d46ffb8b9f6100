"""Workbench that computes questions in a few processes, one in each, and has views which wait added in another.

Of questions some more wait, the rest are told to come again. No view is lost with its process: it is on disk, and
another process goes on.
"""

import asyncio
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Condition, Lock, Thread
from typing import Any
from weakref import finalize

from ...errors import DrSplatError
from ...formats.live_views import LiveViews
from ...query import SceneFiles
from .guards import GONE
from .live import ACTS_ON_FILES, ADD, REFUSE, capture_of
from .metrics import Metrics
from .replies import BUG, BusyError, LostError, Reply, unpacked
from .scene_folder import SceneFolder, without_paths
from .worker import Workplace

OPENING_TIMEOUT_S = 600.0  # for a worker to open a scene and load its models
MAX_ANSWER_BYTES = 1 << 30
GONE_PATIENCE_S = 2.0  # with work whose client has gone: to end its process costs the next one the opening of scenes
WORKER_COMMAND = [sys.executable, "-P", "-m", "drsplat.fronts.serving.worker"]


@dataclass(eq=False)
class Job:
    """A question, and what becomes of it. act: see `worker.reply_to`. then: called with the reply, waited for or not.

    Ended when nobody waits for it any more: it is not begun, and the process that computes it is killed.
    """

    act: str
    scene: str = ""
    asked: Mapping[str, Any] = field(default_factory=dict)
    then: Callable[[Reply], None] = lambda _: None
    ended: bool = False
    _process: "subprocess.Popen[bytes] | None" = None
    _lock: Lock = field(default_factory=Lock)

    @property
    def opens(self) -> bool:
        """True if files are read and models loaded for it, which may take longer than a question."""
        return (bool(self.scene) and self.act not in ACTS_ON_FILES) or self.act == "catalogue-ask"

    def begin(self, process: "subprocess.Popen[bytes]") -> bool:
        """Say where it is computed; False where it has ended already."""
        with self._lock:
            self._process = process
            return not self.ended

    def leave(self) -> None:
        """Let go of the process, which now does what other questions need as well, or is free."""
        with self._lock:
            self._process = None

    def end(self, kill: bool = True) -> None:
        """Keep it from beginning. kill: whether the process that computes it ends, too."""
        with self._lock:
            self.ended = True
            if kill and self._process is not None:
                self._process.kill()


class Workbench:
    """`limits.workers` processes, started when they are first needed and again when they have ended."""

    def __init__(self, place: Workplace, metrics: Metrics) -> None:
        self._limits, self._metrics = place.limits, metrics
        self._inside, self._lock = 0, Lock()
        self._workers = [WorkerProcess(place) for _ in range(place.limits.workers)]
        self._idle: SimpleQueue[WorkerProcess] = SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(place.limits.workers, thread_name_prefix="worker")

    def start(self) -> None:
        """Start the processes before somebody asks."""
        for worker in self._workers:
            worker.started()

    async def run(self, job: Job) -> Reply:
        """Compute the answer; cancelling ends the process that computes it, at once or `GONE_PATIENCE_S` after `GONE`.

        Raises: BusyError. LostError: the process ended.
        """
        with self._lock:
            if self._inside >= self._limits.workers + self._limits.waiting:
                raise BusyError(f"{self._inside} requests are computed or wait already: come again")
            self._inside += 1
        self._metrics.waiting.inc()
        future = self._threads.submit(self._counted, job)
        future.add_done_callback(self._left)
        try:
            return await asyncio.wrap_future(future)
        except asyncio.CancelledError as cancelled:
            is_gone = GONE in cancelled.args
            job.end(kill=not is_gone)
            if is_gone:
                asyncio.get_running_loop().call_later(GONE_PATIENCE_S, job.end)
            raise

    def close(self) -> None:
        """End all processes; what they compute gets no answer."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.kill()
        self._threads.shutdown(wait=True)
        for worker in self._workers:
            worker.close()

    def _left(self, done: Future[Reply]) -> None:
        if done.cancelled():  # while it waited
            self._metrics.waiting.dec()
        with self._lock:
            self._inside -= 1

    def _counted(self, job: Job) -> Reply:
        self._metrics.waiting.dec()
        worker = self._idle.get()
        try:
            with self._metrics.computing.track_inprogress():
                reply = worker.answer(job)
                job.then(reply)
                return reply
        finally:
            self._idle.put(worker)


class WorkerProcess:
    """A process and the line to it. Only its closing is for several threads."""

    def __init__(self, place: Workplace) -> None:
        self._place, self._closed = place, False
        self._opened: set[str] = set()
        self._line: tuple[subprocess.Popen[bytes], Connection] | None = None
        self._end: finalize[..., WorkerProcess] | None = None

    def answer(self, job: Job) -> Reply:
        """Open the job's scene if need be and compute its answer. Raises: LostError: the process ended."""
        if job.opens:
            try:
                opened = self._open(job)
            except LostError:  # it has ended while it was idle, and another one is asked
                if job.ended:
                    raise
                opened = self._open(job)
            if opened.status != 200:
                return opened
        return self._reply(job, job.act, job.asked)

    def started(self) -> "tuple[subprocess.Popen[bytes], Connection]":
        if self._line is None:
            if self._closed:
                raise LostError("the service stops")
            self._line = _process(self._place)
            self._end = finalize(self, _end, *self._line)
            self._opened = set()
        return self._line

    def kill(self) -> None:
        """End the process for good; a job that waits for it fails with `LostError`."""
        self._closed = True
        if self._line is not None:
            self._line[0].kill()

    def close(self) -> None:
        if self._end is not None:
            self._end()

    def _open(self, job: Job) -> Reply:
        """Open a scene; the first time may take long, and only so can it be asked at all."""
        seconds = None if job.scene in self._opened else OPENING_TIMEOUT_S
        reply = self._reply(job, "open", {"for": job.act}, seconds)
        if reply.status == 200:
            self._opened.add(job.scene)
        return reply

    def _reply(self, job: Job, act: str, asked: Mapping[str, Any], seconds: float | None = None) -> Reply:
        """Return the answer of the process. seconds: how long it may take; None: until the job ends."""
        process, line = self.started()
        if seconds is None and not job.begin(process):
            raise LostError("nobody waits for it")
        message = json.dumps({"act": act, "scene": job.scene, "asked": dict(asked)})
        try:
            line.send_bytes(message.encode())
            if not line.poll(seconds):
                raise TimeoutError(f"not within {seconds:g} s")
            return unpacked(line.recv_bytes(MAX_ANSWER_BYTES))
        except (OSError, EOFError) as error:
            raise LostError(f"{self._lost(error)}: try again") from error
        finally:
            job.leave()

    def _lost(self, error: Exception) -> str:
        """Return why the process is no more; the next question starts another."""
        process, self._line = self.started()[0], None
        if self._end is not None:
            self._end()
        code = process.returncode
        name = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
        return f"the process that computed it ended ({type(error).__name__ if code == 0 else name})"


def _process(place: Workplace) -> "tuple[subprocess.Popen[bytes], Connection]":
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [*WORKER_COMMAND, str(theirs.fileno()), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # Ctrl-C is for the service, which ends it
        )
    line = Connection(ours.detach())
    with suppress(OSError):  # told when it is first asked
        line.send_bytes(place.to_json().encode())
    return process, line


def _end(process: "subprocess.Popen[bytes]", line: Connection) -> None:
    process.kill()
    process.wait()
    line.close()


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
        self._metrics.views.labels("taken").inc()
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
                files = self._scene_folder.files(scene)
                while names := self._waiting(scene, files):
                    try:
                        self._add(scene, names)
                    except LostError:
                        self._add_alone(scene, names)
                    if self._waiting(scene, files)[:1] == names[:1]:
                        raise DrSplatError("views of this scene are not added: the log of the service says why")
            except DrSplatError as error:
                if not self._closed:
                    self._problems[scene] = without_paths(str(error), self._scene_folder.roots)
            except Exception as error:
                if not self._closed:
                    _log.error("views of %r were not added", scene, exc_info=error)
                    self._problems[scene] = BUG

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
        if reply.status != 200:
            raise DrSplatError(json.loads(reply.body)["error"])
        return reply
