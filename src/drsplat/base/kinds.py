"""Checks of argument types at the package's public functions and classes, with errors in plain words.

The names that `drsplat` exports pass `checked`: a text in place of a View is an InputError there, not an
AttributeError ten calls later. Only types are checked, neither values nor the shapes of arrays.
"""

import inspect
import os
import types
from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import InputError

C = TypeVar("C", bound=Callable[..., Any])

MAKERS = {
    "Gaussians": "read_gaussians(...)", "View": "one of read_views(...)", "LanguageField": "load_field(...)",
    "Codebook": "load_codebook(...)", "Encoder": "load_encoder(...), read_vocabulary(...)",
    "ImageEncoder": "load_encoder(...)", "Segmenter": "load_segmenter(...)", "EncoderIdentity": "encoder.identity",
    "Code": "field.code", "Evidence": "field.evidence", "SplatArrays": "splat_arrays(gaussians)",
    "SparsePoints": "read_sparse_points(...)", "Moving": "read_moving(...)",
}  # fmt: skip
"""For each public type, the call that returns one; used in error messages."""

TYPE_WORDS = {int: "a whole number", float: "a number", str: "a text", os.PathLike: "a path", types.NoneType: "None"}


def checked(thing: C) -> C:
    """Return a function or class that refuses arguments of other types than it is annotated with.

    Raises: InputError: names the argument, its value and the expected type. TypeError: arguments that
    are missing or unknown, as always.
    """
    if not isinstance(thing, type):
        return _guarded(thing, thing.__name__)
    made = next(base for base in thing.__mro__ if "__init__" in vars(base))
    if inspect.isfunction(made.__init__) and not (  # type: ignore[misc]
        issubclass(thing, BaseException) or getattr(made, "_is_protocol", False)
    ):
        thing.__init__ = _guarded(thing.__init__, thing.__name__)  # type: ignore[method-assign]
    return thing


def _guarded(function: C, public_name: str) -> C:
    """Wrap a function with a check of its arguments. public_name: for error messages."""

    @wraps(function)
    def guarded(*args: Any, **kwargs: Any) -> Any:
        signature, hints = _annotations(function)
        for name, value in signature.bind_partial(*args, **kwargs).arguments.items():
            if name in hints and not _is_a(value, hints[name]):
                raise InputError(f"{public_name}: {name}: expected {_type_name(hints[name])}, got {_described(value)}")
        return function(*args, **kwargs)

    return guarded  # type: ignore[return-value]


@cache
def _annotations(function: Callable[..., Any]) -> tuple[inspect.Signature, dict[str, Any]]:
    """Return the signature, and the types of its parameters except those that only type checkers import."""
    hints: dict[str, Any] = {}
    signature, known = inspect.signature(function), getattr(inspect.unwrap(function), "__globals__", {})
    for name, parameter in signature.parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        try:
            one = types.SimpleNamespace(__annotations__={name: parameter.annotation})  # it resolves all or none
            hints |= get_type_hints(one, known, include_extras=True)
        except NameError:
            continue
    hints.pop("return", None)
    return signature, {name: hint for name, hint in hints.items() if hint is not inspect._empty}


def _is_a(value: object, hint: Any) -> bool:
    """Return whether a value has a type, where NumPy's numbers and arrays count, too.

    Sequences are checked by their type and their first element.
    """
    import numpy as np

    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_is_a(value, part) for part in parts)
    if origin is Literal:
        return value in parts
    if origin is Annotated:  # an array
        return _is_a(value, parts[0])
    kind = origin or hint
    if not isinstance(kind, type) or isinstance(hint, TypeVar):
        return True
    array = getattr(kind, "array_type", None)  # jaxtyping's, if `arrays` uses it
    if array is not None:
        return isinstance(value, array)
    if kind in (int, float):
        return isinstance(value, int | np.integer | (np.integer if kind is int else float | np.floating))
    if issubclass(kind, Sequence) and not issubclass(kind, str):
        if isinstance(value, str) or not isinstance(value, kind | np.ndarray):
            return False
        return not parts or not isinstance(value, Sequence) or not len(value) or _is_a(value[0], parts[0])
    try:
        return isinstance(value, kind)
    except TypeError:  # a protocol without runtime checks; ours are of functions
        return callable(value)


def _type_name(hint: Any) -> str:
    """Return a type's name for people."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type_name(part) for part in parts))
    if origin is Annotated or hasattr(hint, "array_type"):
        shape = parts[1].strip() if parts else hint.dim_str
        return f"an array ({shape})" if shape else "an array"
    kind = origin or hint
    if isinstance(kind, type) and issubclass(kind, Sequence) and kind is not str and parts:
        return f"a list of {_type_name(parts[0])}"
    name = getattr(kind, "__name__", str(kind))
    maker = f" ({MAKERS[name]})" if name in MAKERS else ""
    return TYPE_WORDS.get(kind, f"{name}{maker}")


def _described(value: object) -> str:
    """Describe a value, with the attribute that may have been meant."""
    import numpy as np

    name = type(value).__name__
    if value is None:
        return "None"
    if isinstance(value, str | int | float):
        return f"{ascii(value)[:60]} ({name})"
    if isinstance(value, np.ndarray):
        return f"an array {value.dtype} {value.shape}"
    for part in ("relevancy", "scores", "values"):
        if isinstance(getattr(value, part, None), np.ndarray):
            return f"{name}: pass its .{part}"
    if isinstance(value, list | tuple) and value:
        return f"{name} of {type(value[0]).__name__}"
    return name
