"""Guards before every route: key, body size, time, and a JSON reason for each refusal.

Limits of what a request may cost.
"""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

from starlette.exceptions import HTTPException

from .listening import is_addressed, is_secret
from .metrics import Metrics

GONE = "the client has gone"  # message of what cancels its request


@dataclass(frozen=True)
class Limits:
    """Bounds of the service; all are checked before the work that they bound.

    body_bytes: of a request. large_bodies: requests of more than 64 KiB that are received and answered at once. text:
    characters of one text. classes: of one request. pixels: of a picture
    that is sent, by its header. side: of a picture that is rendered, in pixels. file_bytes: of a scene that
    is sent as a file, of which twice as many are held. workers: processes, which compute one
    request at a time. waiting: more
    that may wait for them; others are told to come again. seconds: from the first byte to the answer. views: of a scene
    that may wait to be added.
    """

    body_bytes: int = 8 << 20
    large_bodies: int = 32
    text: int = 200
    classes: int = 64
    pixels: int = 16_000_000
    side: int = 1600
    matches: int = 100
    file_bytes: int = 512 << 20
    workers: int = 2
    waiting: int = 128
    seconds: float = 30.0
    views: int = 64

    @property
    def too_slow(self) -> str:
        """The message for a client that waited too long."""
        return f"no answer within {self.seconds:g} s: ask for less, or later"


Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Message, Receive, Send], Awaitable[None]]

LARGE_BODY_BYTES = 64 << 10  # texts are smaller, pictures are not
KEYLESS_PATHS = ("/health",)  # for monitors of the service, which have no key


class TooLargeError(HTTPException):
    """The body is longer than what is taken."""

    def __init__(self, most: int) -> None:
        super().__init__(413, f"a body of at most {most:,} bytes is taken")


class DoorKeeper:
    """ASGI middleware that lets in who has the key and means this machine.

    key: what `Authorization: Bearer` or `X-API-Key` has to say, None for no key. hosts: names that a
    request may address, None for any: a page in a browser can give this machine another name.
    """

    def __init__(
        self, app: App, key: str | None = None, hosts: Sequence[str] | None = None, limits: Limits = Limits()
    ) -> None:
        self.app, self.key, self.hosts, self.limits = app, key, hosts, limits
        self.large = 0  # bodies at once

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not await self.turned_away(scope, Answer(send)):
            await self.app(scope, receive, send)

    async def turned_away(self, scope: Message, answer: "Answer") -> bool:
        """Refuse a request that may not come in; return True if it was refused."""
        headers = dict(scope["headers"])
        scheme, _, token = headers.get(b"authorization", b"").partition(b" ")
        given = headers.get(b"x-api-key") or (token.strip() if scheme.lower() == b"bearer" else b"")
        if not (self.key is None or scope["path"] in KEYLESS_PATHS or is_secret(given, self.key)):
            await answer.refuse(401, "unauthorised", "give the key: Authorization: Bearer KEY")
        elif self.hosts is not None and not is_addressed(headers.get(b"host", b"").decode("latin-1"), self.hosts):
            await answer.refuse(400, "wrong host", f"expected one of: {', '.join(self.hosts)}")
        return bool(answer.status)

    async def admit(self, scope: Message, receive: Receive, answer: "Answer", most: int) -> None:
        """Answer a request whose body has `most` bytes at most, and refuse one that says that it has more."""
        length = dict(scope["headers"]).get(b"content-length", b"0")
        if not length.isdigit() or len(length) > 18:
            return await answer.refuse(400, "malformed", "Content-Length: expected a number of bytes")
        if int(length) > most:
            return await answer.refuse(413, "too large", TooLargeError(most).detail)
        body = Body(receive, self, most)
        try:
            await self.work(scope, body, answer)
        finally:
            self.large -= body.is_large

    async def work(self, scope: Message, body: "Body", answer: "Answer") -> None:
        """Have a request answered that was let in."""
        await self.app(scope, body, answer)


class Guard(DoorKeeper):
    """Around the whole HTTP service: bounds of bodies and time, counts, and HEAD answered as GET."""

    def __init__(
        self, app: App, limits: Limits, metrics: Metrics, key: str | None = None, hosts: Sequence[str] | None = None
    ) -> None:
        super().__init__(app, key, hosts, limits)
        self.metrics = metrics

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        answer = Answer(send)
        if scope["method"] == "HEAD":

            async def head(message: Message) -> None:
                await send({**message, "body": b""} if "body" in message else message)

            scope, answer = {**scope, "method": "GET"}, Answer(head)
        start = time.perf_counter()
        try:
            if not await self.turned_away(scope, answer):
                await self.admit(scope, receive, answer, self.limits.body_bytes)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            self.metrics.answered(route, answer.status or 499, time.perf_counter() - start)

    async def work(self, scope: Message, body: "Body", answer: "Answer") -> None:
        """Have it answered in the time that there is, and while its client is there."""
        watcher = asyncio.create_task(_cancel_if_gone(scope, body, asyncio.current_task()))
        try:
            async with asyncio.timeout(self.limits.seconds):
                await self.app(scope, body, answer)
        except TimeoutError:
            watcher.cancel()
            await answer.refuse(503, "timeout", self.limits.too_slow)
        except asyncio.CancelledError as cancelled:
            if GONE not in cancelled.args:
                raise
        finally:
            watcher.cancel()


async def _cancel_if_gone(scope: Message, body: "Body", work: "asyncio.Task[None] | None") -> None:
    """Cancel the work on a request when its client goes; only once its body is read, which comes by the same way."""
    if scope["method"] != "GET":  # the routes of GET read no body
        await body.complete.wait()
    while (await body.receive())["type"] != "http.disconnect":
        pass
    if work is not None:
        work.cancel(GONE)


class Answer:
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
        more = {503: [(b"retry-after", b"1")], 401: [(b"www-authenticate", b"Bearer")]}.get(status, [])
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode()), *more]
        await self({"type": "http.response.start", "status": status, "headers": headers})
        await self({"type": "http.response.body", "body": body})


class Body:
    """Receive, of a body whose length was not told, or was a lie; and one of not too many large ones."""

    def __init__(self, receive: Receive, guard: DoorKeeper, most: int) -> None:
        self.receive, self.guard, self.most, self.seen, self.is_large = receive, guard, most, 0, False
        self.complete = asyncio.Event()

    async def __call__(self) -> Message:
        message = await self.receive()
        self.seen += len(message.get("body", b""))
        if self.seen > self.most:
            raise TooLargeError(self.most)
        if self.seen > LARGE_BODY_BYTES and not self.is_large:
            if self.guard.large >= self.guard.limits.large_bodies:
                raise HTTPException(503, f"{self.guard.large} large bodies are here: come again")
            self.guard.large, self.is_large = self.guard.large + 1, True
        if not message.get("more_body"):
            self.complete.set()
        return message
