"""One function per route: an opened scene and a request -> what is sent back."""

import numpy as np

from ..asking import AskableScene, Question
from ..errors import InputError
from .limits import Limits
from .models import (
    ClassCount,
    Named,
    SceneDetails,
    Segmented,
    Selected,
    Things,
    Word,
    measured,
    things_of,
)
from .pictures import png
from .requests import Ids, Locate, Picture, Segment, WhatIs, asks_something, cut, place, question


def details(scene: AskableScene, name: str) -> SceneDetails:
    low, high = np.quantile(scene.gaussians.positions, (0.01, 0.99), axis=0)
    return SceneDetails(
        name=name,
        num_gaussians=len(scene.gaussians),
        num_registered=len(scene.field),
        encoder=scene.field.encoder.name,
        fault="",
        views=[view.name for view in scene.views],
        low=[float(x) for x in low],
        high=[float(x) for x in high],
        up=None if scene.field.up is None else scene.field.up.tolist(),
    )


def photo(scene: AskableScene, view: str, max_side: int) -> bytes:
    """Raises: InputError: no such view, or it has no photo."""
    chosen = scene.view(view)
    if chosen.image_path is None:
        raise InputError(f"view '{chosen.name}' has no photo here: ask for a picture")
    return png(scene.picture(chosen, photo=True, max_side=max_side))


def selected(scene: AskableScene, asked: Ids, limits: Limits) -> Selected:
    answer = scene.ask(question(asked, limits))
    values = answer.values
    return Selected(
        measured=measured(answer),
        score_range=[float(values.min(initial=1)), float(values.max(initial=-1))],
        gaussian_ids=answer.gaussian_ids.tolist() if asked.ids else None,
    )


def located(scene: AskableScene, asked: Locate, limits: Limits) -> Things:
    answer = scene.ask(question(asked, limits))
    found = scene.find(answer, asked.min_gaussians, box=asked.box)
    return Things(
        query=asked.text or "",
        num_found=len(found),
        things=things_of(found[: asked.limit]),
        advice="" if found else "nothing found: try other words, or a lower threshold",
        measured=measured(answer),
    )


def segmented(scene: AskableScene, asked: Segment) -> Segmented:
    found = scene.classes(asked.classes, Question(text=asked.classes[0], **cut(asked)))
    counts = np.bincount(found.labels[found.labels >= 0], minlength=len(found.names))
    registered = max(len(scene.field), 1)
    return Segmented(
        measure=found.answers[0].measure,
        num_registered=len(scene.field),
        num_labelled=int(counts.sum()),
        classes=[
            ClassCount(
                name=name,
                num_gaussians=int(count),
                share=count / registered,
                threshold=answer.threshold,
            )
            for name, count, answer in zip(found.names, counts, found.answers, strict=True)
        ],
        labels=found.labels.tolist() if asked.labels else None,
    )


def named(scene: AskableScene, asked: WhatIs) -> Named:
    words = scene.what_is(place(asked), asked.names)
    return Named(names=[Word(name=word.text, score=word.score) for word in words])


def picture(scene: AskableScene, asked: Picture, limits: Limits) -> bytes:
    shown = None
    if asks_something(asked):
        found = scene.find(question(asked, limits))
        shown = np.concatenate([one.thing.gaussian_ids for one in found] or [np.empty(0, np.int64)])
    nothing = shown is not None and not len(shown)
    view = asked.view or (scene.best_view() if nothing else None)
    return png(scene.picture(view, shown, photo=asked.photo, max_side=asked.max_side))
