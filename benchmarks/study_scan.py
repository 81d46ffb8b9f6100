"""What `drsplat scan` makes of photos and films without poses, against the same photos with given poses.

    python benchmarks/study_scan.py --work FOLDER [--plush CAPTURE] [--iterations N] [--side PIXELS] [--threads N]
    python benchmarks/study_scan.py --work FOLDER --kills 30
    python benchmarks/study_scan.py --work FOLDER --photos 10000 --iterations 3000

Three scans of each place: a capture with given poses; its photos alone; a film (MP4, H.264) of them. Places: a capture
of a plush doll, each photo twice in the film at 10 frames a second, in the order of their names; and the demo's room,
rendered along a path through its cameras: 240 frames, of which every sixth is blurred by the camera's way from the
frame before, and every fourth is a photo, sharp. "dB": PSNR in every eighth photo of the scan itself. "centres"
and "rotations": as of study_poses.py. "answers": queries whose best match lies within a tenth of the cameras' mean
distance from their middle of a match in the scan with given poses, of those that have matches there. FOLDER stays, and
a study that was stopped goes on.

--kills: one scan of a quarter of the room's photos and one of their capture, each killed at so many moments and begun
again; what they end with is compared byte by byte with scans that were left alone, on one thread.

--photos: a capture of so many photos of 96 x 72 pixels, along the same path: the most memory that a process of its scan
had, its seconds, and the size of its page. A tenth of the photos stands beside it.
"""

import json
import resource
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import arguments
from benchmarks.study_poses import EACH, _film, _frame, _photos, said
from drsplat.authoring.filming.paths import CameraPath, KeyFrame
from drsplat.drawing.pictures import as_pixels
from drsplat.drawing.rendering import render
from drsplat.evaluation.demo.story import SCENE, unpack_household
from drsplat.formats.captures import read_views
from drsplat.formats.poses import read_cameras_json, write_cameras_json
from drsplat.formats.scan_record import read_scan_record
from drsplat.formats.scenes import read_gaussians
from drsplat.fronts.commands.stages import is_done
from drsplat.photos.capture.world import umeyama
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.views import View

FRAMES, SIZE, PHOTO_EVERY, BLURRED_EVERY, BLUR_STEPS = 240, (640, 480), 4, 6, 5
SMALL = (96, 72)  # pixels of the photos where there are many
SAME_PLACE = 0.1  # of the cameras' mean distance from their middle
QUERIES = {
    "plush": "something pink; something orange; something blue; something white",
    "room": "red vase; couch; something blue; lamp",
}


def write_room(folder: Path) -> None:
    """Write the demo's room as a capture (capture/), as photos (photos/) and as a film (film.mp4)."""
    import av

    scene, path = _scene_and_path(folder)
    between = path.views(FRAMES * BLUR_STEPS, SIZE)
    (folder / "capture/images").mkdir(parents=True, exist_ok=True)
    photos = []
    with av.open(str(folder / "film.mp4"), "w") as film:
        stream = film.add_stream("libx264", rate=30)
        (stream.width, stream.height), stream.pix_fmt = SIZE, "yuv420p"
        for number in range(FRAMES):
            steps = between[number * BLUR_STEPS : (number + 1) * BLUR_STEPS]
            blurred = number % BLURRED_EVERY == BLURRED_EVERY - 1
            pixels = np.mean([render(scene, view).rgb for view in (steps if blurred else steps[:1])], axis=0)
            picture = Image.fromarray(as_pixels(pixels.astype(np.float32)))
            film.mux(stream.encode(av.VideoFrame.from_image(picture)))  # type: ignore[no-untyped-call]
            if number % PHOTO_EVERY == 0:
                view = replace(steps[0], name=f"frame_{number:04}.jpg", image_path=Path(f"frame_{number:04}.jpg"))
                picture.save(folder / "capture/images" / view.name, quality=92)
                photos.append(view)
        film.mux(stream.encode())
    write_cameras_json(folder / "capture/cameras.json", photos, overwrite=True)
    truth = [replace(view, name=f"frame_{n:04}.jpg") for n, view in enumerate(between[::BLUR_STEPS])]
    write_cameras_json(folder / "truth.json", truth, overwrite=True)
    _photos(folder / "capture", [view.name for view in photos], folder / "photos")


def _scene_and_path(folder: Path) -> tuple[Gaussians, CameraPath]:
    """Unpack the demo's room into a folder; return its Gaussians and a path through its cameras."""
    household = unpack_household(folder / "demo", overwrite=True)
    path = CameraPath([KeyFrame.of(view) for view in _tour(read_views(household.folder))])
    return read_gaussians(household.folder / SCENE), path


def _tour(views: list[View]) -> list[View]:
    """Return the views in an order in which each is near the one before, in place and direction."""
    places = np.array([np.concatenate([view.center, view.cam_from_world[2, :3]]) for view in views])
    order = [0]
    while len(order) < len(views):
        away = np.linalg.norm(places - places[order[-1]], axis=1)
        away[order] = np.inf
        order.append(int(away.argmin()))
    return [views[at] for at in order]


