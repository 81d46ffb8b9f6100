"""A page for whoever opens the service in a browser: what can be asked, without a script."""

import json
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>drsplat</title><style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }}
table {{ border-collapse: collapse }} td {{ padding: .3rem .8rem .3rem 0; vertical-align: top }}
code, pre {{ font: 14px/1.5 ui-monospace, monospace; background: #f4f4f4; border-radius: 4px; padding: .1rem .3rem }}
pre {{ padding: .8rem; overflow-x: auto }}
</style></head><body>
<h1>drsplat {version}</h1>
<p>{about}</p>
<table>{routes}</table>
<h2>For example</h2>
{examples}
<p><a href="openapi.json">openapi.json</a> describes every route with types, bounds and examples; <a href="scenes">
scenes</a> lists what can be asked.</p>
</body></html>
"""


def front_page(description: Mapping[str, Any]) -> str:
    """Return HTML made of an OpenAPI description."""
    return _PAGE.format(
        version=escape(description["info"]["version"]),
        about=escape(description["info"]["description"]),
        routes="".join(_rows(description)),
        examples="".join(_examples(description)),
    )


def _rows(description: Mapping[str, Any]) -> Iterator[str]:
    for path, methods in description["paths"].items():
        for method, route in methods.items():
            name = f"{method.upper()} {path}"
            yield f"<tr><td><code>{escape(name)}</code></td><td>{escape(route['description'])}</td></tr>"


def _examples(description: Mapping[str, Any]) -> Iterator[str]:
    schemas = description["components"]["schemas"]
    for path, methods in description["paths"].items():
        body = methods.get("post", {}).get("requestBody")
        if body is None:
            continue
        name = body["content"]["application/json"]["schema"]["$ref"].rpartition("/")[2]
        given = json.dumps(schemas[name]["examples"][0])
        address = "localhost:8765" + path.replace("{scene}", "NAME")
        line = f"curl -s {address} -H 'content-type: application/json' -d '{given}'"
        yield f"<pre>{escape(line)}</pre>"
