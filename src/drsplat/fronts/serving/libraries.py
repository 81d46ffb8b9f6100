"""The extras of the service and of MCP, or what to install."""

from importlib.util import find_spec

from ...base import system
from ...errors import InputError, MissingExtraError


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
        raise MissingExtraError(f'{" and ".join(absent)} not installed: pip install "drsplat[{extra}]"')
