"""drsplat serve: scenes over HTTP."""

from ...base.terminal import counted
from .declaring import Facts, argument, declaration, flag, option, part, words
from .edit_options import note_own_scenes
from .mcp import Listening, listening
from .options import Encoders, Verb, search_device

EXAMPLES = """\
  drsplat serve scenes
  drsplat serve drsplat-demo --port 8765 --workers 2
  drsplat serve drsplat-demo --take-views --api-key-file key.txt
  drsplat serve scenes --host 0.0.0.0 --api-key-file key.txt --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K
  curl -s localhost:8765/scenes/drsplat-demo/locate -H 'content-type: application/json' -d '{"text": "red vase"}'

"scenes" is a folder with a field and its scene, or a folder of such folders. /docs and /openapi.json describe all
routes; docs/serve.md has examples."""
DAILY = "host port api_key_file encoder"


@declaration
class Options(Verb):
    """Options of this verb."""

    folder: str = argument("folder of a scene, or of several such folders")
    listening: Listening = listening(port=8765, workers=2)
    allow_origin: list[str] = option(
        "origin of web pages whose scripts may read answers (CORS), e.g. https://example.org (default: none); may be "
        "repeated", "ORIGIN", None, [], action="append",
    )  # fmt: skip
    take_views: bool = flag(
        "accept posed photos at /scenes/SCENE/views and add them to the fields; needs --api-key-file"
    )
    segmenter: str | None = option(
        "segmenter for these photos, the same as for the scenes (default: only the built-in one)", "NAME", words
    )
    catalogue: str | None = option("catalogue to serve as well, at /catalogue", "CATALOGUE")
    encoders: Encoders = part(Encoders)
    search_device: str = search_device()


def run(options: Options) -> Facts:
    from ..serving.listening import require

    require("serve", "fastapi", "uvicorn", "prometheus_client")
    where = options.listening
    key = where.key()

    from ..serving.app import Settings, serve
    from ..serving.guards import Limits
    from ..serving.listening import address_of, bound_socket
    from ..serving.scene_folder import Sources

    sources = Sources(
        **vars(options.encoders), threads=options.threads, search_device=options.search_device,
        segmenter=options.segmenter,
    )  # fmt: skip
    limits = Limits(seconds=where.timeout, workers=where.workers)
    settings = Settings(
        options.folder, sources, limits, options.catalogue, key, where.names, tuple(options.allow_origin),
        options.take_views,
    )  # fmt: skip
    scene_folder = settings.scene_folder()
    num_scenes = scene_folder.checked()
    note_own_scenes(scene_folder.folders().values())
    with bound_socket(where.host, where.port) as socket:
        if not options.json:
            print(f"{counted(num_scenes, 'scene')} at {address_of(socket, where.host)}/scenes", flush=True)
        serve(settings, socket, options.json)
    return {"stopped": True}


def show(answer: Facts) -> None:
    print("stopped")
