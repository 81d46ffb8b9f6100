"""Starting the service: one process that listens, and those that compute."""

import socket

from .app import Settings, create_app
from .connections import run

GRACE_S = 5  # beyond the longest request


def serve(settings: Settings, listening: socket.socket, quiet: bool = False) -> None:
    """Answer on a socket until stopped (SIGINT, SIGTERM): finish what is being answered, take nothing new.

    A process that computes and dies is started again: nothing is lost but its answer, and views that were taken are
    on disk.
    """
    run(
        create_app(settings),
        listening,
        log_level="warning" if quiet else "info",
        access_log=False,
        timeout_graceful_shutdown=int(settings.limits.seconds) + GRACE_S,
        timeout_keep_alive=30,
    )
