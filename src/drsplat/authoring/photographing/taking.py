"""Captures of a scene: poses, pictures rendered from them, and the record that says so."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from warnings import warn

import numpy as np

from ...base.arrays import Points, Vector3
from ...drawing.pictures import as_pixels, write_picture
from ...drawing.rendering import render
from ...errors import DrSplatWarning, InputError
from ...field.codes import Track, untracked
from ...formats.colmap import read_colmap
from ...formats.colmap_binary import write_colmap
from ...formats.field_folder import refuse_to_replace_others, replacing_folder
from ...formats.json_files import written_name
from ...formats.rendering_record import RECORD, write_rendering_record
from ...formats.replacing import claimed_output
from ...scene.gaussians import SH_C0, SOLID_OPACITY, Gaussians, ShapesDigest
from ...scene.moving import Moving, canonical_of
from ...scene.views import View
from ..filming.looking import UP_WITHOUT_VIEWS
from ..filming.paths import CameraPath
from .candidates import Coverage, PhotographSettings, candidates, chosen_views, sights
from .space import BOX_QUANTILES, Space, solid_centers

MODEL, IMAGES = Path("sparse/0"), "images"
DEFAULT = PhotographSettings()
MAX_POINTS = 100_000  # of the capture
DEFAULT_PATH_PICTURES = 60
MAX_HEIGHT_SHARE = 0.75  # of the box's second shortest side: a shorter side is its height
SLICE_SHARE = 0.2  # of the height: the lowest and the highest slice are compared
FOOTPRINT_CELLS = 24  # along each of the other two sides
AXES = ("x", "y", "z")


class Plan(NamedTuple):
    """Planned poses. kind: as `candidates` says, or "path". num_candidates: number of cameras to choose from."""

    kind: str
    views: list[View]
    coverage: Coverage
    num_candidates: int


def photograph(
    scene: Gaussians | Moving,
    output: str | Path,
    settings: PhotographSettings = DEFAULT,
    *,
    name: str = "scene",
    path: CameraPath | None = None,
    overwrite: bool = False,
    threads: int = 0,
    track: Track = untracked,
) -> dict[str, Any]:
    """Render pictures of a scene from planned poses, write them as a capture, and return its record.

    The folder has images/ and a COLMAP model (sparse/0) whose points are centres of Gaussians. Its photograph.json says
    that the pictures are renderings, and of which scene. It appears as a whole or not at all. The same scene and
    settings give the same poses at any number of threads.

    Args:
        scene: Gaussians; of a moving scene, those at `settings.time`.
        output: folder to write.
        settings: how many pictures, of which size, lens and upward direction.
        name: of the scene, for the record.
        path: cameras to take in place of planned ones; their lens counts.
        overwrite: replace an existing capture of renderings, with everything in its folder.
        threads: 0 for all cores.
        track: shows progress.

    Raises:
        InputError: an output that is in the way, a scene without Gaussians or without free space, a moving scene
            without a time, a time of a scene that stands still.
    """
    output = Path(output)
    gaussians = _at_time(scene, settings.time)
    if output.exists() and not overwrite:
        raise InputError(f"{output} exists already: pass overwrite=True to replace it, or name another output")
    refuse_to_replace_others(output, RECORD)
    up = guessed_up(gaussians) if settings.up is None else np.array(settings.up) / np.linalg.norm(settings.up)
    space = Space(gaussians, up, threads)
    with claimed_output(output):
        plan = planned(space, settings, track) if path is None else along(space, path, settings, track)
        record = {
            "drsplat": version("drsplat"),
            "scene": {
                "name": written_name(name),
                "fingerprint": canonical_of(scene).fingerprint,
                "checksum": _checksum(gaussians),
                "num_gaussians": len(gaussians),
                "antialiased": gaussians.antialiased,
            },
            "time": None if settings.time is None else float(settings.time),
            "settings": asdict(settings),
            "kind": plan.kind,
            "up": axis_name(up),
            "up_from": "scene" if settings.up is None else "settings",
            "num_pictures": len(plan.views),
            "num_candidates": plan.num_candidates,
            "coverage": plan.coverage.json(),
        }
        with replacing_folder(output, overwrite, RECORD) as folder:
            _take(space, plan.views, settings, folder, track)
            write_rendering_record(folder, record)
    return record


def planned(space: Space, settings: PhotographSettings, track: Track = untracked) -> Plan:
    """Plan poses from the scene: a greedy choice that shows as much of it as possible in three pictures.

    Raises: InputError: no place for a camera, or nothing to see.
    """
    kind, views = candidates(space, settings)
    seen = sights(space, views, track).sharp()
    chosen = chosen_views(seen, settings.number)
    if not chosen:
        raise InputError("no camera sees anything of this scene that is not right before it: give a path of your own")
    return Plan(kind, [seen.views[at] for at in chosen], seen.coverage(chosen), len(views))


def along(space: Space, path: CameraPath, settings: PhotographSettings, track: Track = untracked) -> Plan:
    """Take the poses of a path, without those inside Gaussians or right before them.

    Warns: DrSplatWarning: how many are left out.
    Raises: InputError: all are.
    """
    views = path.views(settings.number or DEFAULT_PATH_PICTURES, settings.size)
    free = [view for view in views if space.is_free(view.center)]
    seen = sights(space, free, track)
    if not seen.views:
        raise InputError(
            f"all {len(views)} cameras of the path are inside of Gaussians, right before them, or see none"
        )
    if len(seen.views) < len(views):
        text = (
            f"{len(views) - len(seen.views)} of {len(views)} cameras of the path are inside of Gaussians, right before "
            "them, or see none: no pictures were taken there"
        )
        warn(text, DrSplatWarning, stacklevel=3)
    return Plan("path", seen.views, seen.coverage(range(len(seen.views))), len(views))


def _at_time(scene: Gaussians | Moving, time: float | None) -> Gaussians:
    """Return the Gaussians at a time.

    Raises: InputError: there are none, or a time that is missing or superfluous.
    """
    if not len(scene):
        raise InputError("there is nothing to photograph: the scene has no Gaussians")
    if isinstance(scene, Moving):
        if time is None:
            first, last = scene.span
            raise InputError(f"time: this scene moves: give one of {first:g} to {last:g}")
        return scene.at(scene.inside(time))
    if time is not None:
        raise InputError(f"time: this scene stands still: expected none, got {time:g}")
    return scene


def _take(space: Space, views: Sequence[View], settings: PhotographSettings, folder: Path, track: Track) -> None:
    """Write the model, and a picture of each of its poses."""
    digits = max(4, len(str(len(views))))
    named = [
        View(f"view_{number:0{digits}d}.png", view.K, view.cam_from_world, view.width, view.height)
        for number, view in enumerate(views)
    ]
    (folder / MODEL).mkdir(parents=True)
    (folder / IMAGES).mkdir()
    # Centres and colours of solid Gaussians, evenly chosen where there are many
    (solid,) = np.nonzero(space.gaussians.opacities >= SOLID_OPACITY)
    rows = solid if len(solid) else np.arange(len(space.gaussians))
    rows = rows[:: -(-len(rows) // MAX_POINTS)]
    colors = as_pixels(0.5 + np.float32(SH_C0) * space.gaussians.sh[rows, :1])
    write_colmap(folder / MODEL, named, *(space.gaussians.positions[rows], colors[:, 0]))
    for view in track(read_colmap(folder / MODEL), "rendering"):
        drawn = render(
            space.gaussians, view, background=settings.background, threads=space.threads, splats=space.splats
        )  # fmt: skip
        write_picture(folder / IMAGES / view.name, as_pixels(drawn.rgb))


def _checksum(gaussians: Gaussians) -> str:
    """Return a hash of all that a picture is made from, whatever file it was read from."""
    digest = hashlib.blake2b(ShapesDigest(gaussians.origin).add(gaussians).text().encode(), digest_size=16)
    digest.update(np.ascontiguousarray(gaussians.sh).data)
    return digest.hexdigest()


def guessed_up(gaussians: Gaussians) -> Vector3:
    """Return the most likely upward axis of a scene.

    Rooms, and objects with the ground around them, are lower than they are wide, and a floor covers more of their
    outline than a ceiling, which few photos show. A scene without such a shortest side gets the -y of COLMAP's first
    camera.
    """
    points = solid_centers(gaussians)
    low, high = np.quantile(points, BOX_QUANTILES, axis=0)
    sides = high - low
    shortest, second = np.argsort(sides, kind="stable")[:2].tolist()
    if not sides[shortest] < MAX_HEIGHT_SHARE * sides[second]:
        return np.array(UP_WITHOUT_VIEWS)
    shares = (points - low) / np.maximum(sides, 1e-12)
    height = shares[:, shortest]
    below, above = (_footprint(shares[part], shortest) for part in (height < SLICE_SHARE, height > 1 - SLICE_SHARE))
    up = np.zeros(3)
    up[shortest] = 1.0 if below >= above else -1.0
    return up


def _footprint(shares: Points, axis: int) -> int:
    """Count the cells across an axis that contain points. shares: of the box, 0 to 1 inside."""
    flat = np.delete(shares, axis, axis=1)
    inside = ((flat >= 0) & (flat < 1)).all(1)
    return len(np.unique((flat[inside] * FOOTPRINT_CELLS).astype(int), axis=0))


def axis_name(up: Vector3) -> str:
    """Return "+z" and so on, or three numbers for a direction between the axes."""
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > 1 - 1e-9:
        return f"{'+' if up[axis] > 0 else '-'}{AXES[axis]}"
    return " ".join(f"{number:.3f}" for number in up)
