"""Launchers run tasks in this process, in several of this machine, or on a Ray cluster; tasks leave files only.

Tasks are idempotent: one that was cut off is done again, one whose files are there is not. So a worker may be killed
at any moment, and another may go on.
"""

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Protocol, TypeVar, runtime_checkable

from ...base.system import end_with
from ...errors import DrSplatError, InputError, MissingExtraError, pip_install
from ..codes import Track

T = TypeVar("T")
R = TypeVar("R")
MAX_TRIES = 3  # of a task whose process dies
TASKS_PER_WORKER = 2  # under way or waiting


@runtime_checkable
class Launcher(Protocol):
    def results(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """Yield work(item) of every item, as they come to an end. `work` and items can be pickled, results are small.

        Raises: what `work` raises; DrSplatError: workers die again and again.
        """


class OneProcess:
    """One process, this one, which does a task after another."""

    def results(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        return map(work, items)


ONE_PROCESS = OneProcess()


@dataclass(frozen=True)
class Processes:
    """Several processes of this machine."""

    count: int

    def results(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        left = set(range(len(items)))
        for _ in range(MAX_TRIES):
            done_before = len(left)
            try:
                yield from self._of_one_pool(work, items, left)
            except BrokenProcessPool:
                if len(left) < done_before:  # not stuck: what else is there gets its tries
                    yield from self.results(work, [items[number] for number in sorted(left)])
                    return
            if not left:
                return
        raise DrSplatError(
            f"a process that worked on {len(left)} tasks was killed {MAX_TRIES} times: there may be too little memory "
            f"for {self.count} at once. Start fewer; the same command goes on where this one ended"
        )

    def _of_one_pool(self, work: Callable[[T], R], items: Sequence[T], left: set[int]) -> Iterator[R]:
        """Yield the results of the items in `left`, removing each when it is done."""
        with ProcessPoolExecutor(self.count, get_context("spawn"), _take, (os.getpid(), work)) as pool:
            waiting = iter(sorted(left))
            running: dict[Future[Any], int] = {}
            try:
                while True:
                    for number in _next(waiting, self.count * TASKS_PER_WORKER - len(running)):
                        running[pool.submit(_do, items[number])] = number
                    if not running:
                        return
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        result = future.result()
                        left.remove(running.pop(future))
                        yield result
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


_work: Callable[[Any], Any] | None = None


def _take(parent: int, work: Callable[[Any], Any]) -> None:
    """Begin as a worker of the process `parent`, and end with it. work: what to do with each item, sent once."""
    global _work
    end_with(parent)
    _work = work


def _do(item: Any) -> Any:
    assert _work is not None
    return _work(item)


def _next(items: Iterator[T], count: int) -> list[T]:
    return [item for _, item in zip(range(count), items, strict=False)]


class Ray:
    """A Ray cluster, or one that is started on this machine.

    address: as `ray.init` takes it, "local" for one of this machine alone. threads: CPUs of a task; memory: bytes
    that it may need, by which Ray limits how many run on a node.

    Raises: MissingExtraError: Ray is not installed. InputError: no cluster answers there.
    """

    def __init__(self, address: str, threads: int = 1, memory: int = 0) -> None:
        try:
            import ray
        except ImportError:
            raise MissingExtraError(f"Ray is not installed: {pip_install('ray')}") from None
        self._ray = ray
        self._options = {"num_cpus": threads, "max_retries": MAX_TRIES} | ({"memory": memory} if memory else {})
        if not ray.is_initialized():
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is told to anybody
            start: dict[str, Any] = {"include_dashboard": False} if address == "local" else {}
            try:
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **start)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise InputError(f"no Ray cluster answers at '{address}': {error}. Start its head node first") from None

    def results(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        ray = self._ray
        shared = ray.put(work)  # once, not with every task
        task = ray.remote(_of_shared).options(**self._options)
        waiting, running = iter(items), list[Any]()
        most = TASKS_PER_WORKER * max(1, int(ray.cluster_resources().get("CPU", 1) // self._options["num_cpus"]))
        while True:
            running += [task.remote([shared], item) for item in _next(waiting, most - len(running))]
            if not running:
                return
            done, running = ray.wait(running)
            for one in done:
                yield self._result(one)

    def _result(self, one: Any) -> Any:
        ray = self._ray
        try:
            return ray.get(one)
        except ray.exceptions.RayTaskError as error:
            cause = error.cause if isinstance(error.cause, Exception) else error
            raise cause from error
        except ray.exceptions.RayError as error:
            raise DrSplatError(
                f"a task was lost {MAX_TRIES} times: {error}. The same command goes on from here"
            ) from error


def followed(results: Iterable[R], track: Track, items: Sequence[str], description: str) -> Iterator[R]:
    """Yield results as they come, each with a step of the progress."""
    for result, _ in zip(results, track(items, description), strict=True):
        yield result


_last_work: dict[str, Callable[[Any], Any]] = {}  # of a worker of Ray, by the id of what it was unpickled from


def _of_shared(shared: Sequence[Any], item: Any) -> Any:
    """Do a task with work that a worker unpickles once, so that it keeps the tiles that it holds from task to task.

    shared: a reference to the work, in a list: Ray would unpickle the work for each task otherwise.
    """
    import ray

    (reference,) = shared
    if reference.hex() not in _last_work:
        _last_work.clear()
        _last_work[reference.hex()] = ray.get(reference)
    return _last_work[reference.hex()](item)
