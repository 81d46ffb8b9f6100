"""What people press, done one after the other."""

import threading
from collections.abc import Callable, Hashable

Act = Callable[[], None]
GRACE = 5.0  # seconds


class Actions:
    """One thread that acts. Of the acts of one key only the latest waits: no press makes the queue longer than the
    keys.

    Acts must not raise.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Act] = {}
        self._changed = threading.Condition()
        self._acting = self._stopped = False
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()

    def do(self, key: Hashable, act: Act) -> None:
        with self._changed:
            self._waiting[key] = act
            self._changed.notify_all()

    def settled(self, seconds: float) -> bool:
        """Wait until all is done; whether it was in time."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._acting, seconds)

    def stop(self) -> None:
        """What waits is not done any more; what is being done has some seconds to end."""
        with self._changed:
            self._stopped = True
            self._waiting.clear()
            self._changed.notify_all()
        self._thread.join(GRACE)

    def _run(self) -> None:
        while (act := self._next()) is not None:
            act()

    def _next(self) -> Act | None:
        with self._changed:
            self._acting = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._stopped)
            if self._stopped:
                return None
            self._acting = True
            return self._waiting.pop(next(iter(self._waiting)))
