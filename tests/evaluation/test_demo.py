"""The demo: the scene that ships, its truth, its answers, its pictures and page."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from drsplat import Scene, read_features, read_views
from drsplat.drawing.pictures import visible_share
from drsplat.errors import InputError
from drsplat.evaluation.demo.story import PROBES, Verdict, note, read_household, tell, unpack_household, write_album

SHIPPED = Path(__file__).parents[2] / "src/drsplat/evaluation/demo/scene"


def test_the_scene_is_small():
    assert (SHIPPED / "scene.compressed.ply").stat().st_size <= 5_000_000
    assert sum(file.stat().st_size for file in SHIPPED.rglob("*") if file.is_file()) < 8_000_000


def test_no_model_has_learned_from_the_scene():
    assert json.loads((SHIPPED / "truth.json").read_text())["split"] == "test"


FULL = """
import resource, sys
from drsplat.cli import main
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
sys.exit(main(["demo", "--output-dir", sys.argv[1]]))
"""


def test_a_full_disk_is_told_in_one_sentence(tmp_path):
    ran = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "room")], capture_output=True, text=True, check=False
    )  # fmt: skip
    (line,) = ran.stderr.splitlines()
    assert ran.returncode == 1
    assert line.startswith(f"drsplat: error: {tmp_path / 'room'}")
    assert "there is no room left to write it" in line
    assert "[" not in line
    assert not list((tmp_path / "room").rglob("*.tmp"))


def test_every_question_is_about_things_in_the_room_or_about_none():
    categories = set(read_household(SHIPPED).categories.values())
    assert len(PROBES) >= 12
    assert all(set(probe.meant) <= categories for probe in PROBES)
    assert sum(not probe.meant for probe in PROBES) >= 2
    names = {category.split()[-1] for category in categories}
    absent = [probe.text.split()[-1] for probe in PROBES if not probe.meant]
    assert not names & set(absent)


def test_masks_of_the_truth_are_the_ids():
    household = read_household(SHIPPED)
    view = household.held_out[0]
    ids = np.asarray(Image.open(SHIPPED / "ids" / Path(view).with_suffix(".png").name)).astype(np.int32) - 1
    assert_array_equal(household.ids(view), ids)
    number = {category: k for k, category in household.categories.items()}
    vase, both = number["red vase"], {"red vase", "brown table"}
    assert (ids == vase).sum() > 1000
    assert_array_equal(household.mask(ids, {"red vase"}), ids == vase)
    assert_array_equal(household.mask(ids, both), np.isin(ids, [number[name] for name in both]))
    assert not household.mask(ids, ()).any()


def test_most_answers_are_right(household_story):
    answers = household_story.verdicts
    assert [answer.probe for answer in answers] == list(PROBES)
    asked = [answer for answer in answers if answer.probe.meant]
    assert sum(answer.is_right for answer in answers) >= 10
    assert sum(answer.is_right for answer in asked) / len(asked) > 0.6
    right = [answer for answer in asked if answer.is_right]
    assert all(answer.iou is not None and answer.iou > 0.5 for answer in right)


def test_centres_are_where_the_things_are(household_story, household_folder):
    known = json.loads((household_folder / "truth.json").read_text())["objects"]
    centers = {thing["category"]: np.array(thing["center"]) for thing in known}
    vase = next(a for a in household_story.verdicts if a.probe.text == "red vase")
    assert vase.center is not None
    assert np.linalg.norm(vase.center - centers["red vase"]) < 0.1  # metres


def test_held_out_photos_were_not_registered(household_story, household_folder):
    held_out = {view.name for view in household_story.held_out}
    assert held_out == set(read_household(household_folder).held_out)
    assert len(held_out) == 6
    evidence = household_story.field.evidence
    assert not held_out & set(evidence.masks.view_names)
    assert len(household_story.views) + len(held_out) == len(read_views(household_folder))
    masked = set(read_features(household_folder / "language_features"))
    assert not masked & {Path(name).stem for name in held_out}


def test_iou_is_over_the_pixels_of_the_held_out_photos(household_story, household_folder):
    answer = next(a for a in household_story.verdicts if a.probe.text == "toy duck")
    household, both, either = read_household(household_folder), 0, 0
    for view in household_story.held_out:
        truth = household.mask(household.ids(view.name), answer.probe.meant)
        seen = visible_share(household_story.gaussians, view, answer.gaussian_ids) > 0.5
        both, either = both + (truth & seen).sum(), either + (truth | seen).sum()
    assert answer.iou == pytest.approx(both / either)


def made_up(answer: Verdict, iou: float | None, places: int) -> Verdict:
    return replace(answer, iou=iou, num_matches=places, count=places)


def test_misses_are_told_as_misses(household_story):
    present, absent = household_story.verdicts[0], household_story.verdicts[-1]
    assert (made_up(present, 0.8, 1).is_right, note(made_up(present, 0.8, 1))) == (True, "1 match, IoU 0.80")
    assert note(made_up(present, 0.2, 2)) == "miss: 2 matches, IoU 0.20"
    assert note(replace(made_up(present, 0.8, 7), count=1)) == "7 matches, 1 sure, IoU 0.80"
    assert not made_up(present, 0.0, 0).is_right
    assert note(made_up(present, 0.0, 0)).startswith("miss: no match")
    assert made_up(absent, None, 0).is_right
    assert note(made_up(absent, None, 0)).startswith("rightly no match")
    assert not made_up(absent, None, 1).is_right
    assert note(made_up(absent, None, 1)) == "wrong: 1 match, but there is none"


def test_answers_are_judged_by_what_they_are_sure_of(household_story):
    """The floor under a wooden table is wooden as well: one match is sure, and it alone is right."""
    scene = Scene(household_story.field, household_story.gaussians, threads=1)
    table = next(a for a in household_story.verdicts if a.probe.text == "wooden table")
    matches = scene.locate(table.probe.text)
    sure = [match for match in matches if match.sure]
    assert (table.count, table.num_matches) == (len(sure), len(matches))
    assert 0 < len(sure) < len(matches)
    assert_array_equal(table.gaussian_ids, np.sort(np.concatenate([one.gaussian_ids for one in sure])))
    assert len(table.gaussian_ids) + len(table.unsure_ids) == sum(len(one) for one in matches)
    assert table.iou is not None
    assert table.iou > 0.8


@pytest.mark.slow
def test_album_shows_every_answer(household_story, tmp_path):
    paths = write_album(tmp_path, household_story)
    assert [path.name for path in paths[:2]] == ["overview.png", "yellow_apple.png"]
    assert len(paths) == 1 + len(PROBES)
    pictures = {path.stem: np.asarray(Image.open(path), int) for path in paths}
    assert len({picture.shape for name, picture in pictures.items() if name != "overview"}) == 1
    red = pictures["red_vase"]
    assert ((red[..., 0] > 100) & (red[..., 1:].max(-1) < 90)).sum() > 500  # the vase, in its colour


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="overwrite=True"):
        tell(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    unpack_household(tmp_path, overwrite=True)
    assert (tmp_path / "mine.txt").read_text() == "precious"
