"""Sockets that are bound before their address is announced."""

import errno
import socket

from ...errors import InputError


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
