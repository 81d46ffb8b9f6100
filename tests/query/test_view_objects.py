"""Objects in the viewer, without a browser: clicked, made smaller and larger, coloured and named."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import write_gaussians
from drsplat.drawing.heat import class_colors
from drsplat.field.labels import LabelFile
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from drsplat.fronts.viewing import painting
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.query import Scene, open_scene
from drsplat.query.nodes import Chosen, chosen_at, name_of
from drsplat.query.query import Query
from known_objects import CENTERS, EACH, with_objects
from refusing import refused
from viewing_scenes import CENTERS as PLACES
from viewing_scenes import THINGS, boxes_scene

DOWN = np.array([0.0, 0.0, -1.0])
FIRST, SECOND, THIRD, PAIR = 2, 3, 4, 5  # nodes; 0 and 1 are parts of the first


@pytest.fixture
def session(tmp_path) -> Session:
    field, gaussians = with_objects()
    return Session(Scene(field, gaussians, labels=LabelFile.beside(tmp_path / "a.field")))


def rows(*things: int) -> np.ndarray:
    ids = np.concatenate([np.arange(one * EACH, (one + 1) * EACH) for one in things])
    return ids[ids < 3 * EACH - 10]  # the last ten have no feature


def click(session: Session, center: tuple[float, float, float]) -> None:
    """From above on the Gaussian nearest to a place."""
    positions = session.scene.gaussians.positions
    below = positions[np.linalg.norm(positions - center, axis=1).argmin()]
    session.click(session.shown.frame.shown(np.array([*below[:2], 5.0])), DOWN)


def worded() -> Session:
    """A scene that answers words, whose three things are objects, the first of two parts."""
    scene = boxes_scene()
    thing, half = np.divmod(scene.field.gaussian_ids.astype(np.int64), 300)
    node_of = np.where(thing == 0, half // 150, thing + 2).astype(np.int32)
    parents, levels = np.int32([2, 2, -1, -1, -1]), np.uint8([0, 0, 1, 1, 1])
    found = describe(scene.field, scene.gaussians, Tree(node_of, parents, levels, np.ones(5, np.float32)))
    return Session(Scene(scene.field.with_objects(found), scene.gaussians, scene.views, scene.encoder), words=THINGS)


# --- a click ---


def test_a_click_selects_the_thing_that_asking_finds_there(session):
    for number, center in enumerate(CENTERS):
        click(session, center)
        asked = session.scene.ask(Query(point=tuple(session.clicked.point.tolist())))
        assert_array_equal(session.selection, rows(number))
        assert_array_equal(session.selection, asked.gaussian_ids)
        assert session.mode is Mode.ANSWER
        assert session.summary == f"object {number}: 1 match, {len(rows(number))} Gaussians"
        assert [match.object_id for match in session.results[0].matches] == [number]


def test_of_what_a_ray_meets_the_thing_that_is_most_seen_is_chosen(session):
    ids, weights = np.array([EACH, 0, 1]), np.array([0.4, 0.3, 0.3])
    chosen = chosen_at(session.scene, ids, weights)
    assert chosen.node == FIRST


def test_a_click_on_what_is_in_no_object_selects_what_is_like_it(session):
    field, gaussians = session.scene.field, session.scene.gaussians
    third = field.gaussian_ids >= 2 * EACH
    loose = replace(field.objects, node_of=np.where(third, -1, field.objects.node_of).astype(np.int32))
    other = Session(Scene(field.with_objects(loose), gaussians))
    click(other, CENTERS[2])
    assert other.chosen is None
    assert other.results[0].label == "like this"
    assert_array_equal(other.selection, rows(2))
    with refused("no object is selected"):
        other.larger()


def test_a_click_into_the_air_chooses_nothing_and_keeps_the_selection(session):
    click(session, CENTERS[0])
    session.click(np.array([0.0, 0, 500]), -DOWN)
    assert session.chosen is None
    assert_array_equal(session.selection, rows(0))


def test_without_objects_a_click_selects_nothing():
    plain = Session(boxes_scene(), words=THINGS)
    click(plain, PLACES[2])
    assert plain.clicked is not None
    assert plain.chosen is None
    assert plain.results == ()
    assert not plain.has_objects
    assert Mode.OBJECTS not in plain.modes
    for press in (plain.smaller, plain.larger, lambda: plain.name("mug")):
        with refused("object"):
            press()
    assert plain.mode is Mode.SCENE


# --- smaller and larger ---


def test_smaller_and_larger_go_the_way_of_the_click(session):
    click(session, CENTERS[0])
    session.larger()
    assert_array_equal(session.selection, rows(0, 1))
    assert session.results[0].label == "group of 2 objects"
    with refused("nothing larger"):
        session.larger()
    session.smaller()
    assert_array_equal(session.selection, rows(0))
    session.smaller()
    half = session.clicked.gaussian_id // (EACH // 2)
    assert_array_equal(session.selection, np.arange(half * EACH // 2, (half + 1) * EACH // 2))
    assert session.results[0].label == "part of object 0"
    with refused("nothing smaller"):
        session.smaller()
    session.larger()
    assert_array_equal(session.selection, rows(0))


def test_where_the_way_ends_the_heaviest_part_is_smaller(session):
    objects = session.scene.field.objects
    assert objects is not None
    heavy = replace(objects, masses=np.float32([1, 2, 9, 8, 7, 6]))
    smaller = Chosen((FIRST, PAIR), 0).smaller(heavy)
    assert smaller == Chosen((1, FIRST, PAIR), 0)
    assert smaller.larger() == Chosen((1, FIRST, PAIR), 1)


def test_a_new_query_lets_go_of_the_object():
    session = worded()
    click(session, PLACES[2])
    assert session.chosen is not None
    session.ask("red mug")
    assert session.chosen is None
    with refused("no object is selected"):
        session.smaller()


# --- names ---


def test_a_thing_is_called_by_its_label_else_its_best_word_else_its_number(session):
    spoken = worded()
    click(spoken, PLACES[2])
    assert spoken.results[0].label == "tall lamp"
    assert name_of(session.scene, THIRD) == "object 2"
    session.scene.label(THIRD, "my lamp")
    assert name_of(session.scene, THIRD) == "my lamp"


def test_a_name_is_kept_shown_and_answers(session):
    click(session, CENTERS[0])
    session.larger()
    session.name(" the pair ")
    assert session.results[0].label == "the pair"
    assert session.chosen.node == PAIR
    assert_array_equal(session.scene.ask("THE PAIR").gaussian_ids, rows(0, 1))
    assert [label.name for label in session.scene.label_file.read()] == ["the pair"]
    with refused("1 to 200"):
        session.name("  ")
    assert session.results[0].label == "the pair"


def test_where_nothing_can_be_kept_no_name_is_offered(tmp_path):
    field, gaussians = with_objects()
    session = Session(Scene(field, gaussians))
    assert not session.can_name
    click(session, CENTERS[0])
    with refused("nowhere to keep"):
        session.name("mug")
    field.save(tmp_path / "a.field")
    write_gaussians(tmp_path / "a.ply", gaussians)
    assert Session(open_scene(tmp_path / "a.field", scene=tmp_path / "a.ply")).can_name


# --- all objects ---


def test_all_objects_are_coloured_by_their_numbers(session):
    before = session.colors.copy()
    session.mode = Mode.OBJECTS
    colors = session.colors
    for number, hue in enumerate(painting.object_colors(3)):
        plain = before[rows(number)]
        shade = 0.35 + 0.65 * plain @ painting.LUMA
        assert_allclose(colors[rows(number)], 0.58 * plain + 0.42 * shade[:, None] * hue, atol=1e-6)
    assert_array_equal(colors[-10:], colors[-10:, :1].repeat(3, axis=1))  # in no object: grey


def test_however_many_things_no_two_have_one_colour():
    assert len(np.unique(class_colors(1000), axis=0)) == 1000
    assert len(np.unique(painting.object_colors(1000), axis=0)) == 1000


def test_a_click_among_all_colours_keeps_them(session):
    session.mode = Mode.OBJECTS
    click(session, CENTERS[1])
    assert session.mode is Mode.OBJECTS
    assert [result.label for result in session.results] == ["object 1"]
    assert_array_equal(session.selection, rows(1))
