"""Sentences that name two things, in the room of the tests of relations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from test_objects_relations import THINGS, UP, room  # noqa: F401

from drsplat import EncoderIdentity, Query, Scene, View
from drsplat.field import build_field
from drsplat.field.codes import Mixture
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.objects.finding import find_objects
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.photos.models.word_list import broad_list
from drsplat.query.sentences import Sentence, parsed
from refusing import refused

WORDS = ("table", "bowl", "apple", "mug", "plate", "lamp", "chair")
LISTED = (*WORDS, *(f"other {n}" for n in range(17)))


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("red mug", ("red mug",)),
        ("mug, not red", ("mug, not red",)),
        ("The mug on the table?", ("mug", "on", ("table",))),
        ("mug on top of my table", ("mug", "on", ("table",))),
        ("the mug that is standing on the table", ("mug", "on", ("table",))),
        ("how many mugs are on the table?", ("mugs", "on", ("table",))),
        ("how many mugs are there", ("mugs",)),
        ("How many mugs are there in this room?", ("mugs",)),
        ("the number of books", ("books",)),
        ("count the chairs in the room", ("chairs",)),
        ("two teddy bears", ("teddy bears",)),
        ("where is the mug?", ("mug",)),
        ("book that is not red", ("book, not red",)),
        ("the ball under the chair, not red", ("ball, not red", "under", ("chair",))),
        ("what is on the table?", ("", "on", ("table",))),
        ("What's on the table?", ("", "on", ("table",))),
        ("everything in the box", ("", "in", ("box",))),
        ("on the table", ("", "on", ("table",))),
        ("pot near the stove", ("pot", "next_to", ("stove",))),
        ("vase to the left of the lamp", ("vase", "left_of", ("lamp",))),
        ("vase right of the lamp", ("vase", "right_of", ("lamp",))),
        ("book between the lamp and the red vase", ("book", "between", ("lamp", "red vase"))),
        ("rug underneath the table", ("rug", "under", ("table",))),
        ("lamp over the desk", ("lamp", "above", ("desk",))),
        ("woman in red", ("woman in red",)),
        ("something to sit on", ("something to sit on",)),
        ("a photo of a mug", ("a photo of a mug",)),
        ("drink from the mug", ("drink from the mug",)),
        ("built-in oven", ("built-in oven",)),
        ("over ear headphones", ("over ear headphones",)),
    ],
)
def test_what_is_understood(said, meant):
    assert parsed(said) == Sentence(*meant)


def test_no_name_of_the_list_is_a_sentence():
    assert [name for name in broad_list() if parsed(name).text != name or parsed(name).relation] == []


@pytest.mark.parametrize(
    "said", ["mug behind the laptop", "cup in front of the box", "the largest book", "book between the lamps"]
)
def test_what_is_not_understood_is_refused(said):
    with refused("expected"):
        parsed(said)


@pytest.fixture(scope="module")
def scene(room) -> Scene:  # noqa: F811
    """Each thing is called by the last word of its name but "chair below" and the like, which are chairs."""
    gaussians, _ = room
    things = list(THINGS)
    owner = np.repeat(np.arange(len(things)), [len(points) for points in THINGS.values()]).astype(np.int32)
    weights = csr_array(
        (np.ones(len(owner), np.float32), (np.arange(len(owner)), owner)), shape=(len(owner), len(things))
    )
    masks = MaskIds(("a.jpg",), np.zeros(len(things), np.int32), np.arange(len(things), dtype=np.int32))
    vectors = np.eye(len(LISTED), dtype=np.float32)
    named = [LISTED.index(name.split()[0]) for name in things]
    encoder = VocabularyEncoder(EncoderIdentity("made-up", len(LISTED)), LISTED, vectors)
    field = build_field(Evidence(weights, masks, vectors[named]), gaussians.fingerprint, encoder.identity, Mixture(1))
    field = replace(field, up=UP)
    K = np.array([[100.0, 0, 100], [0, 100, 100], [0, 0, 1]])
    pose = np.array([[1.0, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 6], [0, 0, 0, 1]])  # from the south, up is up
    views = [View("south.jpg", K, pose, 200, 200)]
    field = field.with_objects(find_objects(field, gaussians))
    return Scene(field, gaussians, views, encoder)


def found(scene: Scene, text: str) -> set[str]:
    ends = np.cumsum([len(points) for points in THINGS.values()])
    middles = [int(np.median(match.gaussian_ids)) for match in scene.locate(text)]
    return {list(THINGS)[int(np.searchsorted(ends, middle, "right"))] for middle in middles}


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("mug on the table", {"mug"}),
        ("lamp on the table", set()),
        ("chair under the table", {"chair below"}),
        ("chair next to the table", {"chair below", "chair beside"}),
        ("apple in the bowl", {"apple"}),
        ("mug in the bowl", set()),
        ("lamp above the table", {"lamp"}),
        ("mug between the plate and the bowl", {"mug"}),
        ("what is on the table?", {"bowl", "mug", "plate", "apple"}),
        ("plate left of the mug", {"plate"}),
        ("plate right of the mug", set()),
        ("how many chairs are there?", {"chair below", "chair beside", "chair far away"}),
    ],
)
def test_what_is_found(said, meant, scene):
    text = said.replace("chairs", "chair")  # this vocabulary has no plurals
    assert found(scene, text) == meant
    assert sum(match.sure for match in scene.locate(text)) == len(meant)


def test_sides_are_those_of_a_photo_that_is_named(scene):
    assert scene.ask("plate left of the mug").seen_from == "south.jpg"
    assert scene.ask("mug on the table").seen_from == ""


def test_nothing_lies_on_what_is_not_there(scene):
    answer = scene.ask("mug on the other 3")
    assert not len(answer.gaussian_ids)
    assert answer.doubt == "no match for 'other 3', so nothing can be on it"


def test_without_up_only_sides_can_be_told(scene):
    lying = Scene(replace(scene.field, up=None), scene.gaussians, [], scene.encoder)
    with refused("which way is up"):
        lying.ask("mug on the table")


def test_a_text_of_a_vocabulary_stands_for_itself(scene):
    vectors = np.eye(len(LISTED), dtype=np.float32)
    texts = ("mug on the table", *LISTED[1:])
    encoder = VocabularyEncoder(scene.field.encoder, texts, vectors)
    own = Scene(scene.field, scene.gaussians, scene.views, encoder)
    assert found(own, "mug on the table") == {"table"}  # whose vector it has here


def test_the_rest_of_the_query_stays(scene):
    assert len(scene.ask(Query("mug on the table", threshold=2.0)).gaussian_ids) == 0
