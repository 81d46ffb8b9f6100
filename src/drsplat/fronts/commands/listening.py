"""Options and rules of the commands that listen on an address."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import InputError
from ..serving.listening import is_loopback, names_of
from .declaring import declaration, flag, option, part
from .kinds import PORT, length, up_to

MAX_WORKERS = 256  # processes


@declaration
class Listening:
    """Address that requests come to, and how many are answered at a time."""

    host: str = option(
        "address to listen on (default: 127.0.0.1, this machine only); others need --api-key-file", "ADDRESS", None,
        "127.0.0.1",
    )  # fmt: skip
    port: int = option("port to listen on", "N", PORT)
    api_key_file: str | None = option(
        "file with the key that every request must send: Authorization: Bearer KEY", "FILE"
    )  # fmt: skip
    open: bool = flag("allow another --host without a key, open to anyone")
    workers: int = option("worker processes", "N", up_to(MAX_WORKERS))
    timeout: float = option("time limit of a request (default: 30)", "SECONDS", length, 30.0)

    @property
    def names(self) -> tuple[str, ...] | None:
        """Host names that a request may use, None for any, where other machines can reach this one."""
        return names_of(self.host) if is_loopback(self.host) else None

    def key(self) -> str | None:
        """Return the key that requests have to give, None for none.

        Raises: InputError: other machines could ask without one, and --open does not say so; no key in its file.
        """

        key = None if self.api_key_file is None else _key(Path(self.api_key_file))
        if not is_loopback(self.host) and key is None and not self.open:
            raise InputError(
                f"--host {self.host} opens it to other machines: pass --api-key-file FILE, or --open to let anyone"
            )
        return key


def listening(port: int, workers: int) -> Any:
    """Declare `Listening` with a port and a number of processes of a verb's own."""
    waiting = f"worker processes, one request each at a time; others wait (default: {workers})"
    return part(
        Listening,
        port={"default": port, "help": f"port to listen on (default: {port})"},
        workers={"default": workers, "help": waiting},
    )


def _key(path: Path) -> str:

    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    key = path.read_text(encoding="utf-8", errors="replace").strip()
    if len(key) < 16 or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"{path}: expected a key of 16 or more letters, digits and signs, such as `openssl rand -hex 24` prints"
        )
    return key
