"""Whom a server answers that a browser can reach: by which names, from which pages, with which secret.

A page in a browser can send requests to this machine, and can give it another name (DNS rebinding); it cannot
choose what the browser writes into `Host` and `Origin`.
"""

import hmac
import ipaddress
import re
from collections.abc import Sequence

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
