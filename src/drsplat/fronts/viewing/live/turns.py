"""Whose turn it is: the threads of a viewer, which do one thing after the other, and the browsers before it."""

import asyncio
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TypeVar

from starlette.exceptions import HTTPException

from ....query.catalogue import Entry
from ...serving.replies import BusyError
from ..session import Session

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


MAX_VISITS, MAX_IDLE_S = 64, 24 * 3600.0
MAX_ANSWER_BYTES = 512 << 20  # of all visits together, of which the one that asks may always keep its own
GONE = "this viewer has let go of what this browser asked: load its page again"


@dataclass(eq=False)
class Visit:
    """Question and answers of one browser, with counters of what changed in them.

    session: of the scene of the count `scene`, with the edits that all share; None where none is open. entries: what it
    found in the catalogue. seen: what these counters were made of. num_bytes: of its answers.
    """

    session: Session | None = None
    scene: int = -1
    entries: Sequence[Entry] = ()
    geometry: int = 0
    paint: int = 0
    seen: tuple[Any, ...] = ()
    num_bytes: int = 0
    used_s: float = 0.0


class Visits:
    """Visits by the secret that their browser has as a cookie; only the page makes one. common: of who shows none."""

    def __init__(self) -> None:
        self.common = Visit()
        self._by_key: OrderedDict[str, Visit] = OrderedDict()

    def __len__(self) -> int:
        return len(self._by_key)

    def arrive(self, key: str) -> str:
        """Return the key of a browser that loads the page: its own where it is known, else a new one."""
        if key not in self._by_key:
            key = secrets.token_urlsafe(18)
            self._by_key[key] = Visit()
        self.of(key)
        return key

    def of(self, key: str) -> Visit:
        """Return the visit of a browser, and let go of those of longest ago where there are too many, or too large.

        Raises: HTTPException: the key is not, or no longer, known.
        """
        if not key:
            return self.common
        if key not in self._by_key:
            raise HTTPException(410, GONE)
        self._by_key.move_to_end(key)
        visit = self._by_key[key]
        visit.used_s = time.monotonic()
        size = sum(one.num_bytes for one in self._by_key.values())
        for old, one in list(self._by_key.items())[:-1]:
            idle_s = visit.used_s - one.used_s
            if len(self) <= MAX_VISITS and idle_s <= MAX_IDLE_S and size <= MAX_ANSWER_BYTES:
                break
            size -= one.num_bytes
            del self._by_key[old]
        return visit
