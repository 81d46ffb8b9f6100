"""One file with a scene and its answers, for someone who has only a browser."""

import base64
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from os import PathLike
from typing import Any

import numpy as np

from ..arrays import Float32, Float64, UInt8, UInt16
from ..drawing.heat import HEAT
from ..errors import InputError
from ..filming.looking import FOV_DEGREES
from ..filming.paths import CameraPath
from ..formats.replacing import replacing
from ..query import Match
from . import painting
from .page_times import PageTimes, arrays_of, header_of
from .shown import Frame, Shown
from .texts import escaped, printable

MOST = 200_000
"""Gaussians in a page: some 5 MB of text, and what an old laptop can draw."""
MOST_WORDS = 65_535
FILM_STEPS, FILM_SECONDS, MOST_FILM_SECONDS = 12, 8.0, 60.0  # places a second
BACKGROUND = (0.078, 0.086, 0.106)
KINDS = {"float32": "f4", "float16": "f2", "uint8": "u1", "uint16": "u2"}


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """One query with its answer. heat: per shown Gaussian in [0, 1]; owners: 0, or 1 for the first match.

    eyes: places in the world to see each match from. boxes: of each over time, as `page_times.boxes_of` has them.
    """

    text: str
    heat: Float32[np.ndarray, " m"]
    owners: UInt8[np.ndarray, " m"]
    matches: Sequence[Match]
    eyes: Sequence[Float64[np.ndarray, " 3"]]
    boxes: Sequence[Sequence[Sequence[float] | None]] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """eye, target, up: of the first look, in the world. features: their colours, in [0, 1].

    best_words: per shown Gaussian 0, or 1 for the first of `words`. objects, annotations: as of `page_parts`.
    object_numbers: per shown Gaussian 0, or 1 for the first object. path: that the page flies along. times: of a scene
    that moves. num_edits: kept edits that are in it. plays: whether it flies along the path when it is opened.
    """

    title: str
    shown: Shown
    answers: Sequence[PageAnswer]
    eye: Float64[np.ndarray, " 3"]
    target: Float64[np.ndarray, " 3"]
    up: Float64[np.ndarray, " 3"]
    features: Float32[np.ndarray, "m 3"] | None = None
    words: Sequence[str] = ()
    best_words: UInt16[np.ndarray, " m"] | None = field(default=None)
    objects: Sequence[Mapping[str, Any]] = ()
    annotations: Sequence[Mapping[str, Any]] = ()
    object_numbers: UInt16[np.ndarray, " m"] | None = None
    path: CameraPath | None = None
    times: PageTimes | None = None
    num_edits: int = 0
    plays: bool = False


def write_page(path: str | PathLike[str], page: Page, *, overwrite: bool = False) -> None:
    """Write the page. Raises: InputError: more Gaussians than `MOST`; the file exists and not `overwrite`."""
    if len(page.shown) > MOST:
        raise InputError(f"a page holds up to {MOST:,} Gaussians, got {len(page.shown):,}: show fewer of them")
    arrays = _arrays(page)
    layout, blob = packed(arrays)
    parts = {
        "TITLE": escaped(page.title),
        "HEADER": _in_script(json.dumps(_header(page) | {"arrays": layout})),
        "BLOB": base64.b64encode(zlib.compress(blob, 6)).decode(),
        "SCRIPT": _own("page.js"),
        "FILM": _own("page_film.js"),
        "PARTS": _own("page_parts.js"),
        "TIMES": _own("page_times.js"),
    }
    text = filled(_own("page.html"), parts).encode()
    with replacing(path, overwrite) as file:
        file.write(text)


def filled(template: str, parts: Mapping[str, str]) -> str:
    """The template with each @NAME@ replaced; what is put in is not looked through again."""
    return re.sub(r"@([A-Z]+)@", lambda match: parts[match[1]], template)


