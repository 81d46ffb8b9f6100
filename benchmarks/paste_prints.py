"""Paste six printed sheets into the photos of desk_penguin: what petals and letters do to a list can then be measured.

    python benchmarks/paste_prints.py CAPTURE SCENE --output FOLDER

The pictures are those that ship with scikit-image. Each lies in the plane that SCENE, trained on the capture, has
there, with a white margin, and is hidden by what stands before it. FOLDER is a capture in COLMAP's format with labels
of the photos that have outlines (`tests/support/*_outlines.json`): the outlined things and the sheets.
"""

import argparse
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import skimage
from PIL import Image
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.outlines import inside, outlines_path, read_outlines
from drsplat import View, load_image, read_gaussians, read_views
from drsplat.formats.colmap_binary import write_colmap
from drsplat.kernels import render_channels, splat_arrays

SIDE = 1008  # pixels of the longer side of the photos written
MARGIN = 0.06  # of the picture's longer side, white
PHOTO = "input_0003.jpg"
# picture, middle and width of the sheet in PHOTO, degrees that it is turned, and whether it hangs on the wall
SHEETS = (
    ("astronaut.png", (780, 165), 120, 0, True),
    ("motorcycle_left.png", (960, 140), 180, 0, True),
    ("chelsea.png", (1190, 170), 160, 0, True),
    ("coffee.png", (430, 770), 170, 15, False),
    ("page.png", (840, 890), 230, -10, False),
    ("hubble_deep_field.jpg", (620, 800), 140, 20, False),
)
WALL = (570, 40), (1680, 240)  # its corners in PHOTO
# shares of its depth: what lies that much before a sheet (on the wall or not) hides it, and what is so far from a plane
# says nothing of it; the wall has no texture, and so a rough depth
NEAR, FLAT = {True: 0.2, False: 0.02}, 0.01


@dataclass(frozen=True, eq=False)
class Sheet:
    """picture: (h, w, 3) with its margin. corner, right, down: of the sheet in the world, sides in full."""

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


def cloud_of(view: View, depth: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """What a box of pixels shows, in the world."""
    y, x = np.mgrid[: view.height, : view.width]
    beside = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]) & (depth > 0)
    return np.asarray(view.center + rays(view, np.column_stack([x[beside], y[beside]]) + 0.5) * depth[beside][:, None])


def placed(view: View, depth: np.ndarray, scale: float, sheet: tuple[str, tuple[int, int], int, int, bool]) -> Sheet:
    """scale: of the pixels of `view`, in which a sheet is placed, beside those of PHOTO as it is stored."""
    name, center, width, turn, on_wall = sheet
    middle, half = np.array(center) * scale, np.array([width, 0]) * scale / 2
    around = SHEETS[3] if on_wall else sheet  # the wall is upright on the desk
    place, reach = np.array(around[1]) * scale, around[2] * scale / 2
    normal, offset = plane(cloud_of(view, depth, place - reach, place + reach), FLAT * float(depth[depth > 0].mean()))
    if on_wall:
        normal, offset = wall(cloud_of(view, depth, *(np.array(WALL) * scale)), normal)
    toward = rays(view, np.array([middle, middle + half]))
    start, end = view.center + toward * ((offset - normal @ view.center) / (toward @ normal))[:, None]
    right = 2 * (end - start)
    down = np.cross(normal, right)
    down *= np.sign((view.cam_from_world[:3, :3] @ down)[1])
    cosine, sine = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    right, down = cosine * right + sine * down, cosine * down - sine * right
    picture = framed(Path(skimage.__file__).parent / "data" / name)
    down = down * picture.shape[0] / picture.shape[1]
    return Sheet(picture, start - right / 2 - down / 2, right, down, NEAR[on_wall])


def plane(cloud: np.ndarray, flat: float) -> tuple[np.ndarray, float]:
    """Normal and offset of the plane that most points lie on."""
    rng, best = np.random.default_rng(0), np.zeros(len(cloud), bool)
    for _ in range(200):
        one, two, three = cloud[rng.choice(len(cloud), 3, replace=False)]
        normal = np.cross(two - one, three - one)
        on = np.abs(cloud @ normal - normal @ one) < flat * np.linalg.norm(normal)
        best = max(best, on, key=np.count_nonzero)
    middle = cloud[best].mean(0)
    normal = np.linalg.svd(cloud[best] - middle, full_matrices=False)[2][2]
    return normal, float(normal @ middle)


