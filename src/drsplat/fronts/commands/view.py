"""drsplat view: a scene in the browser that answers words; or a page of it, to send to someone."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from .edit_options import add_kept_edits, note_applied
from .options import PORT, add_overwrite, add_query_encoders, count, new_output, words
from .query_options import open_scene

if TYPE_CHECKING:
    from ...query import Scene
    from ...query.catalogue import Catalogue
    from ..viewing.live.service import Service

EXAMPLES = """\
  drsplat view drsplat-demo
  drsplat view room.field --scene scene.ply --views capture --ask "red mug; lamp"
  drsplat view drsplat-demo --export page.html --ask "red vase; couch; something to eat"
  drsplat view scene.ply
  drsplat view --catalogue flats.catalogue

Needs pip install "drsplat[viewer]"; --export needs nothing. The address is only for this machine; with --host
0.0.0.0 it has a token, and anyone who knows it can view, search and save from elsewhere. A scene without a field can
only be viewed."""
DAILY = ("scene", "views", "ask", "encoder", "port", "export", "overwrite")
MAX_GAUSSIANS, MAX_PAGE_GAUSSIANS = 1_000_000, 200_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "field",
        nargs="?",
        help="folder with a field, its scene and photos; field that `drsplat register` wrote; or, without a field, a "
        "scene or the folder of a trained model",
    )
    parser.add_argument(
        "--catalogue", metavar="CATALOGUE",
        help="catalogue to search instead of a scene; thumbnails of its answers open their scenes",
    )  # fmt: skip
    parser.add_argument("--scene", metavar="SCENE", help="scene that was registered")
    parser.add_argument("--views", metavar="CAPTURE", help="posed photos, for cameras and supporting photos")
    parser.add_argument(
        "--ask", type=words, metavar="TEXT", default="", help='query to start with; several: "mug; lamp"'
    )
    parser.add_argument(
        "--words", type=words, metavar="A,B,C",
        help="words for naming a clicked point (default: the encoder's own, else household objects)",
    )  # fmt: skip
    parser.add_argument(
        "--max-gaussians", type=count, metavar="N",
        help=f"show only the N most significant Gaussians (default: {MAX_GAUSSIANS:,}; {MAX_PAGE_GAUSSIANS:,} in a "
        "page)",
    )  # fmt: skip
    parser.add_argument(
        "--up", type=words, metavar="AXIS",
        help="axis that points up: +x -x +y -y +z or -z (default: from the orientation of the photos)",
    )  # fmt: skip
    _add_serving(parser.add_argument_group("viewer"))
    _add_page(parser.add_argument_group("page"))
    add_kept_edits(parser, "kept")
    add_overwrite(parser)
    add_query_encoders(parser)


def _add_serving(parser: argparse._ArgumentGroup) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="address to listen on (default: 127.0.0.1, this machine only)",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=PORT, default=8080, metavar="N",
        help="port to listen on; if taken, the next free one (default: 8080)",
    )  # fmt: skip
    parser.add_argument(
        "--save-dir", metavar="DIR",
        help="folder for saved files, under new names (default: none, the browser downloads them)",
    )  # fmt: skip


def _add_page(parser: argparse._ArgumentGroup) -> None:
    parser.add_argument("--export", metavar="PAGE.html", help="write a page with the answers to --ask, and exit")
    parser.add_argument(
        "--path", metavar="orbit|swing|photos|FILE",
        help="path of the film in the page of --export, as for drsplat render (default: orbit)",
    )  # fmt: skip
    parser.add_argument(
        "--play", action="store_true", help="play the film when the page of --export opens (default: on demand)"
    )


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...errors import InputError

    if (arguments.field is None) == (arguments.catalogue is None):
        raise InputError("view: expected a scene, or --catalogue CATALOGUE")
    if arguments.catalogue is not None:
        _serve_catalogue(arguments)
    if arguments.path is not None and arguments.export is None:
        raise InputError("path: a film is part of a page: give --export PAGE.html")
    if arguments.play and arguments.export is None:
        raise InputError("play: a film is part of a page: give --export PAGE.html")
    return _export(arguments) if arguments.export else _serve(arguments)


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted

    if "page" in answer:
        print(f"{answer['page']}: {counted(answer['num_shown'], 'Gaussian')}, {answer['bytes'] / 1e6:.1f} MB")
        if answer["moving"]:
            print(f"  {answer['moving']}")
        for one in answer["queries"]:
            print(f"  {one['text']}: {counted(one['num_matches'], 'match', 'matches')}")


def _export(arguments: argparse.Namespace) -> dict[str, Any]:
    from ... import export_page
    from ..viewing.results import split_queries

    new_output(arguments.export, arguments.overwrite, ".html")
    scene, queries = _scene(arguments), split_queries(arguments.ask)
    page = export_page(
        arguments.export, scene, queries, words=_words(arguments), up=_up(arguments, scene),
        max_gaussians=arguments.max_gaussians, overwrite=arguments.overwrite,
        path_name="orbit" if arguments.path is None else arguments.path, plays=arguments.play,
        edits=arguments.edits or "kept",
    )  # fmt: skip
    note_applied(page.num_edits)
    return {
        "page": arguments.export,
        "bytes": Path(arguments.export).stat().st_size,
        "num_shown": len(page.shown),
        "num_left_out": page.shown.num_left_out,
        "num_edits": page.num_edits,
        "moving": None if page.times is None else page.times.summary,
        "queries": [{"text": answer.text, "num_matches": len(answer.matches)} for answer in page.answers],
    }


def _serve(arguments: argparse.Namespace) -> NoReturn:
    _require_packages()
    from ..viewing.tiled import session_of

    scene, budget = _scene(arguments), arguments.max_gaussians or MAX_GAUSSIANS
    session = session_of(scene, budget, _words(arguments), edits_kept=arguments.edits != "none")
    note_applied(session.edits.listed.done)
    up, shown = _up(arguments, scene), session.shown
    with _service(arguments) as service:
        service.show(session, up, arguments.ask)
        _print_address(arguments.json, service.address, {"num_shown": session.num_shown}, shown.summary)
        service.run()
    raise SystemExit(0)  # all has been said


def _serve_catalogue(arguments: argparse.Namespace) -> NoReturn:
    from ...base.terminal import counted
    from ...errors import InputError
    from ...query.catalogue import Catalogue

    _require_packages()
    one_scene = [
        name for name in ("scene", "views", "words", "export", "up", "edits") if getattr(arguments, name) is not None
    ]
    if one_scene:
        raise InputError(f"--{one_scene[0]} is of one scene, and --catalogue of many: drop one")
    given = {name: getattr(arguments, name) for name in ("encoder", "vocabulary", "device", "threads")}
    catalogue = Catalogue.open(arguments.catalogue, **given)
    _ = catalogue.encoder  # or the error that says that nothing is in it
    number = len(catalogue)
    with _service(arguments, catalogue) as service:
        service.search(arguments.ask)
        _print_address(
            arguments.json, service.address, {"num_objects": number}, f"{counted(number, 'object')} to search."
        )
        service.run()
    raise SystemExit(0)


def _require_packages() -> None:
    """Check the viewer's packages. Raises: MissingExtraError: one is not installed."""
    from ..serving.libraries import require_packages

    require_packages("viewer", "fastapi", "uvicorn", "prometheus_client")