def write_plush(capture: Path, folder: Path) -> None:
    names = sorted(path.name for path in (capture / "images").iterdir())
    folder.mkdir(parents=True, exist_ok=True)
    _photos(capture, names, folder / "photos")
    _film(capture, names, folder / "film.mp4")


def scan(source: Path, output: Path, queries: str, options: list[str]) -> dict[str, Any]:
    """Run a scan as people do, and return what it prints."""
    made = subprocess.run(_line(source, output, queries, options), stdout=subprocess.PIPE, check=False)
    answer: dict[str, Any] = json.loads(made.stdout)
    if made.returncode:
        raise SystemExit(f"{source}: {answer['error']}")
    return answer


def _line(source: Path, output: Path, queries: str, options: list[str]) -> list[str]:
    words = ["scan", str(source), "-o", str(output), "--ask", queries, "--json"]
    return [sys.executable, "-m", "drsplat", *words, *options]


def rows(name: str, given: Path, folder: Path, options: list[str]) -> None:
    """Print a row for the scan with given poses, of the photos, and of the film."""
    known = scan(given, folder / "scan_given", QUERIES[name], options)
    print(_row(name, "given poses", known, "- | - | -", "-"), flush=True)
    for kind, source in (("photos", folder / "photos"), ("film", folder / "film.mp4")):
        answer = scan(source, folder / f"scan_{kind}", QUERIES[name], options)
        posed = read_views(answer["capture"])
        true = _true(name, kind, given, folder, posed)
        capture = json.loads((Path(answer["capture"]) / "capture.json").read_text())
        poses = " | ".join(said(posed, true, capture, False).split(" | ")[:3])
        print(_row(name, kind, answer, poses, _same_places(known, answer, posed, true)), flush=True)


