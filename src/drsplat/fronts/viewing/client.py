"""The client's files, built from web/: one HTML document, for a page with everything inside or for a running viewer."""

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from .texts import escaped

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
    data = (
        f'<script type="application/json" id="header">{_in_script(header)}</script>\n'
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


def _in_script(text: str) -> str:
    """Return JSON that cannot end the script element that it is in."""
    return text.replace("<", "\\u003c")
