"""Keys for what is pressed most; viser's own palette (Ctrl-K or Cmd-K) lists them."""

from collections.abc import Callable, Mapping
from typing import Any

Act = Callable[[Any], None]
Do = Callable[[str, Any, Act], None]


def add_keys(gui: Any, do: Do, acts: Mapping[str, tuple[str, Act]]) -> list[Any]:
    """acts: by what the palette calls it, the key and what it does with the press; `do` says when.

    Returns what is to be removed when these keys shall do nothing any more.
    """
    commands = [gui.add_command(label, hotkey=key) for label, (key, _) in acts.items()]
    for command, (label, (_, act)) in zip(commands, acts.items(), strict=True):
        command.on_trigger(_later(do, label, act))
    return commands


def _later(do: Do, label: str, act: Act) -> Act:
    return lambda event: do(label, event, act)


def flipped(checkbox: Any, then: Act) -> Act:
    """As if it had been clicked."""

    def act(event: Any) -> None:
        checkbox.value = not checkbox.value
        then(event)

    return act


def next_of(dropdown: Any, then: Act) -> Act:
    """As if the next of its options had been chosen, after the last the first."""

    def act(event: Any) -> None:
        options = list(dropdown.options)
        dropdown.value = options[(options.index(dropdown.value) + 1) % len(options)]
        then(event)

    return act
