"""drsplat mcp: scenes for language models, over the Model Context Protocol."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path
from typing import Any

from .edit_options import note_own_scenes
from .listening import add_computing, add_listening, checked_key, own_names
from .options import add_query_encoders

EXAMPLES = """\
  drsplat mcp scenes
  drsplat mcp drsplat-demo --http --port 8766
  drsplat mcp scenes --http --host 0.0.0.0 --api-key-file key.txt

"scenes" is a folder with a field and its scene, or a folder of such folders. Without --http, the server uses stdin
and stdout, for programs that start the server themselves: {"command": "drsplat", "args": ["mcp",
"/path/to/scenes"]}."""
DAILY = ("http", "port", "encoder")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="folder of a scene, or of several such folders")
    parser.add_argument("--http", action="store_true", help="serve streamable HTTP at /mcp instead of stdin and stdout")
    add_listening(parser, port=8766)
    add_computing(parser, workers=1)
    parser.add_argument("--catalogue", metavar="CATALOGUE", help="catalogue for the tool search_all_scenes")
    add_query_encoders(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...errors import InputError
    from ..serving.libraries import require

    require("mcp", "mcp", "prometheus_client")
    if arguments.json and not arguments.http:
        raise InputError("--json goes with --http: stdout speaks the protocol")
    key = checked_key(arguments)

    from ..serving.limits import Limits
    from ..serving.listening import address_of, bound_socket
    from ..serving.metrics import Metrics
    from ..serving.scene_folder import SceneFolder, Sources
    from ..serving.speaking import over_http, over_stdio
    from ..serving.tools import make_server
    from ..serving.workbench import Workbench
    from ..serving.worker import Workplace

    sources = Sources(arguments.encoder, arguments.vocabulary, arguments.device, arguments.threads)
    catalogue = None if arguments.catalogue is None else Path(arguments.catalogue)
    scene_folder = SceneFolder(Path(arguments.folder), sources, catalogue_path=catalogue)
    scene_folder.check_sources()
    scene_folder.check_catalogue()
    note_own_scenes(scene_folder.folders().values())
    limits = Limits(seconds=arguments.timeout, workers=arguments.workers)
    bench = Workbench(Workplace(arguments.folder, sources, limits, arguments.catalogue), Metrics())
    server = make_server(scene_folder, bench, limits)
    with closing(bench):
        if not arguments.http:
            over_stdio(server)
            return {"stopped": True}
        with bound_socket(arguments.host, arguments.port) as listening:
            if not arguments.json:
                print(f"MCP at {address_of(listening, arguments.host)}/mcp; Ctrl-C ends this.", flush=True)
            over_http(server, listening, key, own_names(arguments))
    return {"stopped": True}


def show(answer: dict[str, Any]) -> None:
    """Show nothing: stdout belongs to the protocol."""
