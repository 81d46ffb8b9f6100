"""What a catalogue of the demo's room answers, by descriptors and a sketch, and what the room does by its Gaussians."""

import pytest

from drsplat import Scene, open_scene
from drsplat.errors import DrSplatWarning
from drsplat.query.catalogue import Catalogue
from drsplat.query.objects import object_of

pytestmark = pytest.mark.slow
WORDS = ("apple", "candle", "plant", "sofa", "table", "toy car", "toy duck", "red vase", "orange sofa", "green toy car")
MANY = (
    *WORDS, "banana", "book", "bookcase", "bottle", "bowl", "box", "carrot", "chair", "clock", "couch", "cup", "duck",
    "floor", "fork", "furniture", "green cup", "knife", "lamp", "laptop", "mug", "pillow", "plate", "shelf", "spoon",
    "something to eat", "stool", "teddy bear", "toys", "vase", "wall", "white lamp", "window", "brown table",
)  # fmt: skip
NOTHING = ("banana", "basket", "book", "bread", "chair", "cushion", "pan", "teapot", "teddy bear")


def test_the_best_object_is_mostly_that_of_the_room(household_story, household_folder, tmp_path):
    room = open_scene(household_folder)
    catalogue = Catalogue.open(tmp_path / "c")
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        catalogue.add(Scene(room.field, room.gaussians, name="room"))
    best = {word: room.locate(word) for word in (*WORDS, *NOTHING)}
    there = {word: object_of(room.field, matches[0]) for word, matches in best.items() if matches}
    same = [catalogue.ask(word, top=1)[0].object_id == number for word, number in there.items() if catalogue.ask(word)]
    assert len(there) >= 7
    assert sum(same) >= 0.75 * len(there)
    absent = [word for word in NOTHING if word not in there]
    assert len(absent) >= 5
    assert sum(not catalogue.ask(word) for word in absent) >= 0.75 * len(absent)


def test_nothing_is_answered_that_the_room_does_not_answer_with(household_story, household_folder, tmp_path):
    room = open_scene(household_folder)
    catalogue = Catalogue.open(tmp_path / "c")
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        catalogue.add(Scene(room.field, room.gaussians, name="room"))
    own = {word: {match.object_id for match in room.locate(word)} for word in MANY}
    here = {word: {entry.object_id for entry in catalogue.ask(word, top=100)} for word in MANY}
    assert {word: here[word] - own[word] for word in MANY if here[word] - own[word]} == {}
    assert sum(bool(here[word]) for word in WORDS) >= 7