@contextmanager
def _service(arguments: argparse.Namespace, catalogue: Catalogue | None = None) -> Iterator[Service]:
    """Make a viewer that is about to answer on the address of the options.

    Raises: InputError: nothing can listen there.
    """
    from ..viewing.listening import listening_socket
    from ..viewing.live.service import Service
    from ..viewing.live.shared import Shared
    from ..viewing.live.shelf import Shelf
    from ..viewing.saving import Saves

    def opened(path: Path) -> Scene:
        return _scene(argparse.Namespace(**{**vars(arguments), "field": str(path), "scene": None, "views": None}))

    saves = Saves(None if arguments.save_dir is None else Path(arguments.save_dir))
    shelf = None if catalogue is None else Shelf(catalogue)
    shared = Shared(saves, opened, arguments.max_gaussians or MAX_GAUSSIANS, shelf=shelf)
    with listening_socket(arguments.host, arguments.port) as listening:
        yield Service(shared, listening, arguments.host)


def _print_address(as_json: bool, address: str, numbers: dict[str, int], said: str) -> None:
    """Print the address at once: who waits for the end never learns it."""
    if as_json:
        print(json.dumps({"address": address, **numbers}), flush=True)
    else:
        print(f"Open {address} in a browser; Ctrl-C ends this. {said}", flush=True)


def _words(arguments: argparse.Namespace) -> list[str] | None:
    given = (word.strip() for word in (arguments.words or "").split(","))
    return [word for word in given if word] if arguments.words else None


def _scene(arguments: argparse.Namespace) -> Scene:
    from ..viewing.bare import is_bare, open_bare

    path = Path(arguments.field)
    if arguments.scene is None and is_bare(path):
        return open_bare(path, arguments.views, arguments.threads)
    scene = open_scene(arguments)
    _ = scene.rows  # or the error that says what is missing
    return scene


def _up(arguments: argparse.Namespace, scene: Scene) -> Any:
    from ...authoring.filming.looking import named_up, up_direction

    return up_direction(scene) if arguments.up is None else named_up(arguments.up)
