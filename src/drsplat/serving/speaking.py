"""The two ways in which the MCP server is spoken to."""

import os
import signal
from collections.abc import Callable, Sequence
from typing import Any

import anyio
import uvicorn
from mcp.server import MCPServer

from .connections import connection_class, room
from .guards import DoorKeeper

STOPPED = 130  # as shells say that Ctrl-C ended a program


def over_stdio(server: MCPServer) -> None:
    """Speak until stdin ends, or until SIGINT or SIGTERM.

    The SDK reads stdin in a thread that nothing can interrupt, so Ctrl-C would wait for the next line for ever:
    the process ends at once, which costs nothing, for it only reads.
    """
    for number, code in ((signal.SIGINT, STOPPED), (signal.SIGTERM, 0)):
        signal.signal(number, _leave(code))
    anyio.run(server.run_stdio_async)


def over_http(server: MCPServer, host: str, port: int, key: str | None, hosts: Sequence[str] | None) -> None:
    """Streamable HTTP at /mcp until SIGINT or SIGTERM. key, hosts: as of `DoorKeeper`."""
    app = DoorKeeper(server.streamable_http_app(host=host), key, hosts)
    uvicorn.run(
        app,
        host=host,
        port=port,
        http=connection_class(room()),
        ws="none",
        log_level="warning",
        timeout_graceful_shutdown=5,
        server_header=False,
    )


def _leave(code: int) -> Callable[[int, Any], None]:
    def leave(_: int, __: Any) -> None:
        os._exit(code)

    return leave
