"""Photos in parallel, where all models can be called from several threads at once."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar, runtime_checkable

MAX_PHOTOS_AT_ONCE = 8  # each takes memory

Item = TypeVar("Item")
Result = TypeVar("Result")
Model = TypeVar("Model")


@runtime_checkable
class Threaded(Protocol):
    """Model with the same answers on any number of threads: on `threads` of its own, 0 for all cores, or on one."""

    threads: int

    def on_one_thread(self: Model) -> Model:
        """Return the same model on one thread, for several threads to call at once."""
        ...


def photos_at_once(models: Iterable[object]) -> int:
    """Return the number of photos to process at the same time: 1 unless all models are `Threaded`."""
    threads = [model.threads or os.cpu_count() or 1 if isinstance(model, Threaded) else 1 for model in models]
    return min(MAX_PHOTOS_AT_ONCE, *threads)


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item], at_once: int) -> Iterator[Result]:
    """Yield the result of each item, in order; at most `at_once` are started and not yet taken."""
    if at_once == 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(at_once) as pool:
        started: deque[Future[Result]] = deque()
        for item in items:
            started.append(pool.submit(work, item))
            if len(started) == at_once:
                yield started.popleft().result()
        while started:
            yield started.popleft().result()
