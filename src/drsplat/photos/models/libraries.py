"""torch and transformers, or what to install."""

import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from ...errors import MissingExtraError, pip_install

NO_TORCHVISION = "pip uninstall torchvision"


def models_library() -> Any:
    """Return the module transformers, with a torch that it can use.

    Raises: MissingExtraError: one is not installed, or cannot be imported; says why.
    """
    absent = [name for name in ("torch", "transformers") if find_spec(name) is None]
    if absent:
        raise MissingExtraError(
            f"models such as CLIP need {' and '.join(absent)}, not installed: {pip_install('models')}; what is built "
            "in, coarser, needs nothing (drsplat embed --segmenter graph --encoder drsplat-mini)"
        )
    try:
        import_module("torch")
        return import_module("transformers")
    except (ImportError, OSError, RuntimeError) as error:
        raise _unusable(error) from error


def model_class(name: str) -> Any:
    """Import and return a class of transformers by name.

    Raises: MissingExtraError: this transformers has none of that name, or cannot import it.
    """
    library = models_library()
    try:
        return getattr(library, name)
    except AttributeError:
        raise MissingExtraError(
            f"transformers {library.__version__} has no {name}: pip install --upgrade transformers"
        ) from None
    except (ImportError, OSError, RuntimeError) as error:
        raise _unusable(error) from error


def torchvision_fault() -> str | None:
    """Return the error of importing a torchvision that is installed but broken; else None.

    A torchvision that was built for another torch stops transformers from importing any model,
    with a message that does not name it. Nothing here needs torchvision.
    """
    if find_spec("torchvision") is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import_module("torchvision")
    except Exception as error:  # its operators are registered at import: anything can be raised
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return None


def _unusable(error: BaseException) -> MissingExtraError:
    fault = torchvision_fault()
    if fault is not None:
        return MissingExtraError(
            f"transformers cannot be imported because the installed torchvision does not fit torch ({fault}): drsplat "
            f"needs no torchvision, so {NO_TORCHVISION}, or install the one of this torch"
        )
    return MissingExtraError(
        f"torch and transformers are installed but cannot be imported: {error}. Install them anew: "
        f"{pip_install('models')}"
    )
