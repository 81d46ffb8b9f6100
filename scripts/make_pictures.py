"""The documents' pictures of the demo's scene, and the card that links are shown with.

usage: python make_pictures.py DEMO [FOLDER]    DEMO: what `drsplat demo` wrote. FOLDER: docs/images by default

Writes use_find.jpg, use_list.jpg and use_change.jpg for the front page, card.png of the size that sites show links
with, and demo.jpg, objects.jpg, parts.jpg, film.jpg and attributes.jpg. The tests draw them again and compare.
"""

import sys
import textwrap
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import drsplat as ds
from drsplat.authoring.editing import Duplicate, Edit, Recolour, Remove, Rows, edited
from drsplat.authoring.filming.frames import Film, Highlight
from drsplat.authoring.filming.looking import looking_at
from drsplat.authoring.filming.planning import ORBIT, path_named, planned
from drsplat.drawing.heat import class_colors
from drsplat.drawing.labels import Mark, marked
from drsplat.drawing.pictures import as_pixels, highlighted, tinted
from drsplat.drawing.rendering import render
from drsplat.evaluation.demo.story import OVERVIEW
from drsplat.query.sheets import attribute_row, object_sheet

ROOT = Path(__file__).resolve().parent.parent
SIZE, FINER, QUALITY = (720, 450), 2, 84  # pixels; drawn so many times as large and made smaller
ASKED = ("couch", "red vase", "toy duck", "green cup", "blue candle")
NAMED = ("brown table", "orange sofa", "green mug", "red vase", "green toy duck", "green plant")
ATTRIBUTES = ("red", "blue", "red vase", "candle")
PARTS, PART_COLUMNS, PART_SIZE, PART_AWAY = 8, 4, 240, 2.4  # splats in a row and pixels; distance in sizes of a thing
FILM_FPS, FILM_FRAMES, FILM_SIZE, FILM_GAP = 4.0, (0, 6, 15, 26), (400, 300), 6  # the answer fades in at the second
WIDTHS = {"demo": 1100, "objects": 1200, "attributes": 1600, "film": 1618}  # pixels, of large pictures
MAX_PART_SIZE = 0.6  # metres
TINT, WIPE = 0.6, 0.522  # of the colours of objects; of the width, where before ends and after begins
CARD, MARGIN = (1200, 630), 56  # pixels
SAID = "Search a 3D Gaussian Splatting scene in words."
PAPER, INK, FAINT = (255, 255, 255), (28, 30, 36), (98, 104, 118)
UP = np.array([0.0, 0.0, 1.0])


def look(scene: ds.Scene) -> ds.View:
    """The room, with the table before the sofa."""
    size = (FINER * SIZE[0], FINER * SIZE[1])
    return looking_at(np.array([-1.45, 0.3, 1.55]), np.array([0.35, 0.1, 0.6]), UP, size, 42.0)


def find(scene: ds.Scene) -> np.ndarray:
    """Several words at once, each with its box."""
    view, found = look(scene), [(text, scene.locate(text)) for text in ASKED]
    chosen = np.zeros((len(scene.gaussians), 1), np.float32)
    marks = []
    for (text, matches), color in zip(found, class_colors(len(found)), strict=True):
        for match in matches[:1]:
            chosen[match.gaussian_ids] = 1
            marks.append(Mark(text, match.center, match.extent, match.axes, tuple(color.tolist())))
    drawn = render(scene.gaussians, view, values=chosen, splats=scene.splats)
    return marked(highlighted(as_pixels(drawn.rgb), drawn.channels[..., 0]), view, marks)


