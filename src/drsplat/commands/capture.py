"""drsplat capture: photos or a video -> posed photos."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .options import add_overwrite, finite, length

if TYPE_CHECKING:
    from ..capture.settings import CaptureSettings
    from ..progress import Meter

SUMMARY = "pose photos or a video (COLMAP): where each was taken, as a capture that train and embed take"
EXAMPLES = """\
  drsplat capture photos --output capture
  drsplat capture walk.mp4 --output capture
  drsplat capture photos --output capture --lens opencv --json
  drsplat capture photos --output capture --known-distance a.jpg 310 540 b.jpg 1200 610 0.9 --overwrite
  drsplat train capture --output-dir model --iterations 7000

The photos are only read. A stopped run goes on where it was when the same command is given again, also with more
photos. Where there is a capture and only --scale or --known-distance is new, --overwrite keeps its poses. Needs
COLMAP's package: pip install "drsplat[capture]"."""
LENSES = ("pinhole", "radial", "opencv", "fisheye")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "photos", help="folder of photos (JPEG, PNG, HEIC, WebP, TIFF, BMP; also in subfolders), or a video"
    )
    parser.add_argument(
        "--output", "-o", required=True, metavar="DIR",
        help="folder for the capture: images/, sparse/0 in COLMAP's format, capture.json",
    )  # fmt: skip
    add_overwrite(parser)
    parser.add_argument(
        "--invert-masks", action="store_true",
        help="keep what is black in masks/, and mask what is white out (default: the other way round)",
    )  # fmt: skip
    size = parser.add_argument_group("how long a metre is (default: by the photos' GPS, else lengths have no unit)")
    size.add_argument(
        "--known-distance", nargs=7, metavar=("PHOTO", "X", "Y", "PHOTO", "X", "Y", "METRES"),
        help="metres between two places, each by a pixel (x right, y down) of an upright photo in its full size",
    )  # fmt: skip
    size.add_argument(
        "--scale", type=length, metavar="FACTOR", help="metres of a unit that the capture has without this option"
    )
    parser.add_argument(
        "--lens", choices=LENSES, default="radial",
        help="lens, by what it does to straight lines: pinhole nothing, radial one term (phones, cameras), opencv two "
        "radial and two tangential terms (wide angles); photos of fisheye are written as a pinhole sees them "
        "(default: radial)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..capture.capturing import capture
    from ..system import peak_memory_bytes

    with Stages(arguments.json) as stages:
        record = capture(
            arguments.photos, arguments.output, capture_settings(arguments),
            overwrite=arguments.overwrite, threads=arguments.threads, progress=stages.update,
        )  # fmt: skip
    return {"capture": arguments.output, **record, "peak_memory_bytes": peak_memory_bytes()}


def capture_settings(arguments: argparse.Namespace) -> CaptureSettings:
    from ..capture.measuring import KnownDistance, Place
    from ..capture.settings import CaptureSettings
    from .parsing import UsageError

    known = None
    if arguments.known_distance is not None:
        one, x1, y1, other, x2, y2, metres = arguments.known_distance
        try:
            numbers = [finite(text) for text in (x1, y1, x2, y2, metres)]
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"--known-distance: {error}") from None
        known = KnownDistance(Place(one, *numbers[:2]), Place(other, *numbers[2:4]), numbers[4])
    return CaptureSettings(arguments.lens, arguments.scale, known, arguments.invert_masks)


class Stages:
    """A `Meter` for each stage that is told of, one after the other."""

    def __init__(self, quiet: bool) -> None:
        self._quiet, self._stage = quiet, ""
        self._meter: Meter | None = None

    def __enter__(self) -> Stages:
        return self

    def __exit__(self, *_: object) -> None:
        if self._meter is not None:
            self._meter.__exit__(None, None, None)

    def update(self, stage: str, done: int, total: int) -> None:
        """Show that so much of a stage is done; the first word of another stage ends the one before."""
        from ..progress import Meter

        if stage != self._stage or self._meter is None:
            self.__exit__()
            self._stage, self._meter = stage, Meter(stage, total, quiet=self._quiet)
        self._meter.update(done, "")


def interrupted(arguments: argparse.Namespace) -> str:
    """Return what a stopped run keeps, and how to go on."""
    return f"what is done is kept in {arguments.output}: give the same command again to go on"


def show(answer: dict[str, Any]) -> None:
    from .tables import said, show_facts, show_table, size_said

    registered, photos = answer["num_registered"], answer["num_photos"]
    residual = answer["gps_residual_m"]
    show_facts(
        f"capture: {answer['capture']}",
        {
            "posed": f"{said(registered)} of {said(photos)} photos",
            **({} if answer["video"] is None else {"frames": _frames_said(answer["video"])}),
            "points": f"{said(answer['num_points'])}, {answer['reprojection_error_px']:.2f} px on average",
            "lengths": "in metres, from " + answer["scale_from"] if answer["unit"] == "m" else "in units of no length",
            "up": f"+z, from {answer['up_from']}" if answer["up"] else "unknown",
            "GPS": "not used" if residual is None else f"{residual:.2f} m from the cameras (median)",
            "peak memory": size_said(answer["peak_memory_bytes"]),
        },
    )
    if answer["left_out"]:
        rows = [(one["name"], one["reason"]) for one in answer["left_out"]]
        show_table("Photos without a pose", ("photo", "why"), rows)


def _frames_said(counts: dict[str, int]) -> str:
    from .tables import said

    return (
        f"{said(counts['num_chosen'])} of {said(counts['num_frames'])} became photos, "
        f"{said(counts['num_blurred'])} were blurred, {said(counts['num_still'])} showed nothing new"
    )
