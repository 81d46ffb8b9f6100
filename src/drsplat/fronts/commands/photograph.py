"""drsplat photograph: a splat without photos -> renderings with poses, as a capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.progress import Stopwatch
from ...errors import InputError
from .declaring import Facts, argument, declaration, finite, option, up_to
from .edit_options import note_own_scene
from .options import Verb, overwrite
from .render import BACKGROUNDS, background, size
from .tables import show_facts, size_text, text_of

if TYPE_CHECKING:
    from ...authoring.filming.paths import CameraPath
    from ...scene.gaussians import Gaussians

EXAMPLES = """\
  drsplat photograph scene.spz --output capture
  drsplat photograph scene.ply --output capture --number 80 --up +z
  drsplat photograph scene.ply --output capture --path camera_path.json
  drsplat photograph film.motion --output capture --time 0.5
  drsplat embed capture && drsplat register scene.spz capture --features capture/language_features -o scene.field

Poses are planned from the scene, in the free space of a room or on spheres around an object, so that as much of it
as possible is seen in three pictures. capture/photograph.json marks the pictures as renderings, and so do all
results made from them. A stopped run leaves nothing: give the same command again."""
DAILY = "output overwrite number size up path time"
MAX_PICTURES = 10_000


def _direction(text: str) -> tuple[float, float, float]:
    """Return a direction by the name of its axis, or by three numbers."""
    from ...authoring.filming.looking import named_up

    parts = text.split(",")
    try:
        x, y, z = map(finite, parts) if len(parts) == 3 else named_up(text).tolist()
    except InputError:
        raise argparse.ArgumentTypeError(
            f"expected one of +x -x +y -y +z -z, or three numbers with commas between, got {text!a}"
        ) from None
    return x, y, z


@declaration
class Options(Verb):
    """Options of this verb."""

    scene: str = argument(
        "Gaussians: .ply, .spz, .sog, .splat, .ksplat or a trained model's folder; of a moving scene with --time"
    )
    output: str = option(
        "folder for the capture: images/, sparse/0 in COLMAP's format, photograph.json", "DIR", flags="-o",
        required=True,
    )  # fmt: skip
    overwrite: bool = overwrite()
    number: int | None = option(
        "number of pictures (default: as many as coverage needs, 48 to 150; 60 along a path)", "N", up_to(MAX_PICTURES)
    )
    size: tuple[int, int] | None = option(
        "width and height in pixels (default: those of FILE, else 1024x768)", "WxH", size, flags="--size --resolution"
    )
    fov: float | None = option("vertical field of view (default: 60)", "DEGREES", finite)
    up: tuple[float, float, float] | None = option(
        "up in the pictures: +x, -x ... -z, or three numbers such as 0,-0.9,0.3 (default: estimated from the scene's "
        "shape; check the pictures)", "AXIS", _direction,
    )  # fmt: skip
    path: str | None = option(
        "take pictures along a path instead: that of `drsplat render`, or key frames (saved by the viewer, or "
        "nerfstudio's camera_path.json) with their lens", "orbit|swing|FILE",
    )  # fmt: skip
    time: float | None = option("time at which a moving scene is photographed", "T", finite)
    background: str = background()


def run(options: Options) -> Facts:
    from ...authoring.photographing.candidates import DEFAULT_FOV_DEGREES, DEFAULT_SIZE_PIXELS, PhotographSettings
    from ...authoring.photographing.taking import photograph
    from ...formats.moving_scenes import read_scene
    from ...scene.moving import canonical_of

    watch = Stopwatch()
    scene = read_scene(options.scene)
    note_own_scene(options.scene, canonical_of(scene))
    path = _path(options, canonical_of(scene))
    wished = None if path is None else path.size
    settings = PhotographSettings(
        options.number, options.size or wished or DEFAULT_SIZE_PIXELS, options.fov or DEFAULT_FOV_DEGREES, options.up,
        options.time, BACKGROUNDS[options.background],
    )  # fmt: skip
    watch.lap("read")
    record = photograph(
        scene, options.output, settings, name=Path(options.scene).resolve().name, path=path,
        overwrite=options.overwrite, **options.running,
    )  # fmt: skip
    watch.lap("photograph")
    return {"capture": options.output, "pictures": "renderings", **record, **watch.measures()}


def _path(options: Options, scene: Gaussians) -> CameraPath | None:
    import numpy as np

    from ...authoring.filming.planning import PHOTOS, path_named

    if options.path is None:
        return None
    if options.path == PHOTOS:
        raise InputError("path: there are no photos to go through: give orbit, swing or a file of key frames")
    if options.fov is not None:
        raise InputError("fov: a path has its own lens: leave one of both out")
    up = None if options.up is None else np.array(options.up) / np.linalg.norm(options.up)
    return path_named(options.path, scene, [], up=up)


def show(answer: Facts) -> None:
    width, height = answer["settings"]["size"]
    cover = answer["coverage"]
    guess = ", as the scene's shape suggests: --up says otherwise" if answer["up_from"] == "scene" else ""
    chosen = f", chosen from {text_of(answer['num_candidates'])} poses" if answer["kind"] != "path" else ""
    show_facts(
        f"capture: {answer['capture']}",
        {
            "pictures": f"{text_of(answer['num_pictures'])} renderings of {width}x{height}{chosen}",
            "of": f"{answer['scene']['name']}, {text_of(answer['scene']['num_gaussians'])} Gaussians",
            "poses": _KINDS[answer["kind"]],
            "up": f"{answer['up']}{guess}",
            "coverage": f"{cover['often']:.1%} of {text_of(cover['significant'])} Gaussians that matter are seen in "
            f"three pictures, {cover['once']:.1%} in one; all poses together show {cover['reachable']:.1%} in three",
            "seconds": f"{answer['seconds']:.1f}",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


_KINDS = {
    "room": "in the free space of a room, all around", "object": "on spheres around a thing and its parts",
    "mixed": "on spheres around a thing and its parts, and in the free space around it", "path": "along a path",
}  # fmt: skip
