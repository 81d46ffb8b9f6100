"""Paste printed sheets into the photos of a real capture: what petals and letters do to a list can then be measured.

    python benchmarks/paste_prints.py CAPTURE SCENE SHEETS.json --output FOLDER

SHEETS.json: a list of {"picture": file, "photo": name, "center": [x, y], "width": of the sheet, "turn": degrees}, in
pixels of the stored photo. A sheet lies in the plane that SCENE, trained on the capture, has there, keeps the shape of
its picture with a white margin, and is hidden by what stands before it. FOLDER is a capture in COLMAP's format with
labels of the photos that have outlines (`tests/support/*_outlines.json`): the outlined things and the sheets.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.outlines import inside, outlines_path, read_outlines
from drsplat import Gaussians, View, load_image, read_gaussians, read_views
from drsplat.formats.colmap_binary import write_colmap
from drsplat.kernels import SplatArrays, render_channels, splat_arrays

SIDE = 1008  # pixels of the longer side of the photos written
MARGIN = 0.06  # of the picture's longer side, white
NEAR = (
    0.02  # of its depth, by which the scene may lie before a sheet and not hide it; a wall without texture needs more
)
FLAT = 0.01  # of the depth: further from the plane a pixel says nothing of it


@dataclass(frozen=True, eq=False)
class Sheet:
    """picture: (h, w, 3) float with its margin. corner, right, down: of the sheet in the world, sides in full. near:
    share of its depth by which what hides it lies before it."""

    name: str
    picture: np.ndarray
    corner: np.ndarray
    right: np.ndarray
    down: np.ndarray
    near: float


def framed(path: Path) -> np.ndarray:
    picture = Image.open(path).convert("RGB")
    picture.thumbnail((512, 512))
    margin = round(MARGIN * max(picture.size))
    sheet = Image.new("RGB", (picture.width + 2 * margin, picture.height + 2 * margin), (244, 243, 240))
    sheet.paste(picture, (margin, margin))
    return np.asarray(sheet, np.float64)


def rays(view: View, points: np.ndarray) -> np.ndarray:
    """Directions in the world of pixels (n, 2), their z in the camera being 1."""
    inner = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(view.K).T
    return np.asarray(inner @ view.cam_from_world[:3, :3])


def placed(entry: Mapping[str, object], views: Mapping[str, View], splats: SplatArrays) -> Sheet:
    full = views[str(entry["photo"])]
    view = replace(full, distortion=None).limited(SIDE)
    scale = view.width / full.width
    center, width = np.array(entry["center"], np.float64) * scale, float(entry["width"]) * scale  # type: ignore[arg-type]
    depth = render_channels(splats, view, np.ones((splats.means.shape[1], 1), np.float32)).depth  # type: ignore[arg-type, attr-defined]
    y, x = np.mgrid[: view.height, : view.width]
    beside = (np.abs(x - center[0]) < width / 2) & (np.abs(y - center[1]) < width / 2) & (depth > 0)
    pixels = np.column_stack([x[beside], y[beside]]) + 0.5
    cloud = view.center + rays(view, pixels) * depth[beside][:, None]
    normal, offset = plane(cloud, FLAT * float(np.median(depth[beside])))
    ends = center + np.array([(0, 0), (width / 2, 0)])
    middle, right_end = meeting(view, ends, normal, offset)
    right = 2 * (right_end - middle)
    down = np.cross(normal, right)
    if (view.cam_from_world[:3, :3] @ down)[1] < 0:
        down = -down
    turn = np.deg2rad(float(entry.get("turn", 0)))  # type: ignore[arg-type]
    right, down = np.cos(turn) * right + np.sin(turn) * down, np.cos(turn) * down - np.sin(turn) * right
    picture = framed(Path(str(entry["picture"])))
    down = down * picture.shape[0] / picture.shape[1]
    near = float(entry.get("near", NEAR))  # type: ignore[arg-type]
    return Sheet(Path(str(entry["picture"])).stem, picture, middle - right / 2 - down / 2, right, down, near)


def plane(cloud: np.ndarray, flat: float) -> tuple[np.ndarray, float]:
    """Normal and offset of the plane that most points lie on."""
    rng, best = np.random.default_rng(0), (0, np.zeros(3), 0.0)
    for _ in range(200):
        one, two, three = cloud[rng.choice(len(cloud), 3, replace=False)]
        normal = np.cross(two - one, three - one)
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        on = np.abs(cloud @ normal - normal @ one) < flat
        best = max(best, (int(on.sum()), normal, float(normal @ one)), key=lambda found: found[0])
    on = np.abs(cloud @ best[1] - best[2]) < flat
    middle = cloud[on].mean(0)
    normal = np.linalg.svd(cloud[on] - middle, full_matrices=False)[2][2]
    return normal, float(normal @ middle)


def meeting(view: View, points: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    toward = rays(view, points)
    return np.asarray(view.center + toward * ((offset - normal @ view.center) / (toward @ normal))[:, None])


def pasted(view: View, photo: np.ndarray, depth: np.ndarray, sheets: list[Sheet]) -> tuple[np.ndarray, np.ndarray]:
    """The photo with its sheets, and the sheet of each pixel, -1 for none. Twice as fine, then halved."""
    fine = view.resized(2 * view.width, 2 * view.height)
    colors = photo.repeat(2, 0).repeat(2, 1).astype(np.float64)
    owner = np.full(colors.shape[:2], -1, np.int32)
    shade = np.clip(np.quantile(photo.max(-1), 0.9) / 255, 0.5, 1)
    for number, sheet in enumerate(sheets):
        box = bounds(fine, sheet)
        if box is None:
            continue
        rows, columns = box
        y, x = np.mgrid[rows, columns]
        frame = np.linalg.inv(np.column_stack([sheet.right, sheet.down, np.cross(sheet.right, sheet.down)]))
        toward = rays(fine, np.column_stack([x.ravel(), y.ravel()]) + 0.5) @ frame.T
        start = frame @ (view.center - sheet.corner)
        away = -start[2] / np.where(toward[:, 2] == 0, np.nan, toward[:, 2])
        place = (start[:2] + toward[:, :2] * away[:, None]).reshape(*x.shape, 2)
        away, behind = away.reshape(x.shape), depth[y // 2, x // 2]
        there = (away > 0) & (place >= 0).all(-1) & (place < 1).all(-1)
        there &= (behind <= 0) | (behind > away * (1 - sheet.near))
        there = ndimage.binary_opening(ndimage.binary_closing(there, iterations=4), iterations=2)
        height, width = sheet.picture.shape[:2]
        at = [place[there][:, 1] * height - 0.5, place[there][:, 0] * width - 0.5]
        picture = [ndimage.map_coordinates(sheet.picture[..., one], at, order=1, mode="nearest") for one in range(3)]
        colors[y[there], x[there]] = shade * np.stack(picture, 1)
        owner[y[there], x[there]] = number
    half = colors.reshape(view.height, 2, view.width, 2, 3).mean((1, 3))
    return np.uint8(np.round(half)), owner[::2, ::2]


def bounds(view: View, sheet: Sheet) -> tuple[slice, slice] | None:
    """Rows and columns that a sheet lies within; None where a corner is behind the camera, or all are outside."""
    steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)], np.float64)
    corners = sheet.corner + steps @ np.stack([sheet.right, sheet.down])
    inner = corners @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    if inner[:, 2].min() <= 0:
        return None
    pixels = (inner @ view.K.T)[:, :2] / inner[:, 2:]
    size = [view.width, view.height]
    low, high = np.clip(pixels.min(0), 0, size).astype(int), np.ceil(np.clip(pixels.max(0), 0, size)).astype(int)
    return (slice(low[1], high[1]), slice(low[0], high[0])) if (high > low).all() else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("sheets", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    gaussians: Gaussians = read_gaussians(arguments.scene)
    splats = splat_arrays(gaussians)
    views = {view.name: view for view in read_views(arguments.capture)}
    entries = json.loads(arguments.sheets.read_text(encoding="utf-8"))
    sheets = [placed(entry, views, splats) for entry in entries]
    outlined = read_outlines(outlines_path(arguments.capture.name))
    names = sorted({thing for things in outlined.values() for thing in things})
    for folder in ("images", "labels", "sparse/0"):
        (arguments.output / folder).mkdir(parents=True, exist_ok=True)
    written, ones = [], np.ones((len(gaussians), 1), np.float32)
    for view in views.values():
        small = replace(view, distortion=None).limited(SIDE)
        photo = np.asarray(
            Image.fromarray(load_image(view)).resize((small.width, small.height), Image.Resampling.LANCZOS)
        )
        picture, owner = pasted(small, photo, render_channels(splats, small, ones).depth, sheets)
        small = replace(small, name=f"{Path(view.name).stem}.png", image_path=None)
        Image.fromarray(picture).save(arguments.output / "images" / small.name)
        written.append(small)
        if view.name in outlined:
            labels = np.zeros(owner.shape, np.uint8)
            inner = {thing: inside(view, corners) for thing, corners in outlined[view.name].items()}
            for thing in sorted(inner, key=lambda thing: -np.count_nonzero(inner[thing])):
                mask = Image.fromarray(inner[thing]).resize((small.width, small.height), Image.Resampling.NEAREST)
                labels[np.asarray(mask)] = 1 + names.index(thing)
            labels[owner >= 0] = 1 + len(names) + owner[owner >= 0]
            Image.fromarray(labels).save(arguments.output / "labels" / small.name)
    numbered = ["background", *names, *(sheet.name for sheet in sheets)]
    (arguments.output / "labels.json").write_text(json.dumps(dict(enumerate(numbered))), encoding="utf-8")
    points = gaussians.means[:: max(1, len(gaussians) // 20000)].astype(np.float64)
    write_colmap(arguments.output / "sparse" / "0", written, points, np.full((len(points), 3), 128, np.uint8))


if __name__ == "__main__":
    main()
