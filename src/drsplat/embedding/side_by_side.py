"""Photos side by side, where all models may be asked from several threads at once."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar, runtime_checkable

AT_ONCE = 8  # photos, since each takes memory

Item = TypeVar("Item")
Result = TypeVar("Result")
Model = TypeVar("Model")


@runtime_checkable
class Threaded(Protocol):
    """A model that answers the same on any number of threads: on `threads` of its own, 0 for all cores, or on one."""

    threads: int

    def on_one_thread(self: Model) -> Model:
        """The same model, for several threads to ask at once."""
        ...


def photos_at_once(models: Iterable[object]) -> int:
    """How many photos the models are asked for at the same time: 1 unless all are `Threaded`."""
    threads = [model.threads or os.cpu_count() or 1 if isinstance(model, Threaded) else 1 for model in models]
    return min(AT_ONCE, *threads)


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item], at_once: int) -> Iterator[Result]:
    """Yield what becomes of each item, in order; no more than `at_once` are begun and not yet taken."""
    if at_once == 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(at_once) as pool:
        begun: deque[Future[Result]] = deque()
        for item in items:
            begun.append(pool.submit(work, item))
            if len(begun) == at_once:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
