"""Starting the service: one process that listens, and those that compute."""

import uvicorn

from .app import Settings, create_app
from .connections import connection_class, room

GRACE = 5  # seconds beyond the longest request


def serve(settings: Settings, host: str, port: int, quiet: bool = False) -> None:
    """Answer until stopped (SIGINT, SIGTERM): what is being answered is finished, nothing new is taken.

    A process that computes and dies is started again: it only reads files, so nothing is lost but its answer.
    """
    uvicorn.run(
        create_app(settings),
        host=host,
        port=port,
        http=connection_class(room()),
        ws="none",
        log_level="warning" if quiet else "info",
        access_log=False,
        timeout_graceful_shutdown=int(settings.limits.seconds) + GRACE,
        timeout_keep_alive=30,
        server_header=False,
    )