def listed(scene: ds.Scene) -> np.ndarray:
    """The objects that photos agree on, each in a colour, with the names that the encoder is sure of."""
    view, ids = look(scene), scene.object_ids()
    ids = np.where(np.isin(ids, np.flatnonzero(scene.agreed)), ids, -1)
    inside, colors = ids >= 0, class_colors(int(ids.max()) + 1)
    values = np.zeros((len(ids), 4), np.float32)
    values[inside, :3], values[inside, 3] = colors[ids[inside]], 1
    drawn = render(scene.gaussians, view, values=values, splats=scene.splats)
    plain = as_pixels(drawn.rgb)
    colored = tinted(plain, drawn.channels[..., :3], drawn.channels[..., 3])
    names = dict(enumerate(scene.object_names()))
    marks = [
        Mark(str(names[number]), match.center, color=tuple(((255 + colors[number].astype(int)) // 2).tolist()))
        for number, match in enumerate(scene.objects) if names[number] in NAMED and scene.agreed[number]
    ]  # fmt: skip
    return marked(np.asarray(plain * (1 - TINT) + colored * TINT).astype(np.uint8), view, marks)


def change(scene: ds.Scene) -> np.ndarray:
    """Left the scene as it is, right with another sofa, without the apple, and with two ducks of another colour."""
    rows = {text: Rows.of(scene.locate(text)[0].gaussian_ids, "query", text) for text in ("couch", "apple", "toy duck")}
    edits = [
        Edit(rows["couch"], Recolour((0.13, 0.42, 0.72))), Edit(rows["apple"], Remove()),
        Edit(rows["toy duck"], Recolour((0.95, 0.75, 0.1))), Edit(rows["toy duck"], Duplicate((-0.18, -0.1, 0.0))),
    ]  # fmt: skip
    view = look(scene)
    left, right = (as_pixels(render(one, view).rgb) for one in (scene.gaussians, edited(scene.gaussians, edits)))
    middle, half = round(WIPE * view.width), FINER
    both = np.concatenate([left[:, :middle], right[:, middle:]], axis=1)
    both[:, middle - half : middle + half] = PAPER
    return both


def card(picture: Image.Image) -> Image.Image:
    """The name and what it is on the left, a picture on the right."""
    made = Image.new("RGB", CARD, PAPER)
    width, height = CARD[0] * 3 // 5, CARD[1]
    large = picture.resize((round(picture.width * height / picture.height), height), Image.Resampling.LANCZOS)
    left = (large.width - width) * 3 // 4
    made.paste(large.crop((left, 0, left + width, height)), (CARD[0] - width, 0))
    pen, lines = ImageDraw.Draw(made), textwrap.wrap(SAID, 20)
    pen.text((MARGIN, 170), "drsplat", INK, ImageFont.load_default(84))
    pen.multiline_text((MARGIN, 300), "\n".join(lines), FAINT, ImageFont.load_default(38), spacing=14)
    return made


def overview(scene: ds.Scene) -> np.ndarray:
    """What `drsplat demo` draws: two photos, and the answers to its queries."""
    return np.asarray(Image.open(scene.path.parent / OVERVIEW).convert("RGB"))


def objects(scene: ds.Scene) -> np.ndarray:
    """Cards of the objects that photos agree on, as `drsplat objects --picture` draws them."""
    agreed = np.flatnonzero(scene.agreed)
    names = scene.object_names()
    return object_sheet(scene, [scene.objects[number] for number in agreed], [names[number] for number in agreed])


def parts(scene: ds.Scene) -> np.ndarray:
    """Splats that `drsplat objects --save FOLDER` writes, each alone on paper: the largest that are no furniture."""
    names = scene.object_names()
    chosen = [
        number for number, match in enumerate(scene.objects)
        if scene.agreed[number] and names[number] and match.extent.max() < MAX_PART_SIZE
    ][:PARTS]  # fmt: skip
    cells = [part(scene, scene.objects[number], str(names[number])) for number in chosen]
    rows = [cells[begin : begin + PART_COLUMNS] for begin in range(0, len(cells), PART_COLUMNS)]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def part(scene: ds.Scene, match: ds.Match, name: str) -> np.ndarray:
    """One object from above its front, with its name."""
    eye = match.center + PART_AWAY * float(match.extent.max()) * np.array([-0.6, -0.6, 0.5])
    view = looking_at(eye, match.center, UP, (PART_SIZE, PART_SIZE), 42.0)
    drawn = render(scene.gaussians.subset(match.gaussian_ids), view)
    made = Image.fromarray(as_pixels(drawn.rgb + (1 - drawn.alpha[..., None])))
    ImageDraw.Draw(made).text((8, PART_SIZE - 26), name, INK, ImageFont.load_default(16))
    return np.asarray(made)


def attributes(scene: ds.Scene) -> np.ndarray:
    """One vase, and how well some words fit, as `drsplat render --attributes` draws it."""
    return attribute_row(scene, scene.locate("vase")[0], ATTRIBUTES)


def film(scene: ds.Scene) -> np.ndarray:
    """Four pictures of a film, as `drsplat render --path orbit --query "red vase" --boxes` makes it."""
    path = path_named(ORBIT, scene.gaussians, scene.views)
    views = planned(path, views=scene.views, fps=FILM_FPS, size=(2 * FILM_SIZE[0], 2 * FILM_SIZE[1])).views
    answer = Highlight.of(scene, ds.Query("red vase"), boxes=True)
    pictures = list(islice(Film(scene.gaussians, views, FILM_FPS, answer).pictures(), max(FILM_FRAMES) + 1))
    gap = np.full((2 * FILM_SIZE[1], 2 * FILM_GAP, 3), PAPER, np.uint8)
    row = [part for number in FILM_FRAMES for part in (pictures[number], gap)]
    return np.concatenate(row[:-1], axis=1)


DRAWN: dict[str, Callable[[ds.Scene], np.ndarray]] = {
    "demo": overview, "objects": objects, "parts": parts, "attributes": attributes, "film": film,
}  # fmt: skip


def smaller(picture: Image.Image, width: int | None) -> Image.Image:
    """The picture with another width and its own shape."""
    if width is None:
        return picture
    return picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)


def main(arguments: list[str]) -> int:
    scene = ds.open_scene(arguments[0])
    folder = Path(arguments[1]) if len(arguments) > 1 else ROOT / "docs/images"
    for name, draw in (("use_find", find), ("use_list", listed), ("use_change", change)):
        picture = Image.fromarray(draw(scene)).reduce(FINER)
        picture.save(folder / f"{name}.jpg", quality=QUALITY, optimize=True)
        if draw is find:
            card(picture).save(folder / "card.png", optimize=True)
    for name, draw in DRAWN.items():
        picture = smaller(Image.fromarray(draw(scene)), WIDTHS.get(name))
        picture.save(folder / f"{name}.jpg", quality=QUALITY, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
