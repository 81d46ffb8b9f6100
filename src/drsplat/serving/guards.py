"""What stands before every route: key, body size, time, and a JSON reason for whatever is refused."""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, MutableMapping, Sequence
from typing import Any

from starlette.exceptions import HTTPException

from ..access import is_addressed, is_secret
from .limits import Limits
from .metrics import Metrics

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Message, Receive, Send], Awaitable[None]]

OPEN = ("/health",)  # for those who watch the service and have no key


class TooLargeError(HTTPException):
    """The body is longer than what is taken."""

    def __init__(self, most: int) -> None:
        super().__init__(413, f"a body of at most {most:,} bytes is taken")


class Guard:
    """ASGI middleware around the whole service.

    key: what `Authorization: Bearer` or `X-API-Key` has to say, None for no key. hosts: names that a
    request may address, None for any: a page in a browser can give this machine another name.
    """

    def __init__(
        self,
        app: App,
        limits: Limits,
        metrics: Metrics,
        key: str | None = None,
        hosts: Sequence[str] | None = None,
    ) -> None:
        self.app, self.limits, self.metrics = app, limits, metrics
        self.key, self.hosts = key, hosts

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        answer = _Answer(send)
        start = time.perf_counter()
        try:
            await self._guarded(scope, receive, answer)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            self.metrics.answered(route, answer.status or 499, time.perf_counter() - start)

    async def _guarded(self, scope: Message, receive: Receive, answer: "_Answer") -> None:
        headers = dict(scope["headers"])
        if not self._is_let_in(scope["path"], headers):
            return await answer.refuse(
                401, "unauthorised", "give the key: Authorization: Bearer KEY"
            )
        if not self._is_meant(headers.get(b"host", b"")):
            return await answer.refuse(
                400, "wrong host", f"expected one of: {', '.join(self.hosts or ())}"
            )
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or len(length) > 18:
            return await answer.refuse(
                400, "malformed", "Content-Length: expected a number of bytes"
            )
        most = self.limits.body_bytes
        if int(length) > most:
            return await answer.refuse(413, "too large", TooLargeError(most).detail)
        try:
            async with asyncio.timeout(self.limits.seconds):
                await self.app(scope, _bounded(receive, self.limits.body_bytes), answer)
        except TimeoutError:
            text = f"no answer within {self.limits.seconds:g} s: ask for less, or later"
            await answer.refuse(503, "timeout", text)

    def _is_let_in(self, path: str, headers: dict[bytes, bytes]) -> bool:
        if self.key is None or path in OPEN:
            return True
        given = headers.get(b"x-api-key") or headers.get(b"authorization", b"").removeprefix(
            b"Bearer "
        )
        return is_secret(given, self.key)

    def _is_meant(self, host: bytes) -> bool:
        return self.hosts is None or is_addressed(host.decode("latin-1"), self.hosts)


class _Answer:
    """Send, which knows whether the answer has begun."""

    def __init__(self, send: Send) -> None:
        self.send, self.status = send, 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
        await self.send(message)

    async def refuse(self, status: int, kind: str, reason: str) -> None:
        if self.status:  # too late: the connection is cut
            return
        body = json.dumps({"error": reason, "kind": kind}).encode()
        headers = [
            (b"content-type", b"application/json"),
            (b"content-length", str(len(body)).encode()),
        ]
        if status == 503:
            headers.append((b"retry-after", b"1"))
        if status == 401:
            headers.append((b"www-authenticate", b"Bearer"))
        await self({"type": "http.response.start", "status": status, "headers": headers})
        await self({"type": "http.response.body", "body": body})


def _bounded(receive: Receive, most: int) -> Receive:
    """Of a body whose length was not told, or was a lie."""
    seen = 0

    async def bounded() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > most:
            raise TooLargeError(most)
        return message

    return bounded
