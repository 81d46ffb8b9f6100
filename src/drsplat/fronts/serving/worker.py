"""A process that answers one question at a time, and that can be ended at any moment.

It opens scenes and decodes pictures of strangers; what goes wrong in it, be it a loop or a damaged file, costs one
answer. No exception ends it: only a signal, a fault in native code or the end of the service does.
Questions and answers are JSON and bytes over a socket: nothing that arrives is unpickled.
"""

import json
import logging
import signal
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from ...authoring.editing.resolving import object_rows
from ...authoring.exporting import labelled
from ...authoring.exporting.writing import Only, kept_edits, written
from ...base.contents import Document
from ...base.system import end_with
from ...errors import DrSplatError, FormatError, InputError
from ...formats.gaussian_ply import write_gaussians
from ...query import Match, Query, Scene
from ...query.documents import answer_document, segmentation_document
from ...query.objects import match_of, objects_of
from ...query.sheets import object_picture
from ...query.suggesting import missed_text, words_instead
from . import models, query_fields
from .conversation import tool_answer, when_told, words_of
from .guards import Limits
from .live import ACTS, Adder, live_reply
from .models import SceneList, SceneSummary, listed_objects, matches_of, measured, object_list, significant
from .query_fields import Export, Request, asks_something, catalogue_reply, cut_of, query_of, values_of
from .replies import BUG, GLB, JPEG, PLY, PNG, Reply, jpeg, packed, png, problem, refusal
from .scene_folder import SceneFaultError, SceneFolder, Sources, without_paths

BYTES_BESIDE_HARMONICS = 48  # of a Gaussian: place, rotation, scales, opacity, point's colour
BYTES_PER_COEFFICIENT = 12
# Seconds of a Gaussian on two busy cores, rounded up: writing it, completing an object, and applying an edit.
WRITING_S, COMPLETING_S, EDITING_S = 6e-6, 25e-6, 0.3e-6


def exported(scene: Scene, asked: Export, limits: Limits) -> Reply:
    """Export the scene for other programs: GLB with named objects, PLY or SPZ.

    Raises: InputError: options that do not go together, a scene that is too large to send or takes too long; as
    `labelled`.
    """
    query = query_of(asked, limits) if asks_something(asked) else None
    if asked.only and (query is None or asked.object is not None):
        raise InputError("only: what matches is that of a query: pass text, and no object")
    if scene.tiles is not None:
        raise InputError(
            f"this scene of {len(scene.rows):,} Gaussians is in tiles, which are not sent as one file: "
            "/objects/NUMBER/ply sends an object, and `drsplat export` writes all of it as 3D Tiles where the scene is"
        )
    size = len(scene.gaussians) * (BYTES_BESIDE_HARMONICS + BYTES_PER_COEFFICIENT * scene.gaussians.sh.shape[1])
    if size > limits.file_bytes:
        raise InputError(
            f"this scene would be a file of about {size / 1e6:,.0f} MB, and up to {limits.file_bytes / 1e6:,.0f} are "
            "sent: `drsplat export` writes it where the scene is"
        )
    _refuse_slow(scene, asked, limits)
    matches: Only = "matches" if asked.only else None
    only = matches if asked.object is None else object_rows(scene, asked.object)
    carried = labelled(scene, query, only=only, time=asked.time, edits=asked.edits, embeddings=asked.embeddings)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"scene.{asked.format}"
        written(path, carried)
        return Reply(path.read_bytes(), GLB if asked.format == "glb" else PLY)


def _refuse_slow(scene: Scene, asked: Export, limits: Limits) -> None:
    """Refuse before it begins what would be ended before it is done. Raises: InputError; as `kept_edits`."""
    num_edits = kept_edits(scene.path, scene.gaussians, asked.edits).done
    each_s = WRITING_S + EDITING_S * num_edits + (0 if asked.object is None else COMPLETING_S)
    seconds = len(scene.gaussians) * each_s
    if seconds > limits.seconds:
        part = "" if asked.object is None else f" --object {asked.object}"  # of `drsplat export`
        raise InputError(
            f"of {len(scene.gaussians):,} Gaussians this takes about {seconds:,.0f} s, and answers take up to "
            f"{limits.seconds:g}: `drsplat export FOLDER{part} --edits {asked.edits} -o scene.{asked.format}` does it"
        )


OBJECT_SIZE_PIXELS = (640, 480)
_log = logging.getLogger(__name__)


