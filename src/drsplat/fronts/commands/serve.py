"""drsplat serve: scenes over HTTP."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .edit_options import note_own_scenes
from .listening import add_computing, add_listening, checked_key, own_names
from .options import add_query_encoders, add_search_device, words

EXAMPLES = """\
  drsplat serve scenes
  drsplat serve drsplat-demo --port 8765 --workers 2
  drsplat serve drsplat-demo --take-views --api-key-file key.txt
  drsplat serve scenes --host 0.0.0.0 --api-key-file key.txt --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K
  curl -s localhost:8765/scenes/drsplat-demo/locate -H 'content-type: application/json' -d '{"text": "red vase"}'

"scenes" is a folder with a field and its scene, or a folder of such folders. /docs and /openapi.json describe all
routes; docs/serve.md has examples."""
DAILY = ("host", "port", "api_key_file", "encoder")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", help="folder of a scene, or of several such folders")
    add_listening(parser, port=8765)
    add_computing(parser, workers=2)
    parser.add_argument(
        "--allow-origin", action="append", default=[], metavar="ORIGIN",
        help="origin of web pages whose scripts may read answers (CORS), e.g. https://example.org (default: none); may "
        "be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--take-views", action="store_true",
        help="accept posed photos at /scenes/SCENE/views and add them to the fields; needs --api-key-file",
    )  # fmt: skip
    parser.add_argument(
        "--segmenter", type=words, metavar="NAME",
        help="segmenter for these photos, the same as for the scenes (default: only the built-in one)",
    )  # fmt: skip
    parser.add_argument("--catalogue", metavar="CATALOGUE", help="catalogue to serve as well, at /catalogue")
    add_query_encoders(parser)
    add_search_device(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..serving.libraries import require

    require("serve", "fastapi", "uvicorn", "prometheus_client")
    _started(arguments, checked_key(arguments))
    return {"stopped": True}


def show(answer: dict[str, Any]) -> None:
    print("stopped")


def _started(arguments: argparse.Namespace, key: str | None) -> None:
    from ...base.terminal import counted
    from ..serving.app import Settings
    from ..serving.limits import Limits
    from ..serving.listening import address_of, bound_socket
    from ..serving.running import serve
    from ..serving.scene_folder import SceneFolder, Sources

    sources = Sources(
        arguments.encoder, arguments.vocabulary, arguments.device, arguments.threads, arguments.search_device,
        arguments.segmenter,
    )  # fmt: skip
    limits = Limits(seconds=arguments.timeout, workers=arguments.workers)
    names, origins = own_names(arguments), tuple(arguments.allow_origin)
    settings = Settings(
        arguments.folder, sources, limits, key, names, origins, arguments.catalogue, arguments.take_views
    )
    catalogue = None if arguments.catalogue is None else Path(arguments.catalogue)
    scene_folder = SceneFolder(Path(arguments.folder), sources, catalogue_path=catalogue)
    num_scenes = scene_folder.checked()
    note_own_scenes(scene_folder.folders().values())
    with bound_socket(arguments.host, arguments.port) as listening:
        if not arguments.json:
            print(f"{counted(num_scenes, 'scene')} at {address_of(listening, arguments.host)}/scenes", flush=True)
        serve(settings, listening, arguments.json)
