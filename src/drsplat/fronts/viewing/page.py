"""One file with a scene and its answers, for someone who has only a browser.

The file holds the client of the viewer (built from web/), the scene as SPZ, which others can take out of it, and the
answers to some queries, as the documents that a running viewer would send (web/src/protocol.ts).
"""

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...authoring.filming.looking import FOV_DEGREES
from ...authoring.filming.paths import CameraPath
from ...base.arrays import (
    Array,
    Arrays,
    ArraysByName,
    ByteRows,
    ByteValues,
    Doubles,
    Float16,
    Numbers,
    OtherDoubles,
    OtherFlags,
    RowIds,
    Shaped,
    SmallIds,
    UInt8,
    UInt16,
    Vector3,
    Vectors,
)
from ...base.contents import AnyPath, Document
from ...drawing.heat import HEAT
from ...errors import InputError
from ...formats.replacing import replacing
from ...formats.spz_writing import spz_bytes
from ...query import Match
from ...query.tracks import tracks
from ...scene.gaussians import Gaussians, significance
from ...scene.moving import Moving
from . import painting
from .client import page_html, printable
from .page_search import PageSearch
from .session import Session
from .shown import Frame, Shown, match_document, rounded

MAX_TIMES, MIN_TIMES = 120, 8
MAX_MOVED_PLACES = 1_000_000
"""Gaussians that move, times times: 19 bytes each before they are packed."""
MAX_STILL_DISTANCE = 2e-3  # of the browser's units: what moves less stands still
MAX_STILL_SPREAD_SHARE = 0.02  # what turns or grows by less of its spread does not
MIN_SEEN_OPACITY = 1 / 255
STEPS_PER_AXIS = 65_535  # that 16 bits count
TIMES_PER_SECOND, MIN_PLAYING_S, MAX_PLAYING_S = 15, 2.0, 10.0
Times = Doubles


@dataclass(frozen=True, eq=False)
class PageTimes:
    """Places of k of m shown Gaussians at t times; the others stand still.

    order: of the shown rows, with those that move first. places: low + step * number, in the browser's frame.
    seconds: that it plays. num_known: times of the scene.
    """

    times: Times
    order: RowIds
    places: UInt16[Array, "n k 3"]
    low: Vector3
    step: Vector3
    covariances: Float16[Array, "n k 6"]
    opacities: ByteRows
    seconds: float
    num_known: int

    @property
    def summary(self) -> str:
        """For people."""
        of = f" of {self.num_known:,}" if len(self.times) < self.num_known else ""
        return f"{self.places.shape[1]:,} of them move, at {len(self.times):,}{of} times."


