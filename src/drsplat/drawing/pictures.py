"""Pictures of answers: a photo in which the selection keeps its colours and the rest fades to grey.

Colours of classes, on Gaussians and in pictures with a legend.
"""

import base64
import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..base.arrays import (
    Array,
    Float32,
    Ids,
    Integer,
    Mask,
    Numbers,
    OtherPixels,
    PixelNumbers,
    Pixels,
    UInt8,
    WholeNumbers,
)
from ..base.contents import AnyPath
from ..errors import InputError
from ..formats.replacing import replacing
from ..kernels import SplatArrays, render_channels, splat_arrays
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.moving import Moving, canonical_of
from ..scene.photos import load_image
from ..scene.views import View
from .heat import LUMA, class_colors, heat_colors
from .rendering import render

OUTLINE_COLOR = (255, 64, 160)
PNG_LEVEL = 3  # of 9: half the time of the usual 6, and a tenth more bytes
MIN_LIGHT = 0.45  # share of its colour that heat keeps where the photo is black
LETTER_SCALES = (1.0, 0.9, 0.8, 0.7, 0.6)  # of the size that fits a strip's height
PAPER, INK, FAINT = (255, 255, 255), (28, 30, 36), (98, 104, 118)
Letters = ImageFont.FreeTypeFont | ImageFont.ImageFont


def as_pixels(rgb: Float32[Array, "h w 3"]) -> Pixels:
    """Convert floats in [0, 1] to bytes; other values are clipped."""
    scaled = np.clip(rgb, 0, 1)
    scaled *= 255
    scaled += 0.5
    return scaled.astype(np.uint8)


def picture_html(picture: Image.Image) -> str:
    """Return an HTML tag that holds the picture as a JPEG, for notebooks."""
    file = io.BytesIO()
    picture.convert("RGB").save(file, "JPEG", quality=85)
    return f'<img src="data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}">'


def photo_or_rendering(
    gaussians: Gaussians, view: View, *, splats: SplatArrays | None = None, threads: int = 0
) -> Pixels:
    """Return the photo of the view, or a rendering of the Gaussians where it has none."""
    if view.image_path is not None:
        return load_image(view)
    return as_pixels(render(gaussians, view, splats=splats, threads=threads).rgb)


def visible_share(
    gaussians: Gaussians, view: View, ids: WholeNumbers, *, splats: SplatArrays | None = None, threads: int = 0
) -> PixelNumbers:
    """Return, per pixel, the summed blending weight of the Gaussians at `ids`, as far as nothing hides them."""
    if not len(ids):
        return np.zeros((view.height, view.width), np.float32)
    chosen = np.zeros((len(gaussians), 1), np.float32)
    chosen[ids] = 1
    drawn = render_channels(splats or splat_arrays(gaussians), view, chosen, threads=threads)
    return drawn.channels[..., 0]