def details(scene: Scene, asked: Document, _: Limits) -> models.SceneDetails:
    return models.SceneDetails(
        **models.frame_document(scene),
        name=asked["name"],
        num_gaussians=len(scene.rows),
        num_registered=len(scene.field),
        encoder=scene.field.encoder.name,
        views=[view.name for view in scene.views],
        scene=scene.rows.fingerprint,
    )


def photo(scene: Scene, asked: Document, _: Limits) -> bytes:
    """Return a photo as PNG. Raises: InputError: no such view, or it has no photo."""
    chosen = scene.view(asked["view"])
    if chosen.image_path is None:
        raise InputError(f"view '{chosen.name}' has no photo here: request a picture")
    return png(scene.picture(chosen, photo=True, max_side=asked["max_side"]))


def objects(scene: Scene, asked: Document, _: Limits) -> models.ObjectList:
    shown, unsure = listed_objects(scene, asked["all"])
    if not scene.objects:
        return object_list(scene, [], "photos agree on nothing: more of them, or larger masks, may help")
    more = f"{unsure} more that photos agree less on: all=true lists them" if unsure else ""
    return object_list(scene, shown, ". ".join(filter(None, (more, scene.doubt))))


def object_photo(scene: Scene, asked: Document, _: Limits) -> bytes:
    return jpeg(object_picture(scene, _numbered(scene, asked), size=OBJECT_SIZE_PIXELS))


def object_ply(scene: Scene, asked: Document, _: Limits) -> bytes:
    part = scene.rows.subset(_numbered(scene, asked).gaussian_ids)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.ply"
        write_gaussians(path, part)
        return path.read_bytes()


def _numbered(scene: Scene, asked: Document) -> Match:
    return match_of(scene.field, objects_of(scene.field).thing(asked["number"]))


def selected(scene: Scene, asked: query_fields.Select, limits: Limits) -> models.Selected:
    """Select the Gaussians of a text, vector, image, point or click."""
    answer = scene.ask(query_of(asked, limits))
    return models.Selected(
        measured=measured(answer),
        score_range=[significant(score) for score in answer_document(answer)["score_range"]],
        gaussian_ids=answer.gaussian_ids.tolist() if asked.ids else None,
        field=scene.field.fingerprint,
    )


def located(scene: Scene, asked: query_fields.Locate, limits: Limits) -> models.Located:
    """Locate the matches of a query, best first: centre, oriented box, supporting photos."""
    query = query_of(asked, limits)
    answer = scene.ask(query)
    found = scene.locate(answer, min_gaussians=asked.min_gaussians, box=asked.box)
    return models.Located(
        query=query.text or "",
        count=sum(match.sure for match in found),
        num_matches=len(found),
        matches=matches_of(scene, found[: asked.top], asked.box if asked.tracks else None),
        advice="" if found else f"no match: {missed_text(answer, words_instead(scene, answer)) or 'try other words'}",
        measured=measured(answer),
        field=scene.field.fingerprint,
    )


def when(scene: Scene, asked: query_fields.When, _: Limits) -> models.When:
    """Find the spans of time in which one match stands in a relation to another."""
    one, other = (Query(text, **values_of(vars(asked))) for text in (asked.one, asked.other))
    return when_told(scene, one, asked.relation, other, asked.view)


def segmented(scene: Scene, asked: query_fields.Segment, _: Limits) -> models.Segmented:
    """Give each Gaussian the best of some classes."""
    found = scene.segment(asked.classes, cut_of(asked))
    document = segmentation_document(found)
    for one in document["classes"]:
        one |= {key: significant(one[key]) for key in ("share", "threshold")}
    labels = found.labels.tolist() if asked.labels else None
    return models.Segmented(**document, labels=labels, field=scene.field.fingerprint)


def named(scene: Scene, asked: query_fields.WhatIs, _: Limits) -> models.Words:
    """Name what is at a point or a pixel, best words first."""
    words = words_of(scene.what_is(query_fields.place(asked), asked.names))
    return models.Words(words=words, field=scene.field.fingerprint)


def picture(scene: Scene, asked: query_fields.Picture, limits: Limits) -> bytes:
    """Render a picture as PNG, optionally with the matches of a query kept in colour."""
    shown = models.ids_of(scene.locate(query_of(asked, limits))) if asks_something(asked) else None
    nothing = shown is not None and not len(shown)
    view = asked.view or (scene.best_view() if nothing else None)
    return png(scene.picture(view, shown, photo=asked.photo, max_side=asked.max_side))


