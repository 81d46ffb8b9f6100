"""Values that a control can have: our page sends no others, and viser would take any and fail later."""

from typing import Any

CHANNEL = (0, 255)


def fits(control: Any, value: Any) -> bool:
    """Return whether a value, read from a message, is of the kind of a control's own and within its bounds."""
    state = control._impl
    if state.removed:
        return False
    own, bounds = state.value, state.props
    if isinstance(own, bool):
        return isinstance(value, bool)
    if isinstance(own, str):
        options = getattr(bounds, "options", None)
        return isinstance(value, str) and (options is None or value in options)
    low, high = getattr(bounds, "min", None), getattr(bounds, "max", None)
    if not isinstance(own, tuple):
        return _is_within(own, value, low, high)
    if not isinstance(value, list) or len(value) != len(own):
        return False
    if all(type(part) is int for part in own):  # a colour
        low, high = CHANNEL
    lows, highs = (one if isinstance(one, tuple) else (one,) * len(own) for one in (low, high))
    return all(_is_within(*one) for one in zip(own, value, lows, highs, strict=True))


def _is_within(own: Any, value: Any, low: float | int | None, high: float | int | None) -> bool:
    """Return whether a number is within its bounds, and whole where the control's own is; files are no numbers."""
    if type(own) not in (int, float) or type(value) not in (int, float):
        return False
    is_whole = isinstance(own, float) or float(value).is_integer()
    return is_whole and (low is None or low <= value) and (high is None or value <= high)