def highlighted(photo: Pixels, share: PixelNumbers, outline_px: int = 0) -> Pixels:
    """Draw the photo grey and pale where `share` is 0, with a line around where it is above a half.

    outline_px: thickness of the line in pixels; 0 takes one in 240 of the width.

    Raises: InputError: photo and share differ in size.
    """
    if photo.shape[:2] != share.shape:
        raise InputError(
            f"the photo is {photo.shape[:2]}, the share {share.shape}: render the share at the photo's size"
        )
    grey = photo @ LUMA
    faded = (150 + 0.38 * (grey - 110))[..., None]
    visible = np.clip(share, 0, 1)[..., None]
    picture: Pixels = np.clip(photo * visible + faded * (1 - visible), 0, 255).astype(np.uint8)
    picture[border(share > 0.5, outline_px or max(2, photo.shape[1] // 240))] = OUTLINE_COLOR
    return picture


def heated(photo: Pixels, heat: PixelNumbers) -> Pixels:
    """Draw heat in [0, 1] as colours over the photo, which keeps its light and shade.

    Raises: InputError: photo and heat differ in size.
    """
    if photo.shape[:2] != heat.shape:
        raise InputError(f"the photo is {photo.shape[:2]}, the heat {heat.shape}: render the heat at the photo's size")
    warm = heat_colors(np.linspace(0, 1, 256, dtype=np.float32)) * np.float32(255)
    shade = MIN_LIGHT + (1 - MIN_LIGHT) / 255 * (photo @ LUMA.astype(np.float32))[..., None]
    return (warm[(np.clip(heat, 0, 1) * 255).astype(np.uint8)] * shade).astype(np.uint8)


def border(inside: Mask, thickness: int) -> Mask:
    """Return the pixels just outside a region; specks of a few pixels get none."""
    from scipy import ndimage

    rows, columns = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    border = np.zeros_like(inside)
    if not len(rows):
        return border
    beyond = thickness + 1
    part = tuple(slice(max(at[0] - beyond, 0), at[-1] + 1 + beyond) for at in (rows, columns))
    pieces, num = ndimage.label(inside[part])  # nothing changes further away
    sizes = np.bincount(pieces.ravel(), minlength=num + 1)
    sizes[0] = 0
    region = ndimage.binary_fill_holes((sizes > 4 * thickness**2)[pieces])
    border[part] = ndimage.binary_dilation(region, iterations=thickness) & ~region
    return border


def best_views(
    scene: Gaussians | Moving, views: Sequence[View], selections: Sequence[Integer[Array, " _"]], *, threads: int = 0
) -> list[View]:
    """Return, for each selection, the view that shows most of it, by share of pixels, and does not cut it off.

    scene: a moving one is taken at the time of each photo.

    Raises: InputError: no views.
    """
    if not views:
        raise InputError("there are no views to choose from")
    still = splat_arrays(canonical_of(scene))
    areas = np.empty((len(views), len(selections)))
    for row, view in enumerate(views):
        moves = isinstance(scene, Moving) and view.time is not None
        splats = splat_arrays(scene.at(view.time), still.near) if moves else still  # type: ignore[union-attr,arg-type]
        areas[row] = shown_areas(splats, view, selections, threads=threads)
    return [views[best] for best in areas.argmax(0)]


def shown_areas(
    splats: SplatArrays, view: View, selections: Sequence[Integer[Array, " _"]], *, threads: int = 0
) -> Numbers:
    """Return how many pixels of a small picture each selection has, divided by those at its borders."""
    chosen = np.zeros((splats.means.shape[1], len(selections)), np.float32)
    for column, ids in enumerate(selections):
        chosen[ids, column] = 1
    small = view.resized(160, max(1, round(160 * view.height / view.width)))
    share = render_channels(splats, small, chosen, threads=threads).channels
    cut = share[[0, -1]].sum((0, 1)) + share[:, [0, -1]].sum((0, 1))
    return share.sum((0, 1)) / (1 + cut)


def zoomed(view: View, share: PixelNumbers, margin: float = 3.2, most: float = 3.0) -> View:
    """Return the camera with a longer lens, on the region where `share` is above a half.

    margin: sides of the picture over sides of that region, at least. most: largest magnification.
    """
    rows, columns = np.nonzero(share > 0.5)
    if len(rows) == 0:
        return view
    (top, bottom), (left, right) = np.percentile(rows, (1, 99)), np.percentile(columns, (1, 99))
    needed = max(margin * (right - left) / view.width, margin * (bottom - top) / view.height, 1 / most)
    scale = min(1.0, needed)
    width, height = scale * view.width, scale * view.height
    x = np.clip((left + right - width) / 2, 0, view.width - width)
    y = np.clip((top + bottom - height) / 2, 0, view.height - height)
    K = np.diag([1 / scale, 1 / scale, 1]) @ (view.K - np.array([[0, 0, x], [0, 0, y], [0, 0, 0]]))
    return replace(view, K=K)


def titled(picture: Pixels, title: str, note: str = "") -> OtherPixels:
    """Add a strip above the picture with a title on the left and a note on the right, which do not meet."""
    height, width = picture.shape[:2]
    strip = max(28, width // 15)
    canvas = Image.new("RGB", (width, height + strip), PAPER)
    canvas.paste(Image.fromarray(picture), (0, strip))
    draw = ImageDraw.Draw(canvas)
    for share in LETTER_SCALES:  # as large as both fit in one line, and never tiny
        large, small = (ImageFont.load_default(part * strip * share) for part in (0.56, 0.42))
        if draw.textlength(title, large) + draw.textlength(note, small) <= width - strip:
            break
    left = width - strip - draw.textlength(note, small)
    draw.text((strip * 0.35, strip / 2), fitting(draw, title, large, left), INK, large, anchor="lm")
    draw.text((width - strip * 0.35, strip / 2), note, FAINT, small, anchor="rm")
    return np.asarray(canvas)


def fitting(draw: ImageDraw.ImageDraw, text: str, letters: Letters, room: float) -> str:
    """Return a text as it is, or its beginning with an ellipsis where it is longer than `room` pixels."""
    if draw.textlength(text, letters) <= room:
        return text
    fits = [count for count in range(len(text)) if draw.textlength(f"{text[:count]}…", letters) <= room]
    return f"{text[: max(fits, default=0)].rstrip()}…"


def contact_sheet(pictures: Sequence[OtherPixels], columns: int, tile_width: int = 400, gap: int = 14) -> OtherPixels:
    """Put pictures of one shape side by side in rows, on white.

    Raises: InputError: no picture, or pictures of different shapes.
    """
    shapes = {picture.shape for picture in pictures}
    if len(shapes) != 1:
        raise InputError(f"a contact sheet needs pictures of one shape, got {sorted(shapes)}")
    height = round(pictures[0].shape[0] * tile_width / pictures[0].shape[1])
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (tile_width + gap) + gap, rows * (height + gap) + gap), PAPER)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        tile = Image.fromarray(picture).resize((tile_width, height), Image.Resampling.LANCZOS)
        sheet.paste(tile, (gap + column * (tile_width + gap), gap + row * (height + gap)))
    return np.asarray(sheet)


def write_picture(path: AnyPath, pixels: UInt8[Array, "h w *c"], overwrite: bool = False) -> None:
    """Write a PNG, or a JPEG if the name ends in .jpg or .jpeg.

    Raises: InputError: the file exists and not `overwrite`; another suffix.
    """
    suffix = str(path).lower().rpartition(".")[2]
    options = {
        "png": ("PNG", {"compress_level": PNG_LEVEL}),
        "jpg": ("JPEG", {"quality": 92}),
        "jpeg": ("JPEG", {"quality": 92}),
    }
    if suffix not in options:
        raise InputError(f"{path}: pictures are written as .png or .jpg")
    kind, settings = options[suffix]
    with replacing(path, overwrite) as file:
        Image.fromarray(pixels).save(file, kind, **settings)


UNCLASSED_CONTRAST = 0.35  # share of its own light that a Gaussian without class keeps, around a middle grey


def colored(gaussians: Gaussians, labels: Ids, count: int) -> Gaussians:
    """Return the scene in the colours of its classes, for any viewer; a dim grey where there is no class."""
    light = np.clip(0.5 + SH_C0 * gaussians.sh[:, 0].mean(1), 0, 1)
    rgb = np.repeat((0.5 + UNCLASSED_CONTRAST * (light - 0.5))[:, None], 3, axis=1).astype(np.float32)
    has_class = labels >= 0
    rgb[has_class] = class_colors(count)[labels[has_class]] / 255
    sh = ((rgb - 0.5) / SH_C0).astype(np.float32)[:, None]
    return replace(gaussians, sh=sh)


def class_picture(
    gaussians: Gaussians, view: View, photo: Pixels, labels: Ids, names: list[str], threads: int = 0
) -> OtherPixels:
    """Draw the photo in grey, tinted by the visible classes, with a legend of the scene's classes below it."""
    colors = class_colors(len(names)).astype(np.float32)
    values = np.zeros((len(gaussians), 4), np.float32)
    has_class = labels >= 0
    values[has_class, :3], values[has_class, 3] = colors[labels[has_class]], 1
    channels = render_channels(splat_arrays(gaussians), view, values, threads=threads).channels
    picture = tinted(photo, channels[..., :3], channels[..., 3])
    present = np.unique(labels[has_class])
    return np.concatenate([picture, legend(picture.shape[1], [names[i] for i in present], colors[present])])


def tinted(photo: Pixels, color: Float32[Array, "h w 3"], share: PixelNumbers) -> Pixels:
    """Put colour over the photo's grey; `color` must be weighted by `share` already."""
    grey = (photo @ LUMA)[..., None]
    covered = np.clip(share, 0, 1)[..., None]
    shade = 0.4 + 0.6 * grey / 255
    return np.clip(shade * color + (1 - covered) * (0.5 * grey + 90), 0, 255).astype(np.uint8)


def legend(width: int, names: list[str], colors: Array) -> OtherPixels:
    """Draw swatches and names in as many columns as fit."""
    size = max(12, width // 45)
    letters = ImageFont.load_default(size)
    longest = max([letters.getlength(name) for name in names], default=0)
    column = int(longest) + 3 * size
    across = max(1, width // max(column, 1))
    rows = -(-len(names) // across)
    sheet = Image.new("RGB", (width, size + rows * 2 * size), PAPER)
    draw = ImageDraw.Draw(sheet)
    for index, (name, color) in enumerate(zip(names, colors, strict=True)):
        x, y = index % across * column + size, index // across * 2 * size + size // 2
        draw.rectangle((x, y, x + size, y + size), fill=tuple(int(part) for part in color))
        draw.text((x + 1.5 * size, y), name, INK, font=letters)
    return np.asarray(sheet)
