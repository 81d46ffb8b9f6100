"""Text of files and strangers on its way to a browser."""

import html

MOST_SHOWN = 200
STYLE = "padding:.3em 1em;font-size:.85em;overflow-wrap:anywhere"


def printable(text: str, most: int = MOST_SHOWN) -> str:
    """Without what no page can hold or show (halves of surrogate pairs, controls, marks that turn text around)."""
    cut = text if len(text) <= most else f"{text[: most - 1]}…"
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in cut)


def escaped(text: str, most: int = MOST_SHOWN) -> str:
    """As HTML that says just that."""
    return html.escape(printable(text, most))


def paragraphs(*lines: str) -> str:
    """HTML of lines that are HTML already; empty ones are left out."""
    return f'<div style="{STYLE}">{"".join(f"<div>{line}</div>" for line in lines if line)}</div>'