def wall(cloud: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, float]:
    """Normal and offset of the upright plane along which most of a rough cloud lies."""
    flat = cloud - np.outer(cloud @ up, up)
    normal = np.linalg.svd(flat - flat.mean(0), full_matrices=False)[2][1]
    return normal, float(normal @ np.median(flat, 0))


def pasted(view: View, photo: np.ndarray, depth: np.ndarray, sheets: list[Sheet]) -> tuple[np.ndarray, np.ndarray]:
    """The photo with its sheets, and the sheet of each pixel, -1 for none. Twice as fine, then halved."""
    fine = view.resized(2 * view.width, 2 * view.height)
    colors = photo.repeat(2, 0).repeat(2, 1).astype(np.float64)
    owner = np.full(colors.shape[:2], -1, np.int32)
    shade = np.clip(np.quantile(photo.max(-1), 0.9) / 255, 0.5, 1)
    for number, sheet in enumerate(sheets):
        rows, columns = bounds(fine, sheet)
        y, x = np.mgrid[rows, columns]
        toward, behind = rays(fine, np.column_stack([x.ravel(), y.ravel()]) + 0.5), depth[y // 2, x // 2]
        frame = np.linalg.inv(np.column_stack([sheet.right, sheet.down, np.cross(sheet.right, sheet.down)]))
        inner, start = toward @ frame.T, frame @ (view.center - sheet.corner)
        away = (-start[2] / inner[:, 2]).reshape(x.shape)
        place = (start[:2] + inner[:, :2] * away.reshape(-1, 1)).reshape(*x.shape, 2)
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


def bounds(view: View, sheet: Sheet) -> tuple[slice, slice]:
    """Rows and columns that a sheet lies within; none where a corner is behind the camera."""
    steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)], np.float64)
    corners = sheet.corner + steps @ np.stack([sheet.right, sheet.down])
    inner = corners @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    pixels = (inner @ view.K.T)[:, :2] / inner[:, 2:] if inner[:, 2].min() > 0 else np.zeros((1, 2))
    low, high = (np.clip(ends, 0, (view.width, view.height)) for ends in (pixels.min(0), pixels.max(0)))
    return slice(int(low[1]), int(np.ceil(high[1]))), slice(int(low[0]), int(np.ceil(high[0])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    gaussians = read_gaussians(arguments.scene)
    splats, ones = splat_arrays(gaussians), np.ones((len(gaussians), 1), np.float32)
    photos = read_views(arguments.capture)
    small = {photo.name: replace(photo, distortion=None).limited(SIDE) for photo in photos}
    depths = {name: render_channels(splats, view, ones).depth for name, view in small.items()}
    (stored,) = (photo for photo in photos if photo.name == PHOTO)
    scale = small[PHOTO].width / stored.width
    sheets = [placed(small[PHOTO], depths[PHOTO], scale, sheet) for sheet in SHEETS]
    outlined = read_outlines(outlines_path(arguments.capture.name))
    names = sorted({thing for things in outlined.values() for thing in things})
    for folder in ("images", "labels", "sparse/0"):
        (arguments.output / folder).mkdir(parents=True, exist_ok=True)
    written = []
    for photo in photos:
        view = small[photo.name]
        picture = Image.fromarray(load_image(photo)).resize((view.width, view.height), Image.Resampling.LANCZOS)
        pixels, owner = pasted(view, np.asarray(picture), depths[photo.name], sheets)
        written.append(replace(view, name=f"{Path(photo.name).stem}.png", image_path=None))
        Image.fromarray(pixels).save(arguments.output / "images" / written[-1].name)
        if photo.name in outlined:
            labels = np.zeros(owner.shape, np.uint8)
            inner = {thing: inside(photo, corners) for thing, corners in outlined[photo.name].items()}
            for thing in sorted(inner, key=lambda thing: -np.count_nonzero(inner[thing])):
                mask = Image.fromarray(inner[thing]).resize((view.width, view.height), Image.Resampling.NEAREST)
                labels[np.asarray(mask)] = 1 + names.index(thing)
            labels[owner >= 0] = 1 + len(names) + owner[owner >= 0]
            Image.fromarray(labels).save(arguments.output / "labels" / written[-1].name)
    numbered = ["background", *names, *(Path(sheet[0]).stem for sheet in SHEETS)]
    (arguments.output / "labels.json").write_text(json.dumps(dict(enumerate(numbered))), encoding="utf-8")
    points = gaussians.means[:: max(1, len(gaussians) // 20000)].astype(np.float64)
    write_colmap(arguments.output / "sparse" / "0", written, points, np.full((len(points), 3), 128, np.uint8))


if __name__ == "__main__":
    main()
