"""Queries of scenes that move: over a span of time, where and when, and what changes what it belongs to."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.sparse import csr_array

from drsplat import PQ, Cut, Mixture, Query, Scene, WordEncoder, open_scene, register
from drsplat.field import LanguageField, build_field
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.field.objects.drifting import drifting
from drsplat.field.regrowing import field_during
from drsplat.formats.moving_scenes import write_moving
from drsplat.query.tracks import runs
from drsplat.scene.moving import Frames, Moving
from fields import random_evidence, with_flat_objects
from growing_fields import features, scene, views
from known_objects import TEST
from moving_scenes import label_masks, passing, passing_scene, passing_views, still
from refusing import refused
from scenes import look_at_view, random_gaussians


@lru_cache
def played(objects: bool = False) -> Scene:
    return passing_scene(objects)


CAR = np.arange(100)


def test_a_match_is_followed_through_all_times():
    match = played().locate("red car")[0]
    assert set(match.gaussian_ids) <= set(CAR)
    track = played().tracks([match])[0]
    assert np.array_equal(track.times, played().moving.times)
    steps = np.diff(track.centers, axis=0)
    assert np.allclose(steps, [[0, 0.4, 0]] * 5, atol=1e-3)  # twice 0.2
    assert np.allclose(track.extents, track.extents[0], atol=1e-3)
    assert track.spans == ((0, 1),)
    assert len(track.views) == 12
    vase = played().tracks(played().locate("white vase"))[0]
    assert np.ptp(vase.centers, axis=0).max() == 0


@pytest.mark.parametrize(("relation", "spans"), [("left_of", ((0.0, 0.4),)), ("right_of", ((0.6, 1.0),)), ("on", ())])
def test_when_is_one_thing_beside_another(relation, spans):
    """The car is at y -1 + 2 t, the vase at 0.05; from x = 3, +y is on the right."""
    found = played().when("red car", relation, "white vase", "cam0/00")
    assert np.allclose(found, spans) if spans else found == spans
    mirrored = {"left_of": "right_of", "right_of": "left_of"}.get(relation)
    if mirrored:
        assert played().when("white vase", mirrored, "red car", "cam0/00") == found


def test_relations_of_boxes_are_asked_at_each_time():
    found = played().when("red car", "next_to", "white vase")
    assert len(found) == 1
    assert 0 < found[0][0] <= 0.4 < 0.6 <= found[0][1] <= 1  # a spacing of Gaussians more than half of both boxes


def splintered() -> Scene:
    """A vase that stands on a large table, which fits "brown table" a little worse than a splinter far away does."""
    rng = np.random.default_rng(0)
    counts, words = (100, 4000, 45), ("white vase", "brown wooden table", "brown table")
    low, high = ((-0.2, -0.2, 0), (-1, -1.5, -0.2), (-4, 0, 0)), ((0.2, 0.2, 0.4), (1, 1.5, -0.05), (-3.8, 0.2, 0.2))
    labels = np.repeat(np.arange(3), counts)
    means = rng.uniform(np.array(low)[labels], np.array(high)[labels]).astype(np.float32)
    gaussians = replace(random_gaussians(len(labels)), means=means, opacities=np.full(len(labels), 0.9, np.float32))
    weights = csr_array((np.ones(len(labels), np.float32), (np.arange(len(labels)), labels)))
    masks = MaskIds(("a.png",), np.zeros(3, np.int32), np.arange(3, dtype=np.int32))
    evidence = Evidence(weights, masks, np.asarray(WordEncoder().encode_texts(words), np.float32))
    field = build_field(evidence, gaussians.fingerprint, WordEncoder.identity, Mixture())
    field = with_flat_objects(field, gaussians, labels)
    return Scene(field, still(gaussians), [look_at_view((3, 0, 1.5))])


def test_a_splinter_is_not_what_a_thing_stands_on():
    scene = splintered()
    table, splinter = scene.locate("brown table")
    assert (len(table), len(splinter)) == (4000, 45)
    assert splinter.score > table.score
    assert scene.when("white vase", "on", "brown table") == ((0.0, 1.0),)
    assert scene.when("white vase", "on", splinter) == ()
    assert scene.when("brown table", "on", "white vase") == ()


def test_a_relation_to_any_of_several_alike_is_one():
    """What the car passes and what it is above have one name: either will do, not the first alone."""
    moving = passing()
    labels = np.repeat(np.arange(3), 100)
    weights = csr_array((np.ones(300, np.float32), (np.arange(300), labels)))
    masks = MaskIds(("a.png",), np.zeros(3, np.int32), np.arange(3, dtype=np.int32))
    vectors = np.asarray(WordEncoder().encode_texts(("red car", "vase", "vase")), np.float32)
    field = build_field(
        Evidence(weights, masks, vectors), moving.canonical.fingerprint, WordEncoder.identity, Mixture()
    )
    scene = Scene(with_flat_objects(field, moving.canonical, labels), moving, passing_views(moving))
    vase, table = scene.locate("vase")
    both = [scene.when("red car", relation, "vase") for relation in ("next_to", "on")]
    for relation, found in zip(("next_to", "on"), both, strict=True):
        alone = [scene.when("red car", relation, one) for one in (vase, table)]
        stamps = [time for time in moving.times if any(a <= time <= b for spans in alone for a, b in spans)]
        assert [time for time in moving.times if any(a <= time <= b for a, b in found)] == stamps
    assert both[1] != scene.when("red car", "on", vase) or both[0] != scene.when("red car", "next_to", vase)


def test_what_cannot_be_told_is_said():
    with refused("give view=NAME"):
        played().when("red car", "left_of", "white vase")
    with refused("three ends"):
        played().when("red car", "between", "white vase")
    with refused(r"expected one of on, in, .*; got 'behind'"):
        played().when("red car", "behind", "white vase")
    with refused("stands still"):
        played().at(0.2).when("red car", "on", "white vase")
    with refused("no match for"):
        played().when("green apple", "on", "white vase")


def test_a_scene_at_a_time_is_a_scene():
    at = played().at(0.8)
    match = at.locate("red car")[0]
    assert abs(match.center[1] - 0.6) < 0.05
    assert played().at(0.8) is at  # kept
    assert at.background is played().background
    click = played().view("cam0/05")
    assert click.time == 1
    hidden = played().picture("cam0/00"), played().picture("cam0/05")
    assert (hidden[0] != hidden[1]).any()  # each as it was then


def test_what_is_clicked_is_what_was_there_then():
    for number, time in ((0, 0.0), (5, 1.0)):
        view = played().view(f"cam0/{number:02d}")
        center = np.append(played().at(time).locate("red car")[0].center, 1)
        pixel = view.K @ (view.cam_from_world @ center)[:3]
        place = (view.name, float(pixel[0] / pixel[2]), float(pixel[1] / pixel[2]))
        assert played().what_is(place, ["red car", "white vase", "brown table"])[0].text == "red car"


@pytest.mark.parametrize("code", [PQ(4), Mixture(2)])
def test_a_span_is_a_field_of_its_views_alone(code):
    """With the codebook of the whole, and atoms of the span."""
    stamps = np.linspace(0, 1, 7)
    timed = [replace(view, time=float(time)) for view, time in zip(views(), stamps, strict=True)]
    still = Moving(scene(), np.array([0.0, 1.0]), Frames(np.array([0.0, 1.0]), lambda _: replace(scene())))
    whole = register(still, timed, features()).to_field(code)
    some = field_during(whole, (0.3, 0.7))
    book = whole.codebook if isinstance(code, PQ) else code
    inside = [view for view in timed if view.time is not None and 0.3 <= view.time <= 0.7]
    assert 0 < len(inside) < 7
    alone = register(still, inside, {view.name: features()[view.name] for view in inside}).to_field(book)
    assert np.array_equal(some.gaussian_ids, alone.gaussian_ids)
    rows = np.arange(len(alone))
    assert np.array_equal(some.feature(rows), alone.feature(rows))
    assert field_during(whole, (0.0, 1.0)).gaussian_ids.tolist() == whole.gaussian_ids.tolist()


def named(first: str, second: str) -> Scene:
    """A still scene whose thing is one in the first half of the film, another in the second."""
    moving = passing()
    still = Moving(moving.canonical, moving.times, Frames(moving.times, lambda _: replace(moving.canonical)))
    taken = passing_views(moving)
    labels = np.repeat(np.arange(3), 100)
    early, late = (label_masks(still, taken, labels, (word, "white vase", "brown table")) for word in (first, second))
    mixed = {view.name: (early if (view.time or 0) < 0.5 else late)[view.name] for view in taken}
    field = replace(register(still, taken, mixed), encoder=WordEncoder.identity).to_field(Mixture())
    return Scene(field, still, taken)


def test_a_query_of_a_span_asks_what_was_shown_then():
    changing = named("red car", "green apple")
    for text, during, found in (
        ("red car", (0.0, 0.4), True), ("green apple", (0.0, 0.4), False),
        ("red car", (0.6, 1.0), False), ("green apple", (0.6, 1.0), True),
    ):  # fmt: skip
        matches = changing.locate(Query(text, during=during))
        assert bool(matches) == found, (text, during)
        answer = changing.ask(Query(text, during=during))
        assert (len(answer.gaussian_ids) > 50) == found
        for match in matches:
            assert {changing.view(one.view_name).time for one in match.support} <= set(np.linspace(0, 1, 6)[
                slice(0, 3) if during[1] < 0.5 else slice(3, 6)])  # fmt: skip


def test_a_span_answers_in_whole_objects():
    match = played(objects=True).locate(Query("red car", during=(0.0, 0.2)))[0]
    assert match.object_id is not None
    assert set(match.gaussian_ids) <= set(CAR)
    whole = played(objects=True).locate("red car")[0]
    assert whole.object_id == match.object_id
    assert played(objects=True).during((0, 0.2)) is played(objects=True).during((0.0, 0.2))


def test_spans_that_cannot_be_asked_are_said():
    with refused("no photo was taken from 2 to 3: those of this field are from 0 to 1"):
        played().ask(Query("red car", during=(2, 3)))
    with refused("two finite times"):
        Query("red car", during=(1, 0))
    with refused("two finite times"):
        Query("red car", during=(0.0, np.nan))
    bare = replace(played().field, evidence=None, growth=None)
    with refused("holds no evidence"):
        Scene(bare, played().moving).ask(Query("red car", during=(0, 1)))
    static = register(scene(), views(), features()).to_field(PQ(4))
    with refused("scenes that move"):
        field_during(static, (0, 1))


def test_what_comes_and_goes_is_where_it_is_only_then():
    moving = passing()

    def frame(number: int):
        gaussians = moving.at(float(moving.times[number]))
        return replace(gaussians, opacities=np.where((np.arange(300) < 100) & (number > 2), 0, 0.9).astype(np.float32))

    going = Moving(moving.canonical, moving.times, Frames(moving.times, frame))
    taken = passing_views(moving)
    made = register(
        going, taken, label_masks(going, taken, np.repeat(np.arange(3), 100), ("red car", "blue sofa", "brown table"))
    )
    opened = Scene(replace(made, encoder=WordEncoder.identity).to_field(Mixture()), going, taken)
    match = opened.locate("red car")[0]
    track = opened.tracks([match])[0]
    assert np.allclose(track.times, [0, 0.2, 0.4])
    assert np.allclose(track.spans, [(0, 0.4)])
    assert track.at(0.6000000000000001) is None


def test_runs_of_times():
    times = np.array([0.0, 1, 2, 5, 6])
    assert runs(times, np.array([True, True, False, True, False])) == ((0, 1), (5, 5))
    assert runs(times, np.zeros(5, bool)) == ()
    assert runs(times, np.ones(5, bool)) == ((0, 6),)


def changing_field() -> tuple[LanguageField, np.ndarray]:
    """Two objects of 40 rows in four photos of two times. Rows 0 to 4 are in the other's masks at the second time,
    rows 5 to 9 half in each all the time.
    """
    gaussians = random_gaussians(80)
    own = np.repeat([0, 1], 40)
    dense = np.zeros((80, 8), np.float32)
    for view in range(4):
        dense[np.arange(80), 2 * view + own] = 1
        dense[5:10, 2 * view : 2 * view + 2] = 0.5
    dense[:5, 4:] = np.tile([0, 1], 2)
    masks = MaskIds(
        tuple("abcd"), np.repeat(np.arange(4, dtype=np.int32), 2), np.tile(np.arange(2, dtype=np.int32), 4),
        np.array([0.0, 0.0, 1.0, 1.0]),
    )  # fmt: skip
    embeddings = np.tile(np.eye(8, dtype=np.float32)[:2], (4, 1))
    field = build_field(Evidence(csr_array(dense), masks, embeddings), gaussians.fingerprint, TEST)
    return with_flat_objects(field, gaussians, own), own


def test_rows_that_change_what_they_belong_to_are_found():
    """And not those at a border, whose masks disagree at each time."""
    field, own = changing_field()
    found = drifting(field)
    assert found.gaussian_ids.tolist() == [0, 1, 2, 3, 4]
    assert np.allclose(found.shares, 0.5)
    number = field.objects.thing_of()
    assert (found.first == number[0]).all()
    assert (found.last == number[-1]).all()
    assert number[0] != number[-1]
    assert own[0] != own[-1]


def test_nothing_drifts_where_masks_agree():
    assert len(drifting(played(objects=True).field).gaussian_ids) <= 3  # of 300: seen through what passes


def test_only_fields_of_films_with_objects_are_looked_at():
    field, _ = changing_field()
    for other in (replace(field, objects=None), replace(field, evidence=None)):
        with refused("a scene that moves, with its evidence and objects"):
            drifting(other)
    assert random_evidence(np.random.default_rng(0)).masks.times is None


def test_services_ask_of_a_span():
    pytest.importorskip("pydantic")
    from pydantic import ValidationError

    from drsplat.fronts.serving.conversation import Conversation
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.query_fields import Locate, Segment, cut_of, query_of

    assert query_of(Locate(text="red car", during=[0.0, 0.4]), Limits()).during == (0.0, 0.4)
    assert cut_of(Segment(classes=["red car"], during=[0.0, 0.4])).during == (0.0, 0.4)
    with pytest.raises(ValidationError):
        Locate(text="red car", during=[0.0])
    talk = Conversation(named("red car", "green apple"), "film")
    for during, found in (([0.0, 0.4], 1), ([0.6, 1.0], 0)):
        assert talk.locate("red car", during=during).num_matches == found
        assert talk.count("red car", during=during).count == found
        assert (talk.where_is("red car", during=during).best is not None) == bool(found)


def test_classes_of_a_span():
    scene = named("red car", "green apple")
    for during, best in (((0.0, 0.4), 0), ((0.6, 1.0), 1)):
        found = scene.segment(["red car", "green apple"], Cut(threshold=0.3, during=during))
        assert found.counts[best] > 50 > found.counts[1 - best]


def test_a_folder_with_motion_is_a_scene(tmp_path):
    made = played()
    write_moving(tmp_path / "film.motion", made.moving)
    made.field.save(tmp_path / "film.field")
    opened = open_scene(tmp_path)
    assert opened.moving.canonical.fingerprint == made.moving.canonical.fingerprint
    assert np.allclose(
        opened.tracks(opened.locate("red car"))[0].centers, made.tracks(made.locate("red car"))[0].centers
    )
