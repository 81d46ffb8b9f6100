"""Where questions are computed: a few at once, some more waiting, the rest told to come again."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

from ..errors import DrSplatError
from .limits import Limits
from .metrics import Metrics

T = TypeVar("T")


class BusyError(DrSplatError):
    """More requests wait than may."""


class Workbench:
    """`scans` threads. A thread whose client has gone or timed out finishes its scan, and only then takes the next."""

    def __init__(self, limits: Limits, metrics: Metrics) -> None:
        self._pool = ThreadPoolExecutor(limits.scans, thread_name_prefix="scan")
        self._limits, self._metrics, self._inside = limits, metrics, 0

    async def run(self, work: Callable[[], T]) -> T:
        """Raises: BusyError; whatever the work raises."""
        if self._inside >= self._limits.scans + self._limits.waiting:
            raise BusyError(f"{self._inside} requests are computed or wait already: come again")
        self._inside += 1
        self._metrics.waiting.inc()
        future = self._pool.submit(self._counted, work)
        loop = asyncio.get_running_loop()

        def left(done: Future[T]) -> None:
            if done.cancelled():  # while it waited
                self._metrics.waiting.dec()
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._left)

        future.add_done_callback(left)
        return await asyncio.wrap_future(future)

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _left(self) -> None:
        self._inside -= 1

    def _counted(self, work: Callable[[], T]) -> T:
        self._metrics.waiting.dec()
        self._metrics.computing.inc()
        try:
            return work()
        finally:
            self._metrics.computing.dec()
