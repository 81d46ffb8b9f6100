"""The demo's scene without its photos: photographed, cut, embedded, registered, and asked as its photos are."""

import numpy as np
import pytest

from command_line import answer_of
from drsplat import Scene, load_field
from drsplat.evaluation.demo.story import PROBES, SCENE, _Judge, read_household
from drsplat.scene.gaussians import size_of

AS_MANY = 3  # questions that renderings may answer wrongly and photos rightly


@pytest.mark.slow
def test_renderings_answer_what_photos_answer(household_story, household_folder, tmp_path, capsys):
    scene, capture, field = household_folder / SCENE, tmp_path / "capture", tmp_path / "room.field"
    made = answer_of(capsys, "photograph", scene, "-o", capture, "--size", "480x360", "--number", 40)
    assert (made["kind"], made["up"], made["num_pictures"]) == ("room", "+z", 40)
    assert made["coverage"]["often"] > 0.9
    answer_of(capsys, "embed", capture, "--segmenter", "graph", "--encoder", "drsplat-mini")
    answer_of(capsys, "register", scene, capture, "--features", capture / "language_features", "-o", field)
    listed = answer_of(capsys, "objects", field, "--scene", scene)
    assert (listed["pictures"], listed["num_agreed"] > 8) == ("renderings", True)

    story = household_story
    asked = Scene(load_field(field), story.gaussians)
    judge = _Judge(asked, story.splats, read_household(household_folder), story.held_out)
    verdicts = judge.verdicts([judge.verdict_of(probe) for probe in PROBES])
    right, with_photos = sum(one.is_right for one in verdicts), sum(one.is_right for one in story.verdicts)
    assert right >= with_photos - AS_MANY

    near = 0.05 * size_of(story.gaussians.means)
    for ours, theirs in zip(verdicts, story.verdicts, strict=True):
        if ours.is_right and theirs.is_right and theirs.found:
            found = answer_of(capsys, "locate", field, ours.probe.text, "--scene", scene)["matches"]
            centers = np.array([match["center"] for match in found])
            assert np.linalg.norm(centers - theirs.center, axis=1).min() < near, ours.probe.text
