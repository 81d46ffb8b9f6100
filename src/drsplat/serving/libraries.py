"""The extras of the service and of MCP, or what to install."""

from importlib.util import find_spec

from ..errors import MissingExtraError


def require(extra: str, *modules: str) -> None:
    """Raises: MissingExtraError: a module of an extra is not installed."""
    absent = [name for name in modules if find_spec(name) is None]
    if absent:
        raise MissingExtraError(f'{" and ".join(absent)} not installed: pip install "drsplat[{extra}]"')
