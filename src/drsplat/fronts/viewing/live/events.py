"""Server-sent events: one line to each page after each change, and a comment where nothing changes."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

from starlette.exceptions import HTTPException

MAX_STREAMS = 16
BEAT_S = 15.0


class Events:
    """Streams of a service. summary: what a line says. Only the latest is sent to a page that reads slowly."""

    def __init__(self, summary: Callable[[], dict[str, Any]], most: int = MAX_STREAMS, beat_s: float = BEAT_S) -> None:
        self.summary, self.most, self.beat_s, self.is_closed = summary, most, beat_s, False
        self._streams: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}

    def __len__(self) -> int:
        return len(self._streams)

    def tell(self) -> None:
        """Wake all streams; from any thread."""
        for changed, loop in list(self._streams.items()):
            try:
                loop.call_soon_threadsafe(changed.set)
            except RuntimeError:  # its loop has ended
                self._streams.pop(changed, None)

    def close(self) -> None:
        """End all streams."""
        self.is_closed = True
        self.tell()

    def open(self) -> AsyncIterator[bytes]:
        """Return the lines for one page. Raises: HTTPException: there are enough."""
        if len(self._streams) >= self.most:
            raise HTTPException(503, f"{self.most} pages of this viewer are open: close one")
        changed = asyncio.Event()
        self._streams[changed] = asyncio.get_running_loop()
        return self._lines(changed)

    async def _lines(self, changed: asyncio.Event) -> AsyncIterator[bytes]:
        try:
            while not self.is_closed:
                changed.clear()
                yield f"data: {json.dumps(self.summary())}\n\n".encode()
                while not changed.is_set():
                    try:
                        await asyncio.wait_for(changed.wait(), self.beat_s)
                    except TimeoutError:
                        yield b": here\n\n"
        finally:
            self._streams.pop(changed, None)
