"""Before a service starts: its packages, and a socket that is bound before its address is announced."""

import errno
import socket
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
