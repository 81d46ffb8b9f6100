"""One function per route, and one for all tools: an opened scene and a request -> what is sent back."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from ...errors import InputError
from ...formats.scenes import write_gaussians
from ...query import Match, Query, Scene
from ...query.documents import answer_document, rounded
from ...query.objects import match_of, objects_of
from ...query.sheets import object_picture
from . import models
from .conversation import tool_answer
from .files import exported
from .limits import Limits
from .models import (
    ClassCount,
    Located,
    ObjectList,
    SceneDetails,
    Segmented,
    Selected,
    Word,
    Words,
    decimals_of,
    listed_objects,
    matches_of,
    measured,
    object_list,
    significant,
    span_of,
    tracked,
    when_told,
)
from .pictures import jpeg, png
from .query_fields import Request, asks_something, cut_of, query_of, values_of
from .replies import JPEG, PLY, PNG, Reply
from .requests import (
    Details,
    Export,
    Locate,
    Objects,
    OneObject,
    Photo,
    Picture,
    Segment,
    Select,
    Tool,
    WhatIs,
    When,
    place,
)

OBJECT_SIZE = (640, 480)


class Answering(NamedTuple):
    """How a request is read and answered. words: whether its answers need who embeds words. media_type: of bytes."""

    asked: type[Request]
    answer: Callable[[Scene, Any, Limits], BaseModel | bytes | Reply]
    words: bool = True
    media_type: str = PNG


def details(scene: Scene, asked: Details, _: Limits) -> SceneDetails:
    low, high = scene.box
    digits = decimals_of(scene)
    return SceneDetails(
        name=asked.name,
        num_gaussians=len(scene.gaussians),
        num_registered=len(scene.field),
        encoder=scene.field.encoder.name,
        fault="",
        views=[view.name for view in scene.views],
        low=rounded(low, digits),
        high=rounded(high, digits),
        up=None if scene.up is None else rounded(scene.up, 4),
        times=span_of(scene),
        scene=scene.gaussians.fingerprint,
        field=scene.field.fingerprint,
    )


def photo(scene: Scene, asked: Photo, _: Limits) -> bytes:
    """Return a photo as PNG. Raises: InputError: no such view, or it has no photo."""
    chosen = scene.view(asked.view)
    if chosen.image_path is None:
        raise InputError(f"view '{chosen.name}' has no photo here: request a picture")
    return png(scene.picture(chosen, photo=True, max_side=asked.max_side))


def objects(scene: Scene, asked: Objects, _: Limits) -> ObjectList:
    shown, unsure = listed_objects(scene, asked.all)
    if not scene.objects:
        return object_list(scene, [], "photos agree on nothing: more of them, or larger masks, may help")
    more = f"{unsure} more that photos agree less on: all=true lists them" if unsure else ""
    return object_list(scene, shown, ". ".join(filter(None, (more, scene.doubt))))


def object_photo(scene: Scene, asked: OneObject, _: Limits) -> bytes:
    return jpeg(object_picture(scene, _numbered(scene, asked), size=OBJECT_SIZE))


def object_ply(scene: Scene, asked: OneObject, _: Limits) -> bytes:
    part = scene.gaussians.subset(_numbered(scene, asked).gaussian_ids)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.ply"
        write_gaussians(path, part)
        return path.read_bytes()


def _numbered(scene: Scene, asked: OneObject) -> Match:
    return match_of(scene.field, objects_of(scene.field).thing(asked.number))


def selected(scene: Scene, asked: Select, limits: Limits) -> Selected:
    answer = scene.ask(query_of(asked, limits))
    return Selected(
        measured=measured(answer),
        score_range=[significant(score) for score in answer_document(answer)["score_range"]],
        gaussian_ids=answer.gaussian_ids.tolist() if asked.ids else None,
        field=scene.field.fingerprint,
    )


def located(scene: Scene, asked: Locate, limits: Limits) -> Located:
    query = query_of(asked, limits)
    answer = scene.ask(query)
    found = scene.locate(answer, min_gaussians=asked.min_gaussians, box=asked.box)
    listed = found[: asked.top]
    return Located(
        query=query.text or "",
        num_matches=len(found),
        matches=tracked(scene, listed, asked.box) if asked.tracks else matches_of(listed, decimals_of(scene)),
        advice="" if found else "no match: try other words, or a lower threshold",
        measured=measured(answer),
        field=scene.field.fingerprint,
    )


def when(scene: Scene, asked: When, _: Limits) -> models.When:
    one, other = (Query(text, **values_of(vars(asked))) for text in (asked.one, asked.other))
    return when_told(scene, one, asked.relation, other, asked.view)


def segmented(scene: Scene, asked: Segment, _: Limits) -> Segmented:
    found = scene.segment(asked.classes, cut_of(asked))
    registered = max(len(scene.field), 1)
    return Segmented(
        measure=found.answers[0].measure,
        num_registered=len(scene.field),
        num_labelled=sum(found.counts),
        classes=[
            ClassCount(
                name=name,
                num_gaussians=count,
                share=significant(count / registered),
                threshold=significant(answer.threshold),
            )
            for name, count, answer in zip(found.names, found.counts, found.answers, strict=True)
        ],
        labels=found.labels.tolist() if asked.labels else None,
        field=scene.field.fingerprint,
        doubt=found.doubt,
    )


def named(scene: Scene, asked: WhatIs, _: Limits) -> Words:
    words = scene.what_is(place(asked), asked.names)
    best = [Word(name=word.text, score=round(word.score, 4)) for word in words]
    return Words(words=best, field=scene.field.fingerprint)


def picture(scene: Scene, asked: Picture, limits: Limits) -> bytes:
    shown = None
    if asks_something(asked):
        found = scene.locate(query_of(asked, limits))
        shown = np.concatenate([match.gaussian_ids for match in found] or [np.empty(0, np.int64)])
    nothing = shown is not None and not len(shown)
    view = asked.view or (scene.best_view() if nothing else None)
    return png(scene.picture(view, shown, photo=asked.photo, max_side=asked.max_side))


ANSWERS: Mapping[str, Answering] = {
    "details": Answering(Details, details, words=False),
    "photo": Answering(Photo, photo, words=False),
    "objects": Answering(Objects, objects),
    "object-picture": Answering(OneObject, object_photo, words=False, media_type=JPEG),
    "object-ply": Answering(OneObject, object_ply, words=False, media_type=PLY),
    "select": Answering(Select, selected),
    "locate": Answering(Locate, located),
    "when": Answering(When, when),
    "segment": Answering(Segment, segmented),
    "what-is": Answering(WhatIs, named),
    "picture": Answering(Picture, picture),
    "export": Answering(Export, exported),
    "tool": Answering(Tool, tool_answer),
}


def answered(scene: Scene, what: str, asked: Mapping[str, Any], limits: Limits) -> Reply:
    """Return the reply to one of `ANSWERS`. Raises: DrSplatError: the question does not fit the scene."""
    way = ANSWERS[what]
    answer = way.answer(scene, way.asked(**asked), limits)
    field = scene.field.fingerprint
    if isinstance(answer, Reply):
        return answer._replace(field=field)
    if isinstance(answer, bytes):
        return Reply(answer, way.media_type, field=field)
    return Reply(answer.model_dump_json().encode(), field=field)
