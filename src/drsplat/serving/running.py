"""Starting the service: one process, or several that share a port and the mapped fields."""

import json
import os
import tempfile
from dataclasses import asdict

import uvicorn

from .app import SETTINGS, Settings, app_from_environment
from .metrics import SHARED

GRACE = 5  # seconds beyond the longest request


def serve(settings: Settings, host: str, port: int, workers: int, quiet: bool = False) -> None:
    """Answer until stopped (SIGINT, SIGTERM): what is being answered is finished, nothing new is taken.

    A worker that dies is started again; fields are files that are mapped read-only, so nothing is lost.
    """
    os.environ[SETTINGS] = json.dumps(asdict(settings))
    options = {
        "host": host,
        "port": port,
        "log_level": "warning" if quiet else "info",
        "access_log": False,
        "timeout_graceful_shutdown": int(settings.limits.seconds) + GRACE,
        "timeout_keep_alive": 30,
        "limit_concurrency": 1000,
        "server_header": False,
    }
    if workers == 1:
        uvicorn.run(app_from_environment(), **options)  # type: ignore[arg-type]
        return
    with tempfile.TemporaryDirectory(prefix="drsplat-metrics-") as folder:
        os.environ[SHARED] = folder
        target = f"{app_from_environment.__module__}:{app_from_environment.__name__}"
        uvicorn.run(target, factory=True, workers=workers, **options)  # type: ignore[arg-type]
