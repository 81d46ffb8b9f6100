"""drsplat serve: scenes over HTTP."""

from __future__ import annotations

import argparse
from typing import Any

from .options import PORT, add_query_encoders, length, up_to

SUMMARY = "answer questions about the scenes of a folder over HTTP"
EXAMPLES = """\
  drsplat serve scenes
  drsplat serve drsplat-demo --port 8765 --workers 2
  drsplat serve scenes --host 0.0.0.0 --api-key-file key.txt --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K
  curl -s localhost:8765/scenes/drsplat-demo/locate -H 'content-type: application/json' -d '{"text": "red vase"}'

scenes is a folder with a field and its scene, or with one of these in each subfolder. /openapi.json describes all routes;
docs/serve.md has examples."""
MOST_WORKERS = 256  # processes, and threads of each


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="a scene's folder, or a folder of such folders")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, this machine only); others need --api-key-file",
    )  # fmt: skip
    parser.add_argument("--port", type=PORT, default=8765, metavar="N", help="(default: 8765)")
    parser.add_argument(
        "--workers", type=up_to(MOST_WORKERS), default=1, metavar="N", help="processes (default: 1)"
    )
    parser.add_argument(
        "--api-key-file", metavar="FILE",
        help="a file with a key that every request has to give: Authorization: Bearer KEY",
    )  # fmt: skip
    parser.add_argument(
        "--open", action="store_true", help="allow another --host without a key: anyone may ask"
    )
    parser.add_argument(
        "--timeout", type=length, default=30.0, metavar="SECONDS", help="of a request (default: 30)"
    )
    parser.add_argument(
        "--scans", type=up_to(MOST_WORKERS), default=2, metavar="N",
        help="requests that compute at once in each worker; others wait (default: 2)",
    )  # fmt: skip
    add_query_encoders(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..access import is_loopback
    from ..errors import InputError
    from ..serving.libraries import require

    require("serve", "fastapi", "uvicorn", "prometheus_client")
    key = _key(arguments.api_key_file)
    if not is_loopback(arguments.host) and key is None and not arguments.open:
        raise InputError(
            f"--host {arguments.host} lets other machines ask: pass --api-key-file FILE, or --open to let anyone"
        )
    _started(arguments, key)
    return {"stopped": True}


def show(answer: dict[str, Any]) -> None:
    print("stopped")


def _started(arguments: argparse.Namespace, key: str | None) -> None:
    from ..access import is_loopback, names_of
    from ..serving.app import Settings
    from ..serving.catalog import Catalog, Sources
    from ..serving.limits import Limits
    from ..serving.running import serve
    from ..terminal import counted

    sources = Sources(arguments.encoder, arguments.vocabulary, arguments.device, arguments.threads)
    limits = Limits(seconds=arguments.timeout, scans=arguments.scans)
    hosts = names_of(arguments.host) if is_loopback(arguments.host) else None
    settings = Settings(arguments.folder, sources, limits, key, hosts)
    names = list(Catalog(_path(arguments.folder)).folders())
    if not arguments.json:
        print(
            f"{counted(len(names), 'scene')} at http://{arguments.host}:{arguments.port}/scenes",
            flush=True,
        )
    serve(settings, arguments.host, arguments.port, arguments.workers, arguments.json)


def _path(folder: str) -> Any:
    from pathlib import Path

    return Path(folder)


def _key(file: str | None) -> str | None:
    """Raises: InputError: no such file, or a key that is too short or cannot be sent."""
    from ..errors import InputError

    if file is None:
        return None
    path = _path(file)
    if not path.is_file():
        raise InputError(f"{file}: there is no such file")
    key: str = path.read_text(encoding="utf-8", errors="replace").strip()
    if len(key) < 16 or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"{file}: expected a key of 16 or more letters, digits and signs, such as `openssl rand -hex 24` prints"
        )
    return key
