"""drsplat view: a scene in the browser that answers words; or a page of it, to send to someone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from ...base.terminal import counted
from ...errors import InputError
from ..serving.listening import require_packages
from .declaring import PORT, Facts, argument, count, declaration, flag, option, part
from .declaring import words as text  # an option is called words
from .edit_options import kept_edits, note_applied
from .options import Encoders, Verb, new_output, overwrite

if TYPE_CHECKING:
    from ...authoring.editing.edits import KeptEdits
    from ...base.arrays import Vector3
    from ...query import Scene
    from ...query.catalogue import Catalogue

EXAMPLES = """\
  drsplat view drsplat-demo
  drsplat view room.field --scene scene.ply --views capture --ask "red mug; lamp"
  drsplat view drsplat-demo --export page.html --ask "red vase; couch; something to eat"
  drsplat view scene.ply
  drsplat view --catalogue flats.catalogue

A viewer needs packages of its own (`drsplat doctor` says how to install them), --export does not. The address is only
for this machine; with --host 0.0.0.0 it has a token, and anyone who knows it can view, search and save from elsewhere.
A scene without a field can only be viewed."""
DAILY = "scene views ask encoder port export overwrite"
MAX_GAUSSIANS, MAX_PAGE_GAUSSIANS = 1_000_000, 200_000


@declaration
class Options(Verb):
    """Options of this verb."""

    field: str | None = argument(
        "folder with a field, its scene and photos; field that `drsplat register` wrote; or, without a field, a scene "
        "or the folder of a trained model", nargs="?",
    )  # fmt: skip
    catalogue: str | None = option(
        "catalogue to search instead of a scene; thumbnails of its answers open their scenes", "CATALOGUE"
    )
    scene: str | None = option("scene that was registered", "SCENE")
    views: str | None = option("posed photos, for cameras and supporting photos", "CAPTURE")
    ask: str = option('query to start with; several: "mug; lamp"', "TEXT", text, "")
    words: str | None = option(
        "words for naming a clicked point (default: the encoder's own, else household objects)", "A,B,C", text
    )
    max_gaussians: int | None = option(
        f"show only the N most significant Gaussians (default: {MAX_GAUSSIANS:,}; {MAX_PAGE_GAUSSIANS:,} in a page)",
        "N", count,
    )  # fmt: skip
    up: str | None = option(
        "axis that points up: +x -x +y -y +z or -z (default: from the orientation of the photos)", "AXIS", text
    )
    host: str = option(
        "address to listen on (default: 127.0.0.1, this machine only)", "ADDRESS", None, "127.0.0.1", title="viewer"
    )
    port: int = option(
        "port to listen on; if taken, the next free one (default: 8080)", "N", PORT, 8080, title="viewer"
    )
    save_dir: str | None = option(
        "folder for saved files, under new names (default: none, the browser downloads them)", "DIR", title="viewer"
    )
    export: str | None = option("write a page that answers --ask and other words, and exit", "PAGE.html", title="page")
    known: str | None = option(
        "words and phrases that the page of --export answers besides those that the field keeps or the encoder knows",
        "A,B,C", text, title="page",
    )  # fmt: skip
    path: str | None = option(
        "path of the film in the page of --export, as for drsplat render (default: orbit)", "orbit|swing|photos|FILE",
        title="page",
    )  # fmt: skip
    play: bool = flag("play the film when the page of --export opens (default: on demand)", title="page")
    edits: KeptEdits | None = kept_edits("kept")
    overwrite: bool = overwrite()
    encoders: Encoders = part(Encoders)


def run(options: Options) -> Facts:
    if (options.field is None) == (options.catalogue is None):
        raise InputError("view: expected a scene, or --catalogue CATALOGUE")
    if options.catalogue is None:
        if options.export is not None:
            return _export(options, options.export)
        for name in ("path", "play", "known"):
            if getattr(options, name):
                raise InputError(f"{name} is of a page: give --export PAGE.html")
    return _serve(options)


def show(answer: Facts) -> None:
    if "page" in answer:
        print(f"{answer['page']}: {counted(answer['num_shown'], 'Gaussian')}, {answer['bytes'] / 1e6:.1f} MB")
        if answer["moving"]:
            print(f"  {answer['moving']}")
        for one in answer["queries"]:
            print(f"  {one['text']}: {counted(one['num_matches'], 'match', 'matches')}")
        if answer["knows"]:
            print(f"  {answer['knows']}")


def _export(options: Options, path: str) -> Facts:
    from ... import export_page
    from ..viewing.results import split_queries

    new_output(path, options.overwrite, ".html")
    scene = _scene(options)
    page = export_page(
        path, scene, split_queries(options.ask), words=_words(options.words), up=_up(options.up, scene),
        max_gaussians=options.max_gaussians, overwrite=options.overwrite, path_name=options.path or "orbit",
        plays=options.play, edits=options.edits or "kept",
        known=_words(options.known) or (),
    )  # fmt: skip
    note_applied(page.num_edits)
    return {
        "page": path,
        "bytes": Path(path).stat().st_size,
        "num_shown": len(page.shown),
        "num_left_out": page.shown.num_left_out,
        "num_edits": page.num_edits,
        "moving": None if page.times is None else page.times.summary,
        "knows": "" if page.search is None else page.search.about,
        "queries": [{"text": answer.text, "num_matches": len(answer.matches)} for answer in page.answers],
    }


def _serve(options: Options) -> NoReturn:
    """Open a scene, or a catalogue of many, to browsers. Raises: InputError: nothing can listen there."""
    require_packages("viewer", "fastapi", "uvicorn", "prometheus_client")
    from ..viewing.live.service import Service, listening_socket
    from ..viewing.live.shared import Shared
    from ..viewing.saving import Saves
    from ..viewing.tiled import session_of

    def opened(path: Path) -> Scene:
        return _scene(replace(options, field=str(path), scene=None, views=None))

    most, catalogue = options.max_gaussians or MAX_GAUSSIANS, _catalogue(options)
    if catalogue is None:
        scene = _scene(options)
        session = session_of(scene, most, _words(options.words), edits_kept=options.edits != "none")
        note_applied(session.edits.listed.done)
        up, numbers, said = _up(options.up, scene), {"num_shown": session.num_shown}, session.shown.summary
    else:
        numbers = {"num_objects": len(catalogue)}
        said = f"{counted(len(catalogue), 'object')} to search."
    saves = Saves(None if options.save_dir is None else Path(options.save_dir))
    shared = Shared(saves, opened, most, catalogue=catalogue)
    with listening_socket(options.host, options.port) as listening:
        service = Service(shared, listening, options.host)
        if catalogue is None:
            service.show(session, up, options.ask)
        if options.json:  # at once: who waits for the end never learns the address
            print(json.dumps({"address": service.address, **numbers}), flush=True)
        else:
            print(f"Open {service.address} in a browser; Ctrl-C ends this. {said}", flush=True)
        service.run()
    raise SystemExit(0)  # all has been said


def _catalogue(options: Options) -> Catalogue | None:
    """Return the catalogue that is named. Raises: InputError: options of one scene; there is nothing in it."""
    from ...query.catalogue import Catalogue

    if options.catalogue is None:
        return None
    for name in ("scene", "views", "ask", "words", "export", "up", "edits"):
        if getattr(options, name):
            raise InputError(f"--{name} is of one scene, and --catalogue of many: drop one")
    catalogue = Catalogue.open(options.catalogue, **vars(options.encoders), threads=options.threads)
    _ = catalogue.encoder  # or the error that says that nothing is in it
    return catalogue


def _words(given: str | None) -> list[str] | None:
    return [word.strip() for word in given.split(",") if word.strip()] if given else None


def _scene(options: Options) -> Scene:
    from ... import open_scene
    from ..viewing.bare import is_bare, open_bare

    assert options.field is not None
    path, threads = Path(options.field), options.threads
    if options.scene is None and is_bare(path):
        return open_bare(path, options.views, threads)
    scene = open_scene(
        options.field, scene=options.scene, views=options.views, threads=threads, **vars(options.encoders)
    )
    _ = scene.rows  # or the error that says what is missing
    return scene


def _up(axis: str | None, scene: Scene) -> Vector3:
    from ...authoring.filming.looking import named_up, up_direction

    return up_direction(scene) if axis is None else named_up(axis)
