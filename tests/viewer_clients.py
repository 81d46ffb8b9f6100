"""A viewer that listens, and strangers that talk to it as no page of its own would."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from drsplat.viewing.session import Session
from viewing_scenes import THINGS, boxes_scene

UP = (0.0, 0.0, 1.0)
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [3.0, 3.0, 3.0], "fov": 0.8, "near": 0.01,
    "far": 1000.0, "image_height": 600, "image_width": 800, "look_at": [0.0, 0.0, 0.0], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


@contextmanager
def a_viewer(folder: Path | None = None, host: str = "127.0.0.1") -> Iterator[Any]:
    """The panel of three boxes on a free port."""
    pytest.importorskip("viser")
    import numpy as np

    from drsplat.viewing.panel import Panel
    from drsplat.viewing.window import Window

    window = Window(Session(boxes_scene(), words=THINGS), np.array(UP), host=host, port=0)
    panel = Panel(window, folder)
    try:
        yield panel
    finally:
        panel.stop()


def port_of(panel: Any) -> int:
    port: int = panel.window.server.get_port()
    return port


class Got(NamedTuple):
    status: int
    headers: Any
    body: bytes


def get(panel: Any, path: str = "/", **headers: str) -> Got:
    """The answer to one request; `Host` is the viewer's own unless it is given."""
    connection = http.client.HTTPConnection("127.0.0.1", port_of(panel), timeout=60)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return Got(answer.status, answer.headers, answer.read())


class Stranger:
    """A WebSocket that says what it likes."""

    def __init__(self, panel: Any, **headers: str) -> None:
        import viser
        from websockets.sync.client import connect

        port, path = port_of(panel), headers.pop("path", "/")
        host = headers.pop("Host", f"127.0.0.1:{port}")
        self.socket = connect(
            f"ws://{host}{path}",
            sock=socket.create_connection(("127.0.0.1", port)),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            additional_headers=headers,
            compression=None,
            max_size=None,
            close_timeout=1,
        )

    def say(self, kind: str, **fields: Any) -> None:
        import msgspec

        self.socket.send(msgspec.msgpack.encode({"type": kind} | fields))

    def look(self) -> None:
        self.say(**{"kind" if key == "type" else key: value for key, value in CAMERA.items()})

    def press(self, handle: Any, value: Any = True) -> None:
        self.say("GuiUpdateMessage", uuid=handle._impl.uuid, updates={"value": value})

    def heard(self, seconds: float = 1.0) -> list[dict[str, Any]]:
        """All messages until it is silent for so long."""
        messages = []
        while True:
            try:
                messages += _unpacked(self.socket.recv(seconds))
            except TimeoutError:
                return messages

    def close(self) -> None:
        self.socket.close()


def _unpacked(raw: Any) -> list[dict[str, Any]]:
    import msgspec
    import zstandard

    size, packed = int.from_bytes(raw[:8], "little"), int.from_bytes(raw[8:16], "little")
    inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
    messages: list[dict[str, Any]] = msgspec.msgpack.decode(inner)["messages"]
    return messages
