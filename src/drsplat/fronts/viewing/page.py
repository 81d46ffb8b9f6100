"""One file with a scene and its answers, for someone who has only a browser.

The file holds the client of the viewer (built from web/), the scene as SPZ, which others can take out of it, and the
answers to some queries, as the documents that a running viewer would send (web/src/protocol.ts).
"""

import base64
import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.arrays import (
    Array,
    ArraysByName,
    ByteRows,
    Doubles,
    Float16,
    OtherDoubles,
    OtherFlags,
    RowIds,
    UInt16,
    Vector3,
)
from ...base.contents import AnyPath, Document
from ...errors import InputError
from ...formats.replacing import replacing
from ...formats.spz_writing import spz_bytes
from ...query import Match
from ...query.tracks import tracks
from ...scene.gaussians import Gaussians, significance
from ...scene.moving import Moving
from .client import page_html
from .page_search import PageSearch
from .session import Session
from .shown import Shown

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
    num_known: times of the scene.
    """

    times: Times
    order: RowIds
    places: UInt16[Array, "n k 3"]
    low: Vector3
    step: Vector3
    covariances: Float16[Array, "n k 6"]
    opacities: ByteRows
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
    rows, kept = order[:count], []
    for drawn in _drawn(session, times):
        shapes = drawn.covariances[rows].astype(np.float16)
        kept.append((drawn.centers[rows], shapes, np.round(drawn.opacities[rows] * 255).astype(np.uint8)))
    centers, covariances, opacities = (np.stack(column) for column in zip(*kept, strict=True))
    seen = centers[opacities > 0]
    low, high = seen.min(0).astype(np.float64), seen.max(0).astype(np.float64)
    step = np.maximum((high - low) / STEPS_PER_AXIS, 1e-12)
    places = np.clip(np.round((centers - low) / step), 0, STEPS_PER_AXIS).astype(np.uint16)
    return PageTimes(times, order, places, low, step, covariances, opacities, len(known))


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


def clock_document(times: PageTimes) -> Document:
    return {
        "at": times.times.tolist(),
        "count": times.places.shape[1],
        "low": times.low.tolist(),
        "step": times.step.tolist(),
        "seconds": playing_seconds(times.num_known),
    }


MAX_GAUSSIANS = 200_000
"""Gaussians in a page: some 5 MB of text, and what an old laptop can draw."""
TYPE_CODES = {"float32": "f4", "float16": "f2", "uint8": "u1", "uint16": "u2", "uint32": "u4"}


class PageAnswer(NamedTuple):
    """One query with its matches, as boxes where they are at first. document: what the client shows of it."""

    text: str
    matches: Sequence[Match]
    document: Document


@dataclass(frozen=True, eq=False)
class Page:
    """Content of a page.

    header: what the client is told, but of times and search. rows: arrays with a number per shown Gaussian. gaussians:
    the shown rows, as the scene's own file would have them. times: of a scene that moves. search: what answers words
    that are not among `answers`, None where nobody embeds words. num_edits: kept edits in it.
    """

    header: Document
    rows: ArraysByName
    gaussians: Gaussians
    shown: Shown
    answers: Sequence[PageAnswer]
    times: PageTimes | None = None
    search: PageSearch | None = None
    num_edits: int = 0


def write_page(path: AnyPath, page: Page, *, overwrite: bool = False) -> None:
    """Write the page. Raises: InputError: the file exists and not `overwrite`."""
    times, search, frame = page.times, page.search, page.shown.frame
    # first the rows that move, then by falling significance: slow browsers draw the first ones while the camera moves
    count = 0 if times is None else times.places.shape[1]
    every = np.arange(len(page.shown)) if times is None else times.order
    still = every[count:]
    order = np.concatenate([every[:count], still[np.argsort(-significance(page.gaussians)[still], kind="stable")]])
    rows = {**page.rows, **({} if search is None else search.rows)}
    arrays = {name: array[order] for name, array in rows.items()}
    if times is not None:  # each time but the first as its difference, as much stays the same
        changes = {"places": times.places, "turns": times.covariances.view(np.uint16), "fades": times.opacities}
        arrays |= {name: np.diff(one, axis=0, prepend=one[:1] * 0).ravel() for name, one in changes.items()}
    layout, blob = packed(arrays if search is None else {**arrays, **search.tables})
    header = page.header | {
        "frame": {"center": (frame.center - page.gaussians.origin).tolist(), "scale": frame.scale},
        "clock": None if times is None else clock_document(times),
        "search": None if search is None else search.document,
        "knows": "" if search is None else search.about,
        "arrays": layout,
    }
    scene = base64.b64encode(spz_bytes(page.gaussians.subset(order), degree=0)).decode()
    blob_text = base64.b64encode(zlib.compress(blob, 6)).decode()
    text = page_html(page.header["title"], json.dumps(header, default=sorted), scene, blob_text)  # of sets
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
