"""drsplat mcp: scenes for language models, over the Model Context Protocol."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from ...errors import InputError
from .declaring import Facts, argument, declaration, flag, option, part
from .edit_options import note_own_scenes
from .listening import Listening, listening
from .options import Encoders, Verb

EXAMPLES = """\
  drsplat mcp scenes
  drsplat mcp drsplat-demo --http --port 8766
  drsplat mcp scenes --http --host 0.0.0.0 --api-key-file key.txt

"scenes" is a folder with a field and its scene, or a folder of such folders. Without --http, the server uses stdin
and stdout, for programs that start the server themselves: {"command": "drsplat", "args": ["mcp",
"/path/to/scenes"]}."""
DAILY = "http port encoder"


@declaration
class Options(Verb):
    """Options of this verb."""

    folder: str = argument("folder of a scene, or of several such folders")
    http: bool = flag("serve streamable HTTP at /mcp instead of stdin and stdout")
    listening: Listening = listening(port=8766, workers=1)
    catalogue: str | None = option("catalogue for the tool search_all_scenes", "CATALOGUE")
    encoders: Encoders = part(Encoders)


def run(options: Options) -> Facts:
    from ..serving.listening import require

    require("mcp", "mcp", "prometheus_client")
    if options.json and not options.http:
        raise InputError("--json goes with --http: stdout speaks the protocol")
    where = options.listening
    key = where.key()

    from ..serving.limits import Limits
    from ..serving.listening import address_of, bound_socket
    from ..serving.metrics import Metrics
    from ..serving.scene_folder import SceneFolder, Sources
    from ..serving.tools import make_server, over_http, over_stdio
    from ..serving.workbench import Workbench
    from ..serving.worker import Workplace

    sources = Sources(**vars(options.encoders), threads=options.threads)
    catalogue = None if options.catalogue is None else Path(options.catalogue)
    scene_folder = SceneFolder(Path(options.folder), sources, catalogue_path=catalogue)
    scene_folder.check_sources()
    scene_folder.check_catalogue()
    note_own_scenes(scene_folder.folders().values())
    limits = Limits(seconds=where.timeout, workers=where.workers)
    bench = Workbench(Workplace(options.folder, sources, limits, options.catalogue), Metrics())
    server = make_server(scene_folder, bench, limits)
    with closing(bench):
        if not options.http:
            over_stdio(server)
            return {"stopped": True}
        with bound_socket(where.host, where.port) as socket:
            if not options.json:
                print(f"MCP at {address_of(socket, where.host)}/mcp; Ctrl-C ends this.", flush=True)
            over_http(server, socket, key, where.names)
    return {"stopped": True}


def show(answer: Facts) -> None:
    """Show nothing: stdout belongs to the protocol."""