def packed(arrays: Mapping[str, np.ndarray]) -> tuple[list[tuple[str, str, int, int]], bytes]:
    """Arrays one after the other, little endian: name, kind, offset in bytes and count of each."""
    layout, parts, offset = [], [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        layout.append((name, KINDS[array.dtype.name], offset, array.size))
        parts.append(data + bytes(-len(data) % 4))
        offset += len(parts[-1])
    return layout, b"".join(parts)


def _arrays(page: Page) -> dict[str, np.ndarray]:
    shown = page.shown
    arrays: dict[str, np.ndarray] = {
        "centers": shown.centers,
        "covariances": shown.covariances.astype(np.float16),
        "rgb": _bytes(shown.rgb),
        "opacity": _bytes(shown.opacities),
    }
    if page.features is not None:
        arrays["features"] = _bytes(page.features)
    if page.best_words is not None:
        arrays["words"] = page.best_words
    if page.object_numbers is not None:
        arrays["objects"] = page.object_numbers
    for number, answer in enumerate(page.answers):
        arrays[f"heat{number}"], arrays[f"owner{number}"] = _bytes(answer.heat), answer.owners
    if page.times is None:
        return arrays
    return {name: array[page.times.order] for name, array in arrays.items()} | arrays_of(page.times)


def _header(page: Page) -> dict[str, Any]:
    frame = page.shown.frame
    return {
        "about": _about(page),
        "eye": frame.shown(page.eye).tolist(),
        "target": frame.shown(page.target).tolist(),
        "up": page.up.tolist(),
        "fov": FOV_DEGREES,
        "background": BACKGROUND,
        "heat": HEAT.tolist(),
        "look": {"dim": painting.DIM, "floor": painting.DIM_FLOOR, "glow": painting.GLOW, "warmth": painting.WARMTH},
        "times": None if page.times is None else header_of(page.times),
        "film": None if page.path is None else _film(frame, page.path, page.target),
        "plays": page.plays,
        "antialiased": page.shown.antialiased,
        "words": list(page.words)[:MOST_WORDS],
        "objects": list(page.objects),
        "annotations": list(page.annotations),
        "accent": painting.accent(0),
        "answers": [_answer(frame, number, answer) for number, answer in enumerate(page.answers)],
    }


def _about(page: Page) -> str:
    moves = "" if page.times is None else page.times.said
    return " ".join(f"{len(page.shown):,} Gaussians. {moves} {page.shown.said}".split())


def _film(frame: Frame, path: CameraPath, target: Float64[np.ndarray, " 3"]) -> dict[str, Any]:
    """Places along it, near enough to each other for straight lines; each looks at something as far as `target`."""
    seconds = min(path.seconds or FILM_SECONDS, MOST_FILM_SECONDS)
    shares = np.linspace(0, 1, max(2, round(seconds * FILM_STEPS)))
    keys = path.at(shares)
    ahead = [max(float(key.rotation[2] @ (target - key.eye)), 1 / frame.scale) for key in keys]
    targets = [key.eye + far * key.rotation[2] for key, far in zip(keys, ahead, strict=True)]
    return {
        "seconds": seconds,
        "eyes": [np.round(frame.shown(key.eye), 4).tolist() for key in keys],
        "targets": [np.round(frame.shown(one), 4).tolist() for one in targets],
        "fovs": [round(key.fov_degrees, 2) for key in keys],
    }


def _answer(frame: Frame, number: int, answer: PageAnswer) -> dict[str, Any]:
    boxes = answer.boxes or [[] for _ in answer.matches]
    matches = [
        {
            "center": frame.shown(match.center).tolist(),
            "axes": match.axes.tolist(),
            "extent": (match.extent * frame.scale).tolist(),
            "eye": frame.shown(eye).tolist(),
            "said": said_of(match),
            "boxes": box,
        }
        for match, eye, box in zip(answer.matches, answer.eyes, boxes, strict=True)
    ]
    return {"text": printable(answer.text), "accent": painting.accent(number), "matches": matches}


def said_of(match: Match) -> str:
    """Score, size and place of a match, in scene units."""
    place = ", ".join(f"{x:.2f}" for x in match.center)
    size = " x ".join(f"{x:.2f}" for x in match.extent)
    return f"{match.score:.2f} · size {size} · at {place}"


def _bytes(values: np.ndarray) -> UInt8[np.ndarray, "..."]:
    return np.asarray(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def _in_script(text: str) -> str:
    """JSON that cannot end the script element that it is in."""
    return text.replace("<", "\\u003c")


def _own(name: str) -> str:
    return (files(__package__) / name).read_text(encoding="utf-8")
