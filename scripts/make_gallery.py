"""The gallery: a page of the demo's scene and of each of world/scenes/ that runs in a browser, and a picture of it.

usage: python make_gallery.py FOLDER [SCENE...]    SCENE: demo, or a folder of world/scenes/; all without one

Masks and embeddings are made by what is built in, from all photos but those held out; the queries are what these show
most of, and one thing that is not there. FOLDER gets NAME.html, NAME.jpg and gallery.json, which the site's page is
made of (site_pages.py). Scenes that are there already are left as they are, unless the package is newer than they are.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import drsplat as ds
from drsplat.drawing.heat import class_colors
from drsplat.drawing.labels import Mark, marked
from drsplat.field.objects.finding import find_objects
from drsplat.fronts.viewing.page import PageAnswer
from drsplat.photos.embedding.embed import embed
from drsplat.photos.models.graph import GraphSegmenter

ROOT = Path(__file__).resolve().parent.parent
SCENES = {"demo": ROOT / "src/drsplat/evaluation/demo/scene"} | {
    path.parent.name: path.parent for path in sorted((ROOT / "world/scenes").glob("*/truth.json"))
}
MOST_GAUSSIANS = 50_000  # of a page: two and a half megabytes
NUM_QUERIES, ABSENT = 5, ("laptop", "teddy bear", "basket")
WIDTH = 800  # pixels of a picture at most
LIST = "gallery.json"


@dataclass(frozen=True)
class Truth:
    """categories: of objects, by id. held_out: names of photos."""

    categories: dict[int, str]
    held_out: frozenset[str]


def read_truth(folder: Path) -> Truth:
    document = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    categories = {one["id"]: one["category"] for one in document["objects"]}
    return Truth(categories, frozenset(document["held_out"]))


def queries_of(folder: Path, truth: Truth) -> list[str]:
    """The categories that most pixels of the held-out photos show, and one that is not in the room."""
    pixels: dict[str, int] = {}
    for path in sorted((folder / "ids").glob("*.png")):
        numbers, counts = np.unique(np.asarray(Image.open(path)).astype(int) - 1, return_counts=True)
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            if number in truth.categories:
                name = truth.categories[number]
                pixels[name] = pixels.get(name, 0) + count
    most = sorted(pixels, key=lambda name: (-pixels[name], name))[:NUM_QUERIES]
    absent = next(word for word in ABSENT if not any(word in name for name in truth.categories.values()))
    return [*most, absent]


def registered(folder: Path, truth: Truth, place: Path) -> ds.Scene:
    """The scene of a packed folder with a field of its photos. place: for what is made on the way."""
    views = [view for view in ds.read_views(folder) if view.name not in truth.held_out]
    gaussians = ds.read_gaussians(folder / "scene.compressed.ply")
    encoder = ds.MiniEncoder()
    embed(views, place / "features", GraphSegmenter(), encoder)
    features = ds.read_features(place / "features", level="large", encoder=encoder.identity)
    field = ds.register(gaussians, views, features).to_field()
    return ds.Scene(field.with_objects(find_objects(field, gaussians)), gaussians, views, encoder, name=folder.name)


def entry(name: str, scene: ds.Scene, queries: list[str], folder: Path) -> dict[str, Any]:
    """Write NAME.html and NAME.jpg; returns what the gallery says of them."""
    place, picture = folder / f"{name}.html", folder / f"{name}.jpg"
    page = ds.export_page(place, scene, queries, max_gaussians=MOST_GAUSSIANS, title=name, overwrite=True)
    drawn = Image.fromarray(picture_of(scene, page.answers))
    drawn.thumbnail((WIDTH, WIDTH))
    drawn.save(picture, quality=82)
    return {
        "name": name, "matches": {answer.text: len(answer.matches) for answer in page.answers},
        "num_gaussians": len(scene.gaussians), "num_shown": len(page.shown), "num_photos": len(scene.views),
        "page_bytes": place.stat().st_size,
    }  # fmt: skip


def picture_of(scene: ds.Scene, answers: Sequence[PageAnswer]) -> np.ndarray:
    """The rendering that shows most of what was found, with a box around the best match of each query."""
    found = [match for answer in answers for match in answer.matches]
    view = scene.best_view(np.unique(np.concatenate([match.gaussian_ids for match in found])) if found else None)
    marks = [
        Mark(answer.text, match.center, match.extent, match.axes, tuple(color.tolist()))
        for answer, color in zip(answers, class_colors(len(answers)), strict=True)
        for match in answer.matches[:1]
    ]
    return marked(scene.picture(view), view, marks)


def make(name: str, folder: Path) -> dict[str, Any]:
    source = SCENES[name]
    truth = read_truth(source)
    with tempfile.TemporaryDirectory() as place:
        return entry(name, registered(source, truth, Path(place)), queries_of(source, truth), folder)


def read_list(folder: Path) -> list[dict[str, Any]]:
    """What the gallery of a folder has; nothing where none has been made."""
    path = folder / LIST
    made: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return [one for one in made if (folder / f"{one['name']}.html").exists()]


def is_older(page: Path, package: Path) -> bool:
    """Whether any file of a package was changed after a page was made."""
    files = [path for path in package.rglob("*") if path.is_file() and path.parent.name != "__pycache__"]
    return page.stat().st_mtime < max(path.stat().st_mtime for path in files)


def as_text(made: list[dict[str, Any]]) -> str:
    return json.dumps(made, indent=1) + "\n"


def main(arguments: list[str]) -> int:
    folder, names = Path(arguments[0]), arguments[1:] or list(SCENES)
    folder.mkdir(parents=True, exist_ok=True)
    made = {one["name"]: one for one in read_list(folder)}
    for name in names:
        if name not in made or is_older(folder / f"{name}.html", ROOT / "src/drsplat"):
            made[name] = make(name, folder)
            (folder / LIST).write_text(as_text([made[each] for each in SCENES if each in made]), encoding="utf-8")
        one = made[name]
        print(f"{name}: {one['num_shown']:,} Gaussians, {one['page_bytes'] / 1e6:.1f} MB, {one['matches']}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
