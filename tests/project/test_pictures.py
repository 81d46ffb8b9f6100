"""Pictures of the documents are as new as what they show: those of the demo are drawn again, the others have a hash."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from benchmarks import study_edits
from benchmarks.suite import stamps
from PIL import Image
from scripts import make_film, make_pictures, pictures
from scripts.speed_picture import PICTURE

import drsplat as ds
from drsplat.authoring.filming.frames import Highlight
from drsplat.evaluation.demo.story import Story, write_album

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"

DRAWN_AGAIN = {
    "use_find.jpg", "use_list.jpg", "use_change.jpg", "card.png", "demo.jpg", "objects.jpg", "attributes.jpg",
    "parts.jpg", "film.jpg", "tour.jpg",
}  # fmt: skip
SLOWLY, WITH_ITS_STILL = {"edits.jpg"}, {"tour.webp"}
MOST_LEVELS = 1.0  # of 255, in the mean; another answer makes several


def mean_difference(one: Path, other: Path) -> float:
    first, second = (np.asarray(Image.open(path).convert("RGB"), np.float64) for path in (one, other))
    assert first.shape == second.shape, f"{one.name} is {first.shape}, drawn again {second.shape}"
    return float(np.abs(first - second).mean())


@pytest.fixture(scope="module")
def demo(household_story: Story, household_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo under its usual name, with its pictures."""
    folder = tmp_path_factory.mktemp("named") / "drsplat-demo"
    shutil.copytree(household_folder, folder)
    write_album(folder, household_story, overwrite=True)
    return folder


def test_pictures_of_the_demo_are_drawn_again_alike(demo, tmp_path):
    assert make_pictures.main([str(demo), str(tmp_path)]) == 0
    scene = ds.open_scene(demo)
    still = make_film.Film(scene, Highlight.of(scene, ds.Query(make_film.WORDS), boxes=True)).still()
    still.save(tmp_path / "tour.jpg", quality=make_film.STILL_QUALITY, optimize=True)
    assert {path.name for path in tmp_path.iterdir()} == DRAWN_AGAIN
    differences = {name: mean_difference(IMAGES / name, tmp_path / name) for name in sorted(DRAWN_AGAIN)}
    older = {name: round(value, 1) for name, value in differences.items() if value > MOST_LEVELS}
    assert not older, f"{older}: make them again with scripts/make_pictures.py DEMO and scripts/make_film.py DEMO"


@pytest.mark.slow
def test_pictures_of_edits_are_drawn_again_alike(demo, tmp_path):
    study_edits.main([str(demo), str(tmp_path / "edits.jpg"), "--side", "165"])
    assert mean_difference(IMAGES / "edits.jpg", tmp_path / "edits.jpg") < MOST_LEVELS


def test_other_pictures_are_as_new_as_what_they_show():
    assert pictures.older() == {}, "make them again, or look at them; then `python -m scripts.pictures NAME...`"


def test_each_picture_is_held_in_one_way():
    there = {path.name for path in IMAGES.iterdir() if path.suffix in (".jpg", ".png", ".svg", ".webp")}
    ways = [DRAWN_AGAIN, SLOWLY, WITH_ITS_STILL, {PICTURE.name}, set(pictures.MADE)]
    assert there == set().union(*ways)
    assert sum(map(len, ways)) == len(there)
    assert all(path.exists() for made in pictures.MADE.values() for path in made.inputs)


def test_a_picture_becomes_older_by_code_and_not_by_words(tmp_path, monkeypatch):
    source, kept = tmp_path / "draw.py", tmp_path / "made.json"
    source.write_text('def draw():\n    "Draw."\n    return 1\n')
    monkeypatch.setattr(stamps, "ROOT", tmp_path)
    monkeypatch.setattr(pictures, "STAMPS", kept)
    monkeypatch.setattr(pictures, "MADE", {"a.jpg": pictures.Made("draw it", (source,))})
    stamps.stamp.cache_clear()
    assert pictures.main(["a.jpg"]) == 0
    assert pictures.main([]) == 0
    source.write_text('def draw():\n    "Draw with care."  # why\n    return 1\n')
    stamps.stamp.cache_clear()
    assert pictures.main([]) == 0
    source.write_text("def draw():\n    return 2\n")
    stamps.stamp.cache_clear()
    assert pictures.main([]) == 1
    assert pictures.older() == {"a.jpg": "draw it"}
    assert pictures.main(["b.jpg"]) == 2
    stamps.stamp.cache_clear()
