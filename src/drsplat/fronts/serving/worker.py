"""A process that answers one question at a time, and that can be ended at any moment.

It opens scenes and decodes pictures of strangers; what goes wrong in it, be it a loop or a damaged file, costs one
answer. No exception ends it: only a signal, a fault in native code or the end of the service does.
Questions and answers are JSON and bytes over a socket: nothing that arrives is unpickled.
"""

import json
import logging
import signal
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ...base.system import end_with
from ...errors import DrSplatError, FormatError
from ...query import Scene
from .answers import ANSWERS, answered
from .catalogued import catalogue_reply
from .limits import Limits
from .live import ACTS, Adder, live_reply
from .models import SceneList, SceneSummary
from .replies import BUG, Reply, packed, problem, refusal
from .scene_folder import SceneFaultError, SceneFolder, Sources, without_paths

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Workplace:
    """Settings that a worker starts with."""

    folder: str
    sources: Sources = field(default_factory=Sources)
    limits: Limits = field(default_factory=Limits)
    catalogue: str | None = None

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> "Workplace":
        given = json.loads(text)
        return cls(given["folder"], Sources(**given["sources"]), Limits(**given["limits"]), given["catalogue"])


def main(descriptor: int, parent: int) -> None:
    """Answer what comes over an inherited socket until it is closed, or the process `parent` ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this process ends it
    end_with(parent)
    link = Connection(descriptor)
    with suppress(EOFError, OSError):
        place = Workplace.from_json(link.recv_bytes())
        catalogue = None if place.catalogue is None else Path(place.catalogue)
        scene_folder = SceneFolder(Path(place.folder), place.sources, catalogue_path=catalogue)
        adder = Adder(scene_folder)
        while True:
            asked = json.loads(link.recv_bytes())
            link.send_bytes(packed(safe_reply_to(scene_folder, place, adder=adder, **asked)))


def safe_reply_to(scene_folder: SceneFolder, place: Workplace, **question: Any) -> Reply:
    """Return the reply to a question, see `reply_to`; a fault of ours becomes a 500, with its traceback on stderr."""
    try:
        return reply_to(scene_folder, place, **question)
    except BaseException as error:  # panics of Rust, which LanceDB is made of, are no `Exception`
        _log.error("no answer to %s", f"{question!a:.300}", exc_info=error)
        return problem(500, BUG, "bug")


def reply_to(
    scene_folder: SceneFolder, place: Workplace, act: str, scene: str, asked: dict[str, Any], adder: Adder
) -> Reply:
    """Answer an act: "list", "open" (which also loads who embeds words), one of `ANSWERS`, of views or a catalogue."""
    try:
        if act == "list":
            scenes = [SceneSummary(**vars(one)) for one in scene_folder.summaries()]
            return Reply(SceneList(scenes=scenes).model_dump_json().encode())
        if act == "open" and not scene:
            with suppress(DrSplatError):  # told when it is asked
                scene_folder.catalogue.query_encoder  # noqa: B018
            return Reply(b"")
        if act.startswith("catalogue-"):
            return catalogue_reply(scene_folder.catalogue, act, asked, place.limits)
        if act in ACTS:
            return live_reply(scene_folder, adder, act, scene, asked, place.limits)
        opened = scene_folder.scene(scene)
        if act != "open":
            return _answered(opened, scene, act, asked, place.limits)
        if asked["for"] in ANSWERS and ANSWERS[asked["for"]].words:
            with suppress(DrSplatError):  # told when words are asked for
                opened.encoder  # noqa: B018
        return Reply(b"")
    except DrSplatError as error:
        return refusal(error, without_paths(str(error), scene_folder.roots))


def _answered(opened: Scene, name: str, act: str, asked: dict[str, Any], limits: Limits) -> Reply:
    """Answer an act about a scene. Raises: SceneFaultError: a tile, which is read when it is needed, is damaged."""
    try:
        return answered(opened, act, asked, limits)
    except FormatError as error:
        if opened.tiles is None or not str(error).startswith(str(opened.tiles.path.parent)):
            raise
        raise SceneFaultError(f"scene {name!r} cannot be read: {error}") from error


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
