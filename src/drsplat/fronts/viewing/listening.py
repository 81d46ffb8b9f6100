"""A socket for people's browsers."""

import socket

from ...errors import InputError
from ..serving.listening import TakenError, bound_socket

MAX_PORTS_TRIED = 20


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on `port`, or on one of the next where it is taken; port 0 takes any.

    Raises: InputError: the address is not one of this machine; no port is free.
    """
    for candidate in range(port, max(port + 1, min(port + MAX_PORTS_TRIED, 65536))):
        try:
            return bound_socket(host, candidate)
        except TakenError:
            continue
    raise InputError(f"ports {port} to {candidate} of '{host}' are taken: name another one, port=N")