class Answering(NamedTuple):
    """Way to an answer.

    asked: the body of its route, which the function's first line describes; None where there is no body. words: whether
    it needs who embeds words. media: of answers that are bytes.
    """

    answer: Callable[[Scene, Any, Limits], BaseModel | bytes | Reply]
    asked: type[Request] | None = None
    words: bool = True
    media: tuple[str, ...] = ()


ANSWERS: Mapping[str, Answering] = {
    "details": Answering(details, words=False),
    "photo": Answering(photo, words=False, media=(PNG,)),
    "objects": Answering(objects),
    "object-picture": Answering(object_photo, words=False, media=(JPEG,)),
    "object-ply": Answering(object_ply, words=False, media=(PLY,)),
    "select": Answering(selected, query_fields.Select),
    "locate": Answering(located, query_fields.Locate),
    "when": Answering(when, query_fields.When),
    "segment": Answering(segmented, query_fields.Segment),
    "what-is": Answering(named, query_fields.WhatIs),
    "picture": Answering(picture, query_fields.Picture, media=(PNG,)),
    "export": Answering(exported, query_fields.Export, media=(GLB, PLY)),
    "tool": Answering(tool_answer),
}


def answered(scene: Scene, what: str, asked: Document, limits: Limits) -> Reply:
    """Return the reply to one of `ANSWERS`. Raises: DrSplatError: the question does not fit the scene."""
    way, field = ANSWERS[what], scene.field.fingerprint
    answer = way.answer(scene, asked if way.asked is None else way.asked(**asked), limits)
    if isinstance(answer, Reply):
        return answer._replace(field=field)
    if isinstance(answer, bytes):
        return Reply(answer, way.media[0], field=field)
    return Reply(answer.model_dump_json().encode(), field=field)


@dataclass(frozen=True)
class Workplace:
    """Settings that a worker starts with: those of its scenes, bounds, and a catalogue's folder, None for none."""

    folder: str
    sources: Sources = field(default_factory=Sources)
    limits: Limits = field(default_factory=Limits)
    catalogue: str | None = None

    def to_json(self) -> str:
        return json.dumps([self.folder, asdict(self.sources), asdict(self.limits), self.catalogue])

    @classmethod
    def from_json(cls, text: str | bytes) -> "Workplace":
        folder, sources, limits, catalogue = json.loads(text)
        return cls(folder, Sources(**sources), Limits(**limits), catalogue)

    def scene_folder(self) -> SceneFolder:
        """Return the scenes of the folder. Raises: InputError: there is no such folder."""
        catalogue = None if self.catalogue is None else Path(self.catalogue)
        return SceneFolder(Path(self.folder), self.sources, catalogue_path=catalogue)


def main(descriptor: int, parent: int) -> None:
    """Answer what comes over an inherited socket until it is closed, or the process `parent` ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this process ends it
    end_with(parent)
    link = Connection(descriptor)
    with suppress(EOFError, OSError):
        place = Workplace.from_json(link.recv_bytes())
        scene_folder = place.scene_folder()
        adder = Adder(scene_folder)
        while True:
            asked = json.loads(link.recv_bytes())
            link.send_bytes(packed(safe_reply_to(scene_folder, place, adder=adder, **asked)))


def safe_reply_to(scene_folder: SceneFolder, place: Workplace, **question: Any) -> Reply:
    """Return the reply to a question, see `reply_to`; a fault of ours becomes a 500, with its traceback on stderr."""
    try:
        return reply_to(scene_folder, place, **question)
    except BaseException as error:  # panics of Rust, as of safetensors, are no `Exception`
        _log.error("no answer to %s", f"{question!a:.300}", exc_info=error)
        return problem(500, BUG, "bug")


def reply_to(scene_folder: SceneFolder, place: Workplace, act: str, scene: str, asked: Document, adder: Adder) -> Reply:
    """Answer an act: "list", "open" (which also loads who embeds words), one of `ANSWERS`, of views or a catalogue."""
    opened: Scene | None = None
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
            return answered(opened, act, asked, place.limits)
        if asked["for"] in ANSWERS and ANSWERS[asked["for"]].words:
            with suppress(DrSplatError):  # told when words are asked for
                opened.encoder  # noqa: B018
        return Reply(b"")
    except DrSplatError as error:
        tiles = None if opened is None else opened.tiles
        if tiles and isinstance(error, FormatError) and str(error).startswith(str(tiles.path.parent)):
            error = SceneFaultError(f"scene {scene!r} cannot be read: {error}")  # a tile is read when it is needed
        return refusal(error, without_paths(str(error), scene_folder.roots))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
