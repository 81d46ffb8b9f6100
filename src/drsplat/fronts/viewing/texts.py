"""Text of files and strangers on its way to a browser."""

import html

MAX_CHARACTERS_SHOWN = 200


def printable(text: str, most: int = MAX_CHARACTERS_SHOWN) -> str:
    """Drop what no page can hold or show (halves of surrogate pairs, controls, marks that turn text around)."""
    cut = text if len(text) <= most else f"{text[: most - 1]}…"
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in cut)


def escaped(text: str, most: int = MAX_CHARACTERS_SHOWN) -> str:
    """Return a text as HTML that shows just that text."""
    return html.escape(printable(text, most))
