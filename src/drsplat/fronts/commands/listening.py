"""Options and rules of the commands that listen on an address."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..serving.access import is_loopback, names_of
from .options import PORT, length, up_to

MAX_WORKERS = 256  # processes


def add_listening(parser: argparse.ArgumentParser, port: int) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, this machine only); others need --api-key-file",
    )  # fmt: skip
    parser.add_argument("--port", type=PORT, default=port, metavar="N", help=f"port to listen on (default: {port})")
    parser.add_argument(
        "--api-key-file", metavar="FILE",
        help="file with the key that every request must send: Authorization: Bearer KEY",
    )  # fmt: skip
    parser.add_argument("--open", action="store_true", help="allow another --host without a key, open to anyone")


def add_computing(parser: argparse.ArgumentParser, workers: int) -> None:
    parser.add_argument(
        "--workers", type=up_to(MAX_WORKERS), default=workers, metavar="N",
        help=f"worker processes, one request each at a time; others wait (default: {workers})",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", type=length, default=30.0, metavar="SECONDS", help="time limit of a request (default: 30)"
    )


def checked_key(arguments: argparse.Namespace) -> str | None:
    """Return the key that requests have to give, None for none.

    Raises: InputError: other machines could ask without one, and --open does not say so; no key in its file.
    """
    from ...errors import InputError

    key = None if arguments.api_key_file is None else _key(Path(arguments.api_key_file))
    if not is_loopback(arguments.host) and key is None and not arguments.open:
        raise InputError(
            f"--host {arguments.host} opens it to other machines: pass --api-key-file FILE, or --open to let anyone"
        )
    return key


def own_names(arguments: argparse.Namespace) -> tuple[str, ...] | None:
    """Return the host names that a request may use, None for any, where other machines can reach this one."""
    return names_of(arguments.host) if is_loopback(arguments.host) else None


def _key(path: Path) -> str:
    from ...errors import InputError

    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    key = path.read_text(encoding="utf-8", errors="replace").strip()
    if len(key) < 16 or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"{path}: expected a key of 16 or more letters, digits and signs, such as `openssl rand -hex 24` prints"
        )
    return key
