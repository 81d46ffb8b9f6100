"""Before a service starts: its packages and its socket; and whom it answers: by which names, pages and secret.

A page in a browser can send requests to this machine, and can give it another name (DNS rebinding); it cannot
choose what the browser writes into `Host` and `Origin`.
"""

import errno
import hmac
import ipaddress
import re
import socket
from collections.abc import Sequence
from importlib.util import find_spec

from ...base import system
from ...errors import InputError, MissingExtraError, pip_install


def require(extra: str, *modules: str) -> None:
    """Check an extra's modules. Raises: MissingExtraError: one is not installed. InputError: no services here."""
    if system.WINDOWS:
        raise InputError(
            "services give sockets to their processes, which Windows cannot: run them in WSL or a container"
        )
    require_packages(extra, *modules)


def require_packages(extra: str, *modules: str) -> None:
    """Check an extra's modules. Raises: MissingExtraError: one is not installed."""
    absent = [name for name in modules if find_spec(name) is None]
    if absent:
        raise MissingExtraError(f"{' and '.join(absent)} not installed: {pip_install(extra)}")


class TakenError(InputError):
    """Error for a port on which another program listens."""


def bound_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a port; port 0 takes any free one.

    Raises: TakenError: another program has the port. InputError: no such port, the address is not one of this machine,
    or nobody may listen there.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"expected a port up to 65535, got {port}")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = host == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((host.strip("[]"), port), family=family, dualstack_ipv6=both)
    except (OSError, UnicodeError) as error:
        if getattr(error, "errno", None) == errno.EADDRINUSE:
            raise TakenError(
                f"port {port} of '{host}' is taken by another program: stop that, or name another one, port=N"
            ) from error
        raise InputError(f"cannot listen on '{host}', port {port}: {error}") from error


def address_of(listening: socket.socket, host: str) -> str:
    """Return the address for a browser of a socket that listens on `host`."""
    name = f"[{host}]" if ":" in host and not host.startswith("[") else host
    return f"http://{name}:{listening.getsockname()[1]}"


LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
ALL_INTERFACES = ("", "0.0.0.0", "::")
_HOST = re.compile(r"(\[[0-9a-f:.]*\]|[a-z0-9._-]+)(?::\d{1,5})?")


def is_loopback(host: str) -> bool:
    """Return True if only this machine reaches a server that listens on `host`."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def names_of(host: str) -> tuple[str, ...] | None:
    """Return the names that requests to a server on `host` may use, None for any, where it listens everywhere."""
    if host in ALL_INTERFACES:
        return None
    own = f"[{host}]" if ":" in host and not host.startswith("[") else host
    return tuple(dict.fromkeys((*LOOPBACK_NAMES, own.lower())))


def is_addressed(header: str, names: Sequence[str] | None) -> bool:
    """Return True if a `Host` header has one of `names`, at any port; with None, if it is well formed."""
    named = _HOST.fullmatch(header.lower())
    return named is not None and (names is None or named[1] in names)


def is_own_page(origin: str | None, header: str) -> bool:
    """Return True if a request comes from a page of the same server, or (None) not from a page.

    origin, header: what `Origin` and `Host` say. Another port is another server.
    """
    return origin is None or origin.lower() in (f"http://{header.lower()}", f"https://{header.lower()}")


def is_secret(given: str | bytes, secret: str) -> bool:
    """Compare a key with the secret, in a time that does not tell where they differ."""
    said = given.encode("utf-8", "surrogateescape") if isinstance(given, str) else given
    return hmac.compare_digest(said, secret.encode())
