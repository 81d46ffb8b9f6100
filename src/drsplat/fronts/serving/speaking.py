"""The two ways in which the MCP server is spoken to."""

import os
import signal
import socket
from collections.abc import Callable, Sequence
from typing import Any

import anyio
from mcp.server import MCPServer

from .connections import run
from .guards import DoorKeeper

INTERRUPTED_EXIT_CODE = 130  # of shells, for Ctrl-C


def over_stdio(server: MCPServer) -> None:
    """Speak until stdin ends, or until SIGINT or SIGTERM.

    The SDK reads stdin in a thread that nothing can interrupt, so Ctrl-C would wait for the next line for ever:
    the process ends at once, which costs nothing, for it only reads.
    """
    for number, code in ((signal.SIGINT, INTERRUPTED_EXIT_CODE), (signal.SIGTERM, 0)):
        signal.signal(number, _leave(code))
    anyio.run(server.run_stdio_async)


def over_http(server: MCPServer, listening: socket.socket, key: str | None, hosts: Sequence[str] | None) -> None:
    """Speak streamable HTTP at /mcp of a socket until SIGINT or SIGTERM. key, hosts: see `DoorKeeper`."""
    app = DoorKeeper(server.streamable_http_app(host=listening.getsockname()[0]), key, hosts)
    run(app, listening, log_level="warning", timeout_graceful_shutdown=5)


def _leave(code: int) -> Callable[[int, Any], None]:
    def leave(_: int, __: Any) -> None:
        os._exit(code)

    return leave
