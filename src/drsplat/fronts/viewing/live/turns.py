"""The threads of a viewer, in each of which one thing is done after the other."""

import asyncio
import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

from ...serving.replies import BusyError

MAX_REQUESTS_WAITING = 64
GRACE_S = 5.0
T = TypeVar("T")


class Turns:
    """A thread that does what it is given in that order. Exceptions go to whoever waits for the result."""

    def __init__(self, most_waiting: int = MAX_REQUESTS_WAITING, name: str = "viewer") -> None:
        self.most_waiting, self.waiting, self.is_ending = most_waiting, 0, False
        self._jobs: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        self._latest: dict[Hashable, object] = {}
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, act: Callable[[], T]) -> "Future[T]":
        """Do something later. Raises: BusyError: too much waits already."""
        with self._lock:
            if self.waiting >= self.most_waiting:
                raise BusyError(f"{self.waiting} requests wait already: come again")
        return self.complete(act)

    def complete(self, act: Callable[[], T]) -> "Future[T]":
        """Do the rest of something that had its turn before; it is never refused."""
        with self._lock:
            self.waiting += 1
        future: Future[T] = Future()
        self._jobs.put((future, act))
        return future

    async def take(self, act: Callable[[], T]) -> T:
        """Wait for a turn and for what it returns. Raises: as `submit`, and as the act."""
        return await asyncio.wrap_future(self.submit(act))

    async def take_latest(self, key: Hashable, act: Callable[[], T], overtaken: Callable[[], T]) -> T:
        """Wait for a turn as `take` does, but do `overtaken` where another act of the same key came before it."""
        mark = self._latest[key] = object()
        try:
            return await self.take(lambda: act() if self._latest.get(key) is mark else overtaken())
        finally:
            if self._latest.get(key) is mark:
                del self._latest[key]

    def stop(self) -> None:
        """End after what is being done, which has some seconds; what waits is dropped."""
        self.is_ending = True
        self._jobs.put(None)
        self._thread.join(GRACE_S)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            future, act = job
            if self.is_ending:
                future.cancel()
            try:
                if future.set_running_or_notify_cancel():
                    future.set_result(act())
            except BaseException as error:  # whoever waits gets it, and the next job must find this thread alive
                future.set_exception(error)
            finally:
                del future, act, job
                with self._lock:
                    self.waiting -= 1


class Lanes:
    """The three threads of a viewer: `quick` alone touches the session that is open.

    changes: computes another version of the scene beside the one that is shown, one after the other. files: writes
    films, pages and scenes from copies of the session.
    """

    def __init__(self) -> None:
        self.quick, self.changes, self.files = Turns(), Turns(name="viewer-changes"), Turns(name="viewer-files")

    def stop(self) -> None:
        """End after what is being done, which has some seconds; what waits is dropped."""
        for turns in (self.changes, self.files, self.quick):
            turns.stop()

    def change(self, work: Callable[[], Callable[[], T]]) -> "Future[T]":
        """Do slow work beside the session, and what it returns in the session's thread. Raises: BusyError."""
        return self.changes.submit(lambda: self.quick.complete(work()).result())

    async def take_change(self, begin: Callable[[], Callable[[], Callable[[], T]]]) -> T:
        """Wait for a change of three steps: `begin` and the last one in the session's thread, work between them.

        Raises: as `Turns.submit`, and as the steps.
        """
        return await asyncio.wrap_future(await self.quick.take(lambda: self.change(begin())))

    async def take_file(self, begin: Callable[[], Callable[[], T]]) -> T:
        """Wait for a file: `begin` in the session's thread returns what writes it. Raises: as `take_change`."""
        return await asyncio.wrap_future(await self.quick.take(lambda: self.files.submit(begin())))
