"""drsplat mcp: scenes for language models, over the Model Context Protocol."""

from contextlib import closing
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..serving.listening import is_loopback, names_of
from .declaring import PORT, Facts, argument, declaration, flag, length, option, part, up_to
from .edit_options import note_own_scenes
from .options import Encoders, Verb

MAX_WORKERS = 256  # processes


@declaration
class Listening:
    """Address that requests come to, and how many are answered at a time."""

    host: str = option(
        "address to listen on (default: 127.0.0.1, this machine only); others need --api-key-file", "ADDRESS", None,
        "127.0.0.1",
    )  # fmt: skip
    port: int = option("port to listen on", "N", PORT)
    api_key_file: str | None = option(
        "file with the key that every request must send: Authorization: Bearer KEY", "FILE"
    )  # fmt: skip
    open: bool = flag("allow another --host without a key, open to anyone")
    workers: int = option("worker processes", "N", up_to(MAX_WORKERS))
    timeout: float = option("time limit of a request (default: 30)", "SECONDS", length, 30.0)

    @property
    def names(self) -> tuple[str, ...] | None:
        """Host names that a request may use, None for any, where other machines can reach this one."""
        return names_of(self.host) if is_loopback(self.host) else None

    def key(self) -> str | None:
        """Return the key that requests have to give, None for none.

        Raises: InputError: other machines could ask without one, and --open does not say so; no key in its file.
        """

        key = None
        if self.api_key_file is not None:
            path = Path(self.api_key_file)
            if not path.is_file():
                raise InputError(f"{path}: there is no such file")
            key = path.read_text(encoding="utf-8", errors="replace").strip()
            if len(key) < 16 or not key.isascii() or not key.isprintable() or " " in key:
                raise InputError(
                    f"{path}: expected a key of 16 or more letters, digits and signs, such as `openssl rand -hex 24` "
                    "prints"
                )
        if not is_loopback(self.host) and key is None and not self.open:
            raise InputError(
                f"--host {self.host} opens it to other machines: pass --api-key-file FILE, or --open to let anyone"
            )
        return key


def listening(port: int, workers: int) -> Any:
    """Declare `Listening` with a port and a number of processes of a verb's own."""
    waiting = f"worker processes, one request each at a time; others wait (default: {workers})"
    return part(
        Listening,
        port={"default": port, "help": f"port to listen on (default: {port})"},
        workers={"default": workers, "help": waiting},
    )


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

    from ..serving.guards import Limits
    from ..serving.listening import address_of, bound_socket
    from ..serving.metrics import Metrics
    from ..serving.scene_folder import Sources
    from ..serving.tools import make_server, over_http, over_stdio
    from ..serving.workbench import Workbench
    from ..serving.worker import Workplace

    sources = Sources(**vars(options.encoders), threads=options.threads)
    limits = Limits(seconds=where.timeout, workers=where.workers)
    place = Workplace(options.folder, sources, limits, options.catalogue)
    scene_folder = place.scene_folder()
    scene_folder.check_sources()
    note_own_scenes(scene_folder.folders().values())
    bench = Workbench(place, Metrics())
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