def _true(name: str, kind: str, given: Path, folder: Path, posed: list[View]) -> list[View]:
    if name == "room":
        true = {view.name: view for view in read_cameras_json(folder / "truth.json")}
        return [true[f"frame_{_frame(view.name):04}.jpg"] for view in posed]
    by_name = {view.name: view for view in read_views(given)}
    names = sorted(by_name)
    return [by_name[names[_frame(view.name) // EACH] if kind == "film" else view.name] for view in posed]


def _same_places(known: dict[str, Any], answer: dict[str, Any], posed: list[View], true: list[View]) -> str:
    here, there = (np.array([view.center for view in views]) for views in (posed, true))
    similarity = umeyama(here, there)
    spread = np.linalg.norm(there - there.mean(axis=0), axis=1).mean()
    asked = [
        (one["matches"], other["matches"])
        for one, other in zip(known["answers"], answer["answers"], strict=True)
        if one.get("matches")
    ]
    right = 0
    for expected, matches in asked:
        if matches:
            place = similarity.positions(np.array([matches[0]["center"]]))
            away = np.linalg.norm(np.array([one["center"] for one in expected]) - place, axis=1)
            right += bool(away.min() < SAME_PLACE * spread)
    return f"{right} of {len(asked)}"


def _row(name: str, kind: str, answer: dict[str, Any], poses: str, places: str) -> str:
    verbs = ("capture", "train", "embed", "register", "objects", "view")
    seconds, cpu = answer["stage_seconds"], answer["stage_cpu_seconds"]
    stages = ", ".join(f"{verb} {seconds[verb]:.0f} ({cpu[verb]:.0f})" for verb in verbs if verb in seconds)
    return (
        f"| {name}, {kind} | {poses} | {answer['psnr_test']:.2f} | {answer['num_gaussians']:,} | "
        f"{answer['num_objects']} | {places} | {stages} |"
    )


def kills(source: Path, folder: Path, number: int, options: list[str]) -> None:
    """Kill one scan so many times, and compare what it ends with with a scan that was left alone."""
    for name in ("whole", "killed"):  # the page has the folder's name
        (folder / name).mkdir(parents=True, exist_ok=True)
    seconds = scan(source, folder / "whole/room", QUERIES["room"], options)["stage_seconds"]
    shutil.rmtree(folder / "killed/room", ignore_errors=True)
    start = time.perf_counter()
    scan(source, folder / "whole/room", QUERIES["room"], options)
    again = time.perf_counter() - start  # all is there: what it takes to begin
    each = -(-number // len(seconds))
    moments = [(verb, spent / (each + 1)) for verb, spent in seconds.items() for _ in range(each)][:number]
    fell = [_kill(source, folder / "killed/room", verb, delay, again, options) for verb, delay in moments]
    scan(source, folder / "killed/room", QUERIES["room"], options)
    made = [_results(folder / name / "room") for name in ("whole", "killed")]
    other = sorted(name for name in made[0].keys() | made[1].keys() if made[0].get(name) != made[1].get(name))
    counts = ", ".join(f"{fell.count(verb)} in {verb}" for verb in seconds)
    print(
        f"{source.name}: killed {number - fell.count('')} times ({counts}); of {len(made[0])} files {len(other)} have "
        f"other bytes: {', '.join(other) or 'none'}",
        flush=True,
    )


def _few(room: Path, folder: Path) -> Path:
    """Write every other photo of the room's first half, as photos and as a capture; return the folder."""
    if (folder / "photos").is_dir():
        return folder
    views = read_views(room / "capture")[:30:2]
    (folder / "capture/images").mkdir(parents=True, exist_ok=True)
    for view in views:
        shutil.copy(room / "photos" / view.name, folder / "capture/images" / view.name)
    write_cameras_json(folder / "capture/cameras.json", views, overwrite=True)
    _photos(folder / "capture", [view.name for view in views], folder / "photos")
    return folder


def _kill(source: Path, output: Path, verb: str, delay: float, again: float, options: list[str]) -> str:
    """Let a scan go on, and kill it `delay` seconds after a stage began; return the stage that it was in, "" if ended.

    again: seconds until a scan that goes on is where it was.
    """
    line = _line(source, output, QUERIES["room"], options)
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    begun = {name for name, _ in _stages(output)}
    delay += again if verb in begun else 0.0
    while process.poll() is None and verb not in begun:
        time.sleep(0.01)
        begun = {name for name, _ in _stages(output)}
    time.sleep(delay)
    if process.poll() is not None:
        return ""
    process.kill()
    process.wait()
    return next((name for name, done in _stages(output) if not done), "view")


def _stages(output: Path) -> list[tuple[str, bool]]:
    """Return the stages that a scan has begun, and whether they are done."""
    record = read_scan_record(output) if output.is_dir() else None
    return [(name, is_done(state)) for name, state in record["stages"].items()] if record else []


def many(folder: Path, number: int, options: list[str]) -> None:
    """Print what a scan of a capture of so many small photos takes."""
    capture, output = folder / f"{number}/capture", folder / f"{number}/scan"
    if not (capture / "cameras.json").is_file():
        scene, path = _scene_and_path(folder)
        names = [Path(f"frame_{at:05}.jpg") for at in range(number)]
        views = [
            replace(view, name=name.name, image_path=name)
            for view, name in zip(path.views(number, SMALL), names, strict=True)
        ]
        (capture / "images").mkdir(parents=True, exist_ok=True)
        for view in views:
            Image.fromarray(as_pixels(render(scene, view).rgb)).save(capture / "images" / view.name, quality=92)
        write_cameras_json(capture / "cameras.json", views, overwrite=True)
    shutil.rmtree(output, ignore_errors=True)
    answer = scan(capture, output, QUERIES["room"], options)
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    page = Path(answer["page"]).stat().st_size / 1e6
    seconds = ", ".join(f"{verb} {spent:.0f}" for verb, spent in answer["stage_seconds"].items())
    print(
        f"| {number:,} | {answer['num_masks']:,} | {answer['num_gaussians']:,} | {answer['num_objects']} | "
        f"{most:,.0f} | {page:.1f} | {seconds} |",
        flush=True,
    )


def _results(output: Path) -> dict[str, bytes]:
    """Return all files of what a scan makes but for its record and the capture's, which hold times and places."""
    parts = ("capture/images", "capture/sparse", "model/point_cloud", "features", "scene.field")
    files = [output / "index.html", *(file for part in parts for file in (output / part).rglob("*") if file.is_file())]
    return {str(file.relative_to(output)): file.read_bytes() for file in files}


def main() -> None:
    given = arguments(__doc__, work=Path, plush=Path, iterations=2000, side=1600, threads=0, kills=0, photos=0)
    if given.work is None:
        raise SystemExit("name a folder for all that is made: --work FOLDER")
    options = ["--iterations", str(given.iterations), "--segmenter", "graph", "--encoder", "drsplat-mini"]
    options += ["--threads", str(given.threads)] if given.threads else []
    given.work.mkdir(parents=True, exist_ok=True)
    config = given.work / "scan.toml"
    config.write_text(f"[train]\nresolution = {given.side}\n")
    options += ["--config", str(config)]
    if given.photos:
        print("| photos | masks | Gaussians | objects | most memory, MiB | page, MB | seconds |")
        print("|---" * 7 + "|")
        for number in (given.photos // 10, given.photos):
            many(given.work / "many", number, options)
        return
    if not (given.work / "room/photos").is_dir():
        write_room(given.work / "room")
    if given.kills:
        few = _few(given.work / "room", given.work / "few")
        for name in ("photos", "capture"):
            kills(few / name, given.work / "kills" / name, given.kills, [*options, "--threads", "1"])
        return
    print("| what | posed | centres, % | rotations, degrees | dB | Gaussians | objects | answers | seconds (CPU) |")
    print("|---" * 9 + "|")
    rows("room", given.work / "room/capture", given.work / "room", options)
    if given.plush is not None:
        if not (given.work / "plush/film.mp4").is_file():
            write_plush(given.plush, given.work / "plush")
        rows("plush", given.plush, given.work / "plush", options)


if __name__ == "__main__":
    main()
