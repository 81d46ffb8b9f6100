"""The client's files, built from web/, as one HTML document: for a page, or for a running viewer.

Text of files and strangers is made safe here on its way to a browser.
"""

import html
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

MAX_CHARACTERS_SHOWN = 200


def printable(text: str, most: int = MAX_CHARACTERS_SHOWN) -> str:
    """Drop what no page can hold or show (halves of surrogate pairs, controls, marks that turn text around)."""
    cut = text if len(text) <= most else f"{text[: most - 1]}…"
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in cut)


def escaped(text: str, most: int = MAX_CHARACTERS_SHOWN) -> str:
    """Return a text as HTML that shows just that text."""
    return html.escape(printable(text, most))


PAGE_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' blob:; worker-src blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:"
)
"""Content security policy of a page: whatever its file holds, it can ask no host for anything."""


def page_html(title: str, header: str, scene: str, blob: str) -> str:
    """Return a page that needs nothing but itself.

    Args:
        title: as people gave it; it is escaped here.
        header: JSON of the page's documents.
        scene: SPZ, in base64.
        blob: arrays, deflated, in base64.
    """
    header = header.replace("<", "\\u003c")  # so that nothing in it ends the script element that it is in
    data = (
        f'<script type="application/json" id="header">{header}</script>\n'
        f'<script type="application/octet-stream" id="scene" data-name="scene.spz">{scene}</script>\n'
        f'<script type="application/octet-stream" id="blob">{blob}</script>'
    )
    policy = f'<meta http-equiv="Content-Security-Policy" content="{PAGE_POLICY}">\n'
    style, script = f"<style>\n{client_file('client.css')}</style>", f"<script>\n{client_file('client.js')}</script>"
    parts = {"TITLE": escaped(title), "POLICY": policy, "STYLE": style, "DATA": data, "SCRIPT": script}
    return filled(client_file("client.html"), parts)


def live_html() -> str:
    """Return the document of a running viewer, which takes its parts and data from where it came from."""
    style, script = '<link rel="stylesheet" href="client.css">', '<script src="client.js" defer></script>'
    parts = {"TITLE": "drsplat", "POLICY": "", "STYLE": style, "DATA": "", "SCRIPT": script}
    return filled(client_file("client.html"), parts)


@cache
def client_file(name: str) -> str:
    """Return the text of client.html, client.css or client.js."""
    return (files(__package__) / name).read_text(encoding="utf-8")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return the template with each @NAME@ replaced; what is put in is not looked through again."""
    return re.sub(r"@([A-Z]+)@", lambda match: parts[match[1]], template)
