"""LanceDB and Arrow, imported where a catalogue needs them, and their errors in our words."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from ...errors import DrSplatError, FormatError, InputError, MissingExtraError, pip_install

PANICS = ("PanicException", "RustPanic")  # of Rust, on unexpected contents
INDEX_CACHE_BYTES, METADATA_CACHE_BYTES = 512 << 20, 256 << 20
CURE = "the table is damaged: restore it from a copy, or remove the folder and add its scenes again"


def libraries() -> tuple[Any, Any]:
    """Import LanceDB and Arrow. Raises: MissingExtraError: they are not installed."""
    try:
        import lancedb
        import pyarrow
    except ImportError as error:
        raise MissingExtraError(f"a catalogue needs LanceDB ({error}): {pip_install('catalogue')}") from error
    return lancedb, pyarrow


@cache
def session() -> Any:
    """Return the cache that all queries of this process share; without it each would read the index anew."""
    lancedb, _ = libraries()
    return lancedb.Session(INDEX_CACHE_BYTES, METADATA_CACHE_BYTES)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB into FormatErrors."""
    with _lance_errors(path):
        yield


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB into InputErrors: it could not write, and nothing has changed."""
    try:
        with _lance_errors(path):
            yield
    except FormatError as error:
        raise InputError(f"{path}: nothing was changed: {error.__cause__!s:.300}") from error


@contextmanager
def _lance_errors(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB, Arrow and Rust into FormatErrors."""
    try:
        yield
    except DrSplatError:
        raise
    except (ValueError, RuntimeError, OSError) as error:  # Arrow's are among these
        raise FormatError(f"{path}: {CURE} ({type(error).__name__}: {error!s:.300})") from error
    except BaseException as error:
        if type(error).__name__ not in PANICS:
            raise
        raise FormatError(f"{path}: {CURE} ({error!s:.300})") from error
