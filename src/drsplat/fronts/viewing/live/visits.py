"""Browsers before a viewer: what each has asked and found, bounded in number, age and bytes."""

import secrets
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from starlette.exceptions import HTTPException

from ....query.catalogue import Entry
from ..session import Session

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
