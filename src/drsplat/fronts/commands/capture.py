"""drsplat capture: photos or a video -> posed photos."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.progress import Meter
from ...base.system import peak_memory_bytes
from .declaring import Facts, argument, declaration, finite, length, option
from .options import Verb, invert_masks, keep_people, overwrite, people_text
from .tables import show_facts, show_table, size_text, text_of

if TYPE_CHECKING:
    from ...photos.capture.measuring import KnownDistance
    from ...photos.capture.settings import CaptureSettings

EXAMPLES = """\
  drsplat capture photos --output capture
  drsplat capture walk.mp4 --output capture
  drsplat capture photos --output capture --lens opencv --json
  drsplat capture photos --output capture --known-distance a.jpg 310 540 b.jpg 1200 610 0.9 --overwrite
  drsplat capture photos --output capture --places places.csv --known-distance corner door 2.4 --overwrite
  drsplat train capture --output-dir model

The photos are never changed. To resume a stopped run, give the same command again, also with more photos. If the
capture exists and only --scale or --known-distance is new, --overwrite keeps its poses. Needs COLMAP's package:
`drsplat doctor` says how to install it."""
SIZE = "metric scale (default: from the photos' GPS, else lengths have no unit)"
LENSES = ("pinhole", "radial", "opencv", "fisheye")


@declaration
class Options(Verb):
    """Options of this verb."""

    photos: str = argument("folder of photos (JPEG, PNG, HEIC, WebP, TIFF, BMP; also in subfolders), or a video")
    output: str = option(
        "folder for the capture: images/, sparse/0 in COLMAP's format, capture.json", "DIR", flags="-o", required=True
    )
    overwrite: bool = overwrite()
    invert_masks: bool = invert_masks()
    keep_people: bool = keep_people(what="people")
    known_distance: list[str] | None = option(
        "distance between two places in metres: PHOTO X Y PHOTO X Y METRES, in pixels (x right, y down) of the upright "
        "photo at full size, or with --places NAME NAME METRES", "PLACE", nargs="+", title=SIZE,
    )  # fmt: skip
    places: str | None = option(
        "table of named places for --known-distance: the header name,photo,x,y, then a pixel per line; a place with "
        "pixels in two or more photos is triangulated", "FILE.csv", title=SIZE,
    )  # fmt: skip
    scale: float | None = option(
        "length in metres of the unit that the capture has without this option", "FACTOR", length, title=SIZE
    )
    lens: str = option(
        "model of the lens distortion: pinhole none, radial one term (phones, cameras), opencv two radial and two "
        "tangential terms (wide angles); fisheye photos are undistorted to a pinhole (default: radial)",
        default="radial", choices=LENSES,
    )  # fmt: skip

    @property
    def settings(self) -> CaptureSettings:
        from ...photos.capture.settings import CaptureSettings

        known = _known_distance(self.known_distance, self.places)
        return CaptureSettings(self.lens, self.scale, known, self.invert_masks, self.keep_people)


def run(options: Options) -> Facts:
    from ...photos.capture.capturing import capture

    with _stages(options.json) as progress:
        record = capture(
            options.photos, options.output, options.settings,
            overwrite=options.overwrite, threads=options.threads, progress=progress,
        )  # fmt: skip
    return {"capture": options.output, **record, "peak_memory_bytes": peak_memory_bytes()}


def _known_distance(given: list[str] | None, places: str | None) -> KnownDistance | None:
    from ...photos.capture.measuring import KnownDistance, Place, marker_named, read_places
    from .parsing import UsageError

    if given is None:
        if places is not None:
            raise UsageError("--places names places for --known-distance NAME NAME METRES: give that, too")
        return None
    expected = 7 if places is None else 3
    if len(given) != expected:
        form = "PHOTO X Y PHOTO X Y METRES" if expected == 7 else "NAME NAME METRES, for --places is given"
        more = ", or --places FILE.csv with NAME NAME METRES" if len(given) == 3 else ""
        raise UsageError(f"--known-distance: expected {form}{more}; got {len(given)} values")
    try:
        if places is not None:
            markers, metres = read_places(Path(places)), finite(given[2])
            return KnownDistance(marker_named(given[0], markers), marker_named(given[1], markers), metres)
        x1, y1, x2, y2, metres = (finite(given[index]) for index in (1, 2, 4, 5, 6))
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"--known-distance: {error}") from None
    return KnownDistance(Place(given[0], x1, y1), Place(given[3], x2, y2), metres)


@contextmanager
def _stages(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function that shows how much of a stage is done, with a `Meter` for one stage after the other."""
    with ExitStack() as shown:
        meters: dict[str, Meter] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in meters:  # the one before has ended
                shown.close()
                meters.clear()
                meters[stage] = shown.enter_context(Meter(stage, total, quiet=quiet))
            meters[stage].update(done, "")

        yield update


def interrupted(options: Options) -> str:
    """Return what a stopped run keeps, and how to go on."""
    return f"what is done is kept in {options.output}: give the same command again to go on"


def show(answer: Facts) -> None:
    registered, frames, residual = answer["num_registered"], answer["video"], answer["gps_residual_m"]
    chosen = {} if frames is None else {
        "frames": f"{text_of(frames['num_chosen'])} of {text_of(frames['num_frames'])} became photos, "
        f"{text_of(frames['num_blurred'])} were blurred, {text_of(frames['num_still'])} showed nothing new"
    }  # fmt: skip
    show_facts(
        f"capture: {answer['capture']}",
        {
            "posed": f"{text_of(registered)} of {text_of(answer['num_photos'])} photos",
            **chosen,
            "points": f"{text_of(answer['num_points'])}, {answer['reprojection_error_px']:.2f} px on average",
            "lengths": "in metres, from " + answer["scale_from"] if answer["unit"] == "m" else "in an unknown unit",
            "up": f"+z, from {answer['up_from']}" if answer["up"] else "unknown",
            "GPS": "not used" if residual is None else f"{residual:.2f} m from the cameras (median)",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )
    if answer["num_with_people"]:
        print(people_text(answer["num_with_people"], registered))
    if answer["left_out"]:
        rows = [(photo["name"], photo["reason"]) for photo in answer["left_out"]]
        show_table("Photos without a pose", ("photo", "why"), rows)
