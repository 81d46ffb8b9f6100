"""Limits of what a request may cost."""

from dataclasses import dataclass

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
