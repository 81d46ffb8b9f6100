"""Which objects photos agree on: the rule, and that every front shows these first and the others behind "more"."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_line import answer_of, error_of, text_of
from drsplat import Scene
from drsplat.errors import DrSplatWarning
from drsplat.field.labels import LabelFile
from drsplat.field.objects.agreed import agreed
from drsplat.fronts.viewing.exporting import page_of
from drsplat.fronts.viewing.session import Session
from drsplat.fronts.viewing.stage import Stage
from known_objects import EACH, with_objects

UP = np.array([0.0, 0.0, 1.0])


def doubted(number: int) -> Scene:
    """Three objects, of which photos hardly agree on one."""
    field, gaussians = with_objects()
    sure = field.objects.sure.copy()
    sure[field.objects.thing(number)] = 0.1
    return Scene(field.with_objects(replace(field.objects, sure=sure)), gaussians)


@pytest.fixture
def a_field(tmp_path: Path) -> Path:
    doubted(1).field.save(tmp_path / "a.field")
    return tmp_path / "a.field"


def test_few_photos_have_to_agree_more_than_many():
    views = np.array([1, 1, 2, 2, 3, 3, 100, 100])
    sure = np.array([0.76, 0.74, 0.51, 0.49, 0.42, 0.41, 0.26, 0.25], np.float32)
    assert agreed(sure, views).tolist() == [True, False] * 4
    assert agreed(sure[:0], views[:0]).shape == (0,)
    assert not agreed(np.ones(1, np.float32), np.zeros(1, np.int32)).any()


def test_what_people_named_is_among_the_agreed(tmp_path):
    scene = doubted(1)
    assert scene.agreed.tolist() == [True, False, True]
    named = Scene(scene.field, scene.gaussians, labels=LabelFile.beside(tmp_path / "a.field"))
    named.label(scene.field.objects.thing(1), "mug")
    assert named.agreed.all()


def test_the_table_has_the_agreed_and_counts_the_others(a_field, capsys):
    text = text_of(capsys, "objects", a_field)
    assert text.startswith(f"2 objects that photos agree on, {2 * EACH - 10:,} of 1,490 registered Gaussians in them")
    assert "and 1 more that photos agree less on: --all lists them" in text
    assert listed_in(text) == ["0", "2"]
    every = text_of(capsys, "objects", a_field, "--all")
    assert every.startswith("3 objects, 1,490 of 1,490 registered Gaussians")
    assert "--all" not in every
    assert listed_in(every) == ["0", "1", "2"]


def listed_in(text: str) -> list[str]:
    return [line.split()[0] for line in text.splitlines()[1:] if line.strip()[:1].isdigit()]


def test_programs_get_all_and_which_are_agreed(a_field, capsys):
    told = answer_of(capsys, "objects", a_field)
    assert (told["num_objects"], told["num_agreed"]) == (3, 2)
    assert [(one["id"], one["agreed"]) for one in told["objects"]] == [(0, True), (1, False), (2, True)]
    assert told["objects"] == answer_of(capsys, "objects", a_field, "--all")["objects"]
    answer_of(capsys, "objects", a_field, "--save", a_field.parent / "o.csv")
    rows = (a_field.parent / "o.csv").read_text().splitlines()
    assert [row.rsplit(",", 1)[1] for row in rows] == ["agreed", "1", "0", "1"]


def test_a_list_of_none(a_field, capsys):
    scene = doubted(1)
    none = replace(scene.field.objects, sure=np.zeros_like(scene.field.objects.sure))
    scene.field.with_objects(none).save(a_field, overwrite=True)
    assert "0 objects that photos agree on" in text_of(capsys, "objects", a_field)
    picture = ("--picture", a_field.parent / "a.png", "--views", a_field)
    assert "--all draws them" in error_of(capsys, "objects", a_field, *picture)


def test_a_page_lists_the_agreed_first_and_finds_each_in_the_picture():
    page = page_of(Stage.of(Session(doubted(0)), UP), [])
    assert [(one["name"], one["unsure"]) for one in page.header["objects"]] == [
        ("object 1", False), ("object 2", False), ("object 0", True),
    ]  # fmt: skip
    assert page.rows["objects"][[0, EACH, 2 * EACH, 3 * EACH - 1]].tolist() == [3, 1, 2, 0]


def test_a_catalogue_counts_them(tmp_path, capsys):
    from drsplat.query.catalogue import Catalogue

    catalogue = Catalogue(tmp_path / "c")
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        added = catalogue.add(doubted(1), name="room")
    assert (added.num_objects, added.num_agreed) == (3, 2)
    assert [(one.num_objects, one.num_agreed) for one in catalogue.scenes()] == [(3, 2)]
    assert text_of(capsys, "catalogue", "list", tmp_path / "c").splitlines()[4].split()[:3] == ["room", "3", "2"]
