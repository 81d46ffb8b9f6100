"""How near `drsplat capture` comes to given poses, from the photos alone.

    python benchmarks/study_poses.py CAPTURE... [--every N] [--video] [--threads N]

CAPTURE: photos in images/, and poses that another program found. Its photos, or every N-th, are posed anew in a
temporary folder; --video: taken out of a film of them, in the order of their names, each twice, as H.264 at 10 frames a
second. Both are laid on each other by the similarity that fits the camera centres best. "centres": distances, in
percent of the cameras' mean distance from their middle; "rotations" in degrees; "up": between both worlds' upward axes,
where the given one's is +z; "scale": of lengths, where both worlds are in metres.
"""

import argparse
import re
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from drsplat.formats.captures import read_views
from drsplat.formats.georeference import read_georeference
from drsplat.photos.capture.capturing import capture
from drsplat.photos.capture.world import umeyama
from drsplat.scene.views import View

FRAMES_A_SECOND, EACH = 10, 2


def row(folder: Path, every: int, is_video: bool, threads: int) -> str:
    names = sorted(path.name for path in (folder / "images").iterdir())[::every]
    given = {view.name: view for view in read_views(folder)}
    with TemporaryDirectory() as work:
        source, output = Path(work) / "photos", Path(work) / "capture"
        shown = _film(folder, names, source.with_suffix(".mp4")) if is_video else _photos(folder, names, source)
        start = time.perf_counter()
        record = capture(shown, output, threads=threads)
        seconds = time.perf_counter() - start
        posed = read_views(output)
        true = [given[names[_frame(view.name) // EACH] if is_video else view.name] for view in posed]
        metric = record["unit"] == "m" and read_georeference(folder) is not None
    kind = ", a film" if is_video else f", every {every}th" if every > 1 else ""
    return f"| {folder.name}{kind} | {said(posed, true, record, metric)} | {seconds:.0f} s |"


def said(posed: list[View], true: list[View], record: dict[str, Any], metric: bool) -> str:
    here, there = (np.array([view.center for view in views]) for views in (posed, true))
    similarity = umeyama(here, there)
    spread = np.linalg.norm(there - there.mean(axis=0), axis=1).mean()
    away = 100 * np.linalg.norm(similarity.positions(here) - there, axis=1) / spread
    turned = [
        _degrees(b.cam_from_world[:3, :3] @ similarity.rotation @ a.cam_from_world[:3, :3].T)
        for a, b in zip(posed, true, strict=True)
    ]
    up = np.degrees(np.arccos(np.clip(similarity.rotation[2, 2], -1, 1)))
    tilt, scale = (f"{up:.2f}", f"{similarity.scale:.5f}") if metric else ("-", "-")
    residual = record["gps_residual_m"]
    gps = "-" if residual is None else f"{residual:.2f} m"
    return (
        f"{record['num_registered']} of {record['num_photos']}, {record['mapper']} | {np.median(away):.2f}, "
        f"{away.max():.2f} | {np.median(turned):.2f}, {max(turned):.2f} | {tilt} | {scale} | {gps}"
    )


def _photos(folder: Path, names: list[str], target: Path) -> Path:
    target.mkdir()
    for name in names:
        (target / name).symlink_to(folder.resolve() / "images" / name)
    return target


def _film(folder: Path, names: list[str], target: Path) -> Path:
    """Write photos, all of one size, as a film."""
    import av

    with av.open(str(target), "w") as film:
        stream = film.add_stream("libx264", rate=FRAMES_A_SECOND)
        stream.width, stream.height = Image.open(folder / "images" / names[0]).size
        stream.pix_fmt = "yuv420p"
        for name in names:
            picture = av.VideoFrame.from_image(Image.open(folder / "images" / name).convert("RGB"))  # type: ignore[no-untyped-call]
            for _ in range(EACH):
                film.mux(stream.encode(picture))
        film.mux(stream.encode())
    return target


def _frame(name: str) -> int:
    """Return the number of a frame by the name of its photo."""
    return int(re.findall(r"\d+", name)[-1])


def _degrees(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--video", action="store_true")
    parser.add_argument("--threads", type=int, default=0)
    arguments = parser.parse_args()
    print(
        "| photos | posed | centres: median, worst | rotations: median, worst | up | scale | from the GPS | time |\n"
        + "|---" * 8
        + "|"
    )
    for folder in arguments.captures:
        print(row(folder, arguments.every, arguments.video, arguments.threads), flush=True)


if __name__ == "__main__":
    main()
