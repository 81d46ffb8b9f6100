"""A socket for people's browsers."""

import errno
import socket

from ..errors import InputError

TRIES = 20  # ports, where others are taken


def listening_socket(host: str, port: int) -> socket.socket:
    """Bound to `port`, or to one of the next where it is taken; port 0 takes any.

    Raises: InputError: the address is not one of this machine; no port is free.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"expected a port up to 65535, got {port}")
    for candidate in range(port, min(port + TRIES, 65536)):
        try:
            return _bound(host, candidate)
        except (OSError, UnicodeError) as error:
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                raise InputError(f"cannot listen on '{host}', port {candidate}: {error}") from error
    raise InputError(f"ports {port} to {candidate} of '{host}' are taken: name another")


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    both = host == "::" and socket.has_dualstack_ipv6()
    return socket.create_server((host, port), family=family, dualstack_ipv6=both)