def times_of_page(session: Session) -> PageTimes | None:
    """Return None where nothing moves. The session is left at its first time.

    Raises: InputError: so much moves that a page has no room for it at `MIN_TIMES` times.
    """
    if session.scene.motion is None:
        return None
    known = session.scene.motion.times
    times = _evenly(known, MAX_TIMES)
    session.time = float(times[0])
    moves = _moving(session, times)
    count = int(moves.sum())
    if not count:
        return None
    if MAX_MOVED_PLACES // count < min(MIN_TIMES, len(times)):
        most = MAX_MOVED_PLACES // min(MIN_TIMES, len(times))
        raise InputError(
            f"{count:,} of the {len(moves):,} Gaussians shown move, and a page has room for {most:,} at {MIN_TIMES} "
            f"times: show fewer, e.g. max_gaussians={most // 1000 * 1000 or most}"
        )
    times = _evenly(times, MAX_MOVED_PLACES // count)
    order = np.argsort(~moves, kind="stable")
    return _collected(session, times, order, count, len(known))


def _collected(session: Session, times: Times, order: RowIds, count: int, num_known: int) -> PageTimes:
    centers = np.empty((len(times), count, 3), np.float32)
    covariances = np.empty((len(times), count, 6), np.float16)
    opacities = np.empty((len(times), count), np.uint8)
    for number, drawn in enumerate(_drawn(session, times)):
        rows = order[:count]
        centers[number], covariances[number] = drawn.centers[rows], drawn.covariances[rows]
        opacities[number] = np.round(drawn.opacities[rows] * 255)
    seen = centers[opacities > 0]
    low, high = seen.min(0).astype(np.float64), seen.max(0).astype(np.float64)
    step = np.maximum((high - low) / STEPS_PER_AXIS, 1e-12)
    places = np.clip(np.round((centers - low) / step), 0, STEPS_PER_AXIS).astype(np.uint16)
    return PageTimes(times, order, places, low, step, covariances, opacities, playing_seconds(num_known), num_known)


def playing_seconds(num_times: int) -> float:
    """Return how long a scene that moves is played."""
    return float(np.clip(num_times / TIMES_PER_SECOND, MIN_PLAYING_S, MAX_PLAYING_S))


def _moving(session: Session, times: Times) -> OtherFlags:
    """Return which of the shown rows are not at all times where they are at the first."""
    first = session.drawn
    spread = first.covariances[:, [0, 3, 5]].sum(1)
    moves = np.zeros(len(first), bool)
    for drawn in _drawn(session, times):
        away = np.abs(drawn.centers - first.centers).max(1) > MAX_STILL_DISTANCE
        away |= np.abs(drawn.covariances - first.covariances).max(1) > MAX_STILL_SPREAD_SHARE * spread
        moves |= away & (drawn.opacities >= MIN_SEEN_OPACITY) | (
            np.abs(drawn.opacities - first.opacities) >= MIN_SEEN_OPACITY
        )
    return moves


def _drawn(session: Session, times: Times) -> Iterator[Shown]:
    """Yield what is shown at each time, one after the other, and at last set the first time again."""
    for time in times.tolist():
        session.time = time
        yield session.drawn
    session.time = float(times[0])


def _evenly(times: Times, most: int) -> OtherDoubles:
    return times[np.linspace(0, len(times) - 1, min(len(times), most)).round().astype(int)]


def boxes_of(session: Session, times: PageTimes | None, matches: Sequence[Match]) -> list[list[list[float] | None]]:
    """Return the box of each match at each time: middle, axes and lengths, 15 numbers in the browser's frame.

    A box is None where the match is not there. Matches and scenes that stand still have no boxes, [].
    """
    if times is None or not matches:
        return [[] for _ in matches]
    scene, frame, now = session.scene, session.shown.frame, session.time
    moving = Moving(scene.moving.canonical, times.times, _Standing(session))
    found = tracks(moving, scene.field, matches, scene.up)
    session.time = now
    boxes = []
    for track in found:
        at = {
            time: np.round(np.concatenate([frame.shown(center), axes.ravel(), extent * frame.scale]), 4).tolist()
            for time, center, axes, extent in zip(
                track.times.tolist(), track.centers, track.axes, track.extents, strict=True
            )
        }
        every = [at.get(time) for time in times.times.tolist()]
        boxes.append([] if all(box == every[0] for box in every) else every)
    return boxes


@dataclass(frozen=True, eq=False)
class _Standing:
    """The scene's own rows as edits leave them, at any time."""

    session: Session

    def at(self, time: float) -> Gaussians:
        self.session.time = time
        return self.session.edits.standing


def arrays_of(times: PageTimes) -> Arrays:
    """Return the arrays that a page unpacks: each time but the first as its difference, as much stays the same."""
    turns = times.covariances.view(np.uint16)
    return {"places": _steps(times.places), "turns": _steps(turns), "fades": _steps(times.opacities)}


def _steps(numbers: Array) -> Array:
    """Return differences along time, which begin again where they end."""
    steps = numbers.copy()
    steps[1:] -= numbers[:-1]
    return steps.ravel()


def header_of(times: PageTimes) -> dict[str, Any]:
    return {
        "at": times.times.tolist(),
        "count": times.places.shape[1],
        "low": times.low.tolist(),
        "step": times.step.tolist(),
        "seconds": times.seconds,
    }


MAX_GAUSSIANS = 200_000
"""Gaussians in a page: some 5 MB of text, and what an old laptop can draw."""
FILM_STEPS_PER_SECOND, FILM_S, MAX_FILM_S = 12, 8.0, 60.0
TYPE_CODES = {"float32": "f4", "float16": "f2", "uint8": "u1", "uint16": "u2", "uint32": "u4"}


@dataclass(frozen=True, eq=False)
class PageAnswer:
    """One query with its answer.

    heat: per shown Gaussian in [0, 1]. owners: 0, or 1 for the first match. eyes: places in the world to see each match
    from. boxes: of each match over time, as `page_times.boxes_of` has them. doubt: why not to rely on it, "" for none.
    instead: words that have a match where this has none.
    """

    text: str
    heat: Numbers
    owners: ByteValues
    matches: Sequence[Match]
    eyes: Sequence[Vector3]
    boxes: Sequence[Sequence[Sequence[float] | None]] = ()
    doubt: str = ""
    instead: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """Content of a page.

    gaussians: the shown rows, as the scene's own file would have them. eye, target, up: of the first look, in the
    world. features: their colours, in [0, 1]. objects, annotations: as of `exporting`. object_numbers: per shown
    Gaussian 0, or 1 for the first object. path: that the page flies along. times: of a scene that moves. num_edits:
    kept edits in it. plays: whether it flies along the path when it is opened. search: what answers words that are
    not among `answers`, None where nobody embeds words.
    """

    title: str
    shown: Shown
    gaussians: Gaussians
    answers: Sequence[PageAnswer]
    eye: Vector3
    target: Vector3
    up: Vector3
    features: Vectors | None = None
    objects: Sequence[Mapping[str, Any]] = ()
    annotations: Sequence[Mapping[str, Any]] = ()
    object_numbers: SmallIds | None = None
    path: CameraPath | None = None
    times: PageTimes | None = None
    num_edits: int = 0
    plays: bool = False
    search: PageSearch | None = None


def write_page(path: AnyPath, page: Page, *, overwrite: bool = False) -> None:
    """Write the page. Raises: InputError: more Gaussians than `MAX_GAUSSIANS`; the file exists and not `overwrite`."""
    if len(page.shown) > MAX_GAUSSIANS:
        raise InputError(f"a page holds up to {MAX_GAUSSIANS:,} Gaussians, got {len(page.shown):,}: show fewer of them")
    order = _order(page)
    layout, blob = packed(_arrays(page, order))
    header = json.dumps(_header(page) | {"arrays": layout}, default=sorted)  # of sets
    scene = base64.b64encode(spz_bytes(page.gaussians.subset(order), degree=0)).decode()
    text = page_html(page.title, header, scene, base64.b64encode(zlib.compress(blob, 6)).decode())
    with replacing(path, overwrite) as file:
        file.write(text.encode())


def packed(arrays: ArraysByName) -> tuple[list[tuple[str, str, int, int]], bytes]:
    """Return arrays one after the other, little endian: name, kind, offset in bytes and count of each."""
    layout, parts, offset = [], [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        layout.append((name, TYPE_CODES[array.dtype.name], offset, array.size))
        parts.append(data + bytes(-len(data) % 4))
        offset += len(parts[-1])
    return layout, b"".join(parts)


def _order(page: Page) -> RowIds:
    """Return the order of rows in the file: those that move, then by falling significance.

    A browser that is slow draws the first rows only while the camera moves.
    """
    weight = significance(page.gaussians)
    if page.times is None:
        return np.argsort(-weight, kind="stable")
    count = page.times.places.shape[1]
    still = page.times.order[count:]
    return np.concatenate([page.times.order[:count], still[np.argsort(-weight[still], kind="stable")]])


def _arrays(page: Page, order: RowIds) -> Arrays:
    arrays: Arrays = {}
    if page.features is not None:
        arrays["features"] = as_bytes(page.features)
    if page.object_numbers is not None:
        arrays["objects"] = page.object_numbers
    for number, answer in enumerate(page.answers):
        arrays[f"heat{number}"], arrays[f"owner{number}"] = as_bytes(answer.heat), answer.owners
    further: Arrays = {} if page.times is None else arrays_of(page.times)
    if page.search is not None:
        arrays, further = {**arrays, **page.search.rows}, {**further, **page.search.tables}
    return {name: array[order] for name, array in arrays.items()} | further


def _header(page: Page) -> Document:
    frame = page.shown.frame
    answers = ["answer", "heat map"] if _answers(page) else []
    features = [] if page.features is None or not _answers(page) else ["features"]
    # what the client offers: a page only answers what it was made with
    never = ("ask_picture", "name", "edit", "time", "photos", "save_dir", "catalogue", "open")
    offered = {"ask": _answers(page), "objects": bool(page.objects), "film_formats": []}
    moves = "" if page.times is None else page.times.summary
    return {
        "title": printable(page.title),
        "about": " ".join(f"{len(page.shown):,} Gaussians. {moves} {page.shown.summary}".split()),
        "eye": rounded(frame.shown(page.eye)),
        "target": rounded(frame.shown(page.target)),
        "up": page.up.tolist(),
        "fov": FOV_DEGREES,
        "frame": {"center": (frame.center - page.gaussians.origin).tolist(), "scale": frame.scale},
        "heat": HEAT.tolist(),
        "look": painting.LOOK,
        "antialiased": page.shown.antialiased,
        "words": [printable(answer.text) for answer in page.answers],
        "modes": [*answers, "as it is", *features, *(["objects"] if page.objects else [])],
        "can": (dict.fromkeys(never, False) | offered),
        "objects": list(page.objects),
        "photos": [],
        "times": None,
        "clock": None if page.times is None else header_of(page.times),
        "film": None if page.path is None else film_document(frame, page.path, page.target),
        "plays": page.plays,
        "annotations": list(page.annotations),
        "answers": [_answer(frame, number, answer) for number, answer in enumerate(page.answers)],
        "search": None if page.search is None else page.search.document,
        "knows": "" if page.search is None else page.search.about,
    }


def _answers(page: Page) -> bool:
    return bool(page.answers) or page.search is not None


def film_document(frame: Frame, path: CameraPath, target: Vector3) -> Document:
    """Return places along a path, near enough to each other for straight lines, in the browser's frame.

    Each looks at something as far off as `target`, in the world.
    """
    seconds = min(path.seconds or FILM_S, MAX_FILM_S)
    shares = np.linspace(0, 1, max(2, round(seconds * FILM_STEPS_PER_SECOND)))
    keys = path.at(shares)
    ahead = [max(float(key.rotation[2] @ (target - key.eye)), 1 / frame.scale) for key in keys]
    targets = [key.eye + far * key.rotation[2] for key, far in zip(keys, ahead, strict=True)]
    return {
        "seconds": seconds,
        "eyes": [np.round(frame.shown(key.eye), 4).tolist() for key in keys],
        "targets": [np.round(frame.shown(one), 4).tolist() for one in targets],
        "fovs": [round(key.fov_degrees, 2) for key in keys],
    }


def _answer(frame: Frame, number: int, answer: PageAnswer) -> Document:
    boxes = answer.boxes or [[] for _ in answer.matches]
    matches = [
        match_document(frame, match, eye) | {"boxes": box}
        for match, eye, box in zip(answer.matches, answer.eyes, boxes, strict=True)
    ]
    text = printable(answer.text)
    return {
        "text": text, "summary": "", "doubt": answer.doubt, "accent": painting.accent(number), "matches": matches,
        "num_matches": len(matches), "threshold": 0, "automatic": 0, "limits": [0, 1], "measure": "",
        "threshold_rule": "", "exact": True, "instead": list(answer.instead),
    }  # fmt: skip


def as_bytes(values: Shaped[Array, "*any"]) -> UInt8[Array, "*any"]:
    """Return numbers in [0, 1] as bytes."""
    return np.asarray(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)
