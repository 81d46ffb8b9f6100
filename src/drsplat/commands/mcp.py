"""drsplat mcp: scenes for language models, over the Model Context Protocol."""

from __future__ import annotations

import argparse
from typing import Any

from .options import PORT, add_query_encoders

SUMMARY = "let language models ask the scenes of a folder (Model Context Protocol)"
EXAMPLES = """\
  drsplat mcp scenes
  drsplat mcp drsplat-demo --http --port 8766

scenes is a folder with a field and its scene, or with one of these in each subfolder. Without --http the protocol is
spoken on stdin and stdout, as programs expect that start the server themselves: {"command": "drsplat", "args": ["mcp",
"/path/to/scenes"]}."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="a scene's folder, or a folder of such folders")
    parser.add_argument(
        "--http", action="store_true", help="streamable HTTP at /mcp instead of stdin and stdout"
    )
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="address of --http; anyone who reaches it may ask (default: 127.0.0.1, this machine only)",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=PORT, default=8766, metavar="N", help="port of --http (default: 8766)"
    )
    add_query_encoders(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..errors import InputError
    from ..serving.libraries import require

    require("mcp", "mcp")
    if arguments.json and not arguments.http:
        raise InputError("--json goes with --http: stdout speaks the protocol")
    from pathlib import Path

    from ..serving.catalog import Catalog, Sources
    from ..serving.tools import make_server

    sources = Sources(arguments.encoder, arguments.vocabulary, arguments.device, arguments.threads)
    server = make_server(Catalog(Path(arguments.folder), sources))
    if arguments.http:
        server.run("streamable-http", host=arguments.host, port=arguments.port)
    else:
        server.run("stdio")
    return {"stopped": True}


def show(answer: dict[str, Any]) -> None:
    """Nothing: stdout belongs to the protocol."""
