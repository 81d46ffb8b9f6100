"""An earlier native library in the same process, so that before and after take turns."""

from collections.abc import Callable
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

from drsplat import _native

BEFORE = "before"


def earlier(library: str | Path) -> dict[str, object]:
    """Functions of another build of `_native`, a file that some build left behind. Raises: SystemExit: no such file."""
    if not Path(library).is_file():
        raise SystemExit(f"expected the file of an earlier native library, got {library}")
    spec = spec_from_loader("_native", ExtensionFileLoader("_native", str(library)))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name: of for name, of in vars(module).items() if callable(of) and not isinstance(of, type)}


def with_earlier(functions: dict[str, object], run: Callable[[], object]) -> Callable[[], object]:
    """The same by these functions, which the library calls meanwhile."""
    ours = {name: getattr(_native, name) for name in functions}

    def by_earlier() -> object:
        vars(_native).update(functions)
        try:
            return run()
        finally:
            vars(_native).update(ours)

    return by_earlier
