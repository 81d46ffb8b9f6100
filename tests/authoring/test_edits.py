"""Edits: laws of what they do to rows, colours and places, whatever the scene; nothing else has other bits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import Gaussians, render
from drsplat.authoring.editing import (
    Box,
    Copies,
    Duplicate,
    Edit,
    EditFile,
    EditList,
    Everything,
    Fill,
    Isolate,
    MatchPhoto,
    Move,
    Opacity,
    Palette,
    Recolour,
    Remove,
    Replace,
    Rows,
    Scale,
    Turn,
    draft,
    edited,
)
from drsplat.authoring.editing.edits import Change
from drsplat.authoring.editing.fill_record import Clones, FillRecord
from drsplat.authoring.editing.replacement import fitted
from drsplat.drawing.heat import LUMA
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.kernels.boxes import box_of
from drsplat.scene.gaussians import SH_C0, concatenated
from refusing import malformed, refused
from scenes import gaussians_at, look_at_view, random_gaussians

COUNT = 60
UP = np.array([0.0, 0, 1])
ARRAYS = ("means", "quats", "scales", "opacities", "sh")
some_rows = st.sets(st.integers(0, COUNT - 1), min_size=1, max_size=COUNT - 1).map(lambda rows: np.array(sorted(rows)))
numbers = st.floats(-3, 3, width=32)
vectors = st.tuples(numbers, numbers, numbers)
shares = st.floats(0, 1, width=32)
colors = st.tuples(shares, shares, shares)
changes = st.one_of(  # classes with their values: made in the test, where beartype may look at them by chance
    st.tuples(st.just(Remove)),
    st.tuples(st.just(Opacity), st.floats(0, 3)),
    st.tuples(st.just(Move), vectors),
    st.tuples(st.just(Turn), st.floats(-180, 180), st.just((0.1, 0.2, 1.0)), st.none() | vectors),
    st.tuples(st.just(Scale), st.floats(0.1, 4), st.none() | vectors),
    st.tuples(st.just(Duplicate), vectors),
    st.tuples(st.just(Recolour), colors, shares),
    st.tuples(st.just(Palette), st.lists(colors, min_size=1, max_size=4).map(tuple)),
)


@pytest.fixture(scope="module")
def scene() -> Gaussians:
    return a_scene()


def a_scene() -> Gaussians:
    given = random_gaussians(COUNT, sh_degree=2)
    return replace(given, extra={"object_id": (np.arange(COUNT) % 5 - 1).astype(np.int32)})


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS) and all(
        np.array_equal(a.extra[name], b.extra[name]) for name in {*a.extra, *b.extra}
    )


def of(rows: np.ndarray, change: Change | tuple) -> Edit:
    return Edit(Rows.of(rows), change[0](*change[1:]) if isinstance(change, tuple) else change)


@given(some_rows, changes, changes)
def test_an_edit_and_its_undo_give_the_same_bits(rows, first, second):
    scene = a_scene()
    one = EditList(scene.fingerprint).with_edit(of(rows, first))
    two = one.with_edit(of(np.setdiff1d(np.arange(COUNT), rows), second))
    assert same(edited(scene, two.undone().active), edited(scene, one.active))
    assert same(edited(scene, two.undone().redone().active), edited(scene, two.active))
    assert edited(scene, two.undone().undone().active) is scene
    assert same(a_scene(), scene)  # which no edit has written into


@given(some_rows, changes)
def test_other_rows_keep_their_bits_and_their_order(rows, change):
    scene = a_scene()
    others = np.setdiff1d(np.arange(COUNT), rows)
    done = edited(scene, [of(rows, change)])
    kept = others if change[0] is Remove else np.arange(COUNT)
    at = np.searchsorted(kept, others)
    assert same(done.subset(at), scene.subset(others))


@given(some_rows)
def test_isolate_and_remove_part_the_scene(rows):
    scene = a_scene()
    left, right = (edited(scene, [of(rows, change)]) for change in (Isolate(), Remove()))
    assert len(left) + len(right) == COUNT
    assert same(left, scene.subset(rows))
    assert same(right, scene.subset(np.setdiff1d(np.arange(COUNT), rows)))
    assert len(edited(scene, [of(rows, Isolate()), of(rows, Remove())])) == 0


@pytest.mark.slow
@given(some_rows, vectors, st.floats(-180, 180), st.floats(0.2, 5))
def test_there_and_back_again(rows, by, degrees, factor):
    scene, about, back = a_scene(), (0.5, -0.2, 0.1), tuple(-x for x in by)
    for there, again in (
        (Move(by), Move(back)),
        (Turn(degrees, (1.0, 2.0, 0.5), about), Turn(-degrees, (1.0, 2.0, 0.5), about)),
        (Scale(factor, about), Scale(1 / factor, about)),
    ):
        done = edited(scene, [of(rows, there), of(rows, again)])
        for name in ("means", "scales", "sh"):
            assert_allclose(getattr(done, name), getattr(scene, name), rtol=1e-4, atol=2e-5)
        assert_allclose(done.covariances(), scene.covariances(), rtol=1e-3, atol=1e-6)


def test_a_turned_scene_is_seen_as_from_the_other_side(scene):
    """A quarter turn of everything, harmonics with it, is a quarter turn of the camera, the other way."""
    turned = edited(scene, [Edit(Everything(), Turn(90, (0.0, 0, 1), (0.0, 0, 0)))])
    here, there = look_at_view((0.0, -6, 1)), look_at_view((6.0, 0, 1))
    assert_allclose(render(turned, there).rgb, render(scene, here).rgb, atol=2e-3)
    assert np.abs(render(scene, there).rgb - render(scene, here).rgb).mean() > 0.01  # so this could fail


@given(some_rows, colors, colors)
def test_restyling_keeps_opacity_and_geometry(rows, one, other):
    scene = a_scene()
    photo = default_rng(0).integers(1, 255, (8, 8, 3), dtype=np.uint8)
    for change in (Recolour(one), Palette((one, other)), MatchPhoto.of(photo)):
        done = edited(scene, [of(rows, change)])
        for name in ("means", "quats", "scales", "opacities"):
            assert np.array_equal(getattr(done, name), getattr(scene, name))


def rgb_of(scene: Gaussians) -> np.ndarray:
    return 0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64)


def test_recoloured_has_one_hue_and_its_own_light(scene):
    tame = replace(scene, sh=(scene.sh * 0.3).astype(np.float32))
    before, after = rgb_of(tame), rgb_of(edited(tame, [Edit(Everything(), Recolour((0.2, 0.4, 0.8)))]))
    assert_allclose(after / after[:, 2:], np.broadcast_to([0.25, 0.5, 1], after.shape), atol=1e-4)
    order = np.argsort(before @ LUMA)
    assert (np.diff((after @ LUMA)[order]) > -1e-6).all()
    half = rgb_of(edited(tame, [Edit(Everything(), Recolour((0.2, 0.4, 0.8), 0.5))]))
    assert_allclose(half, (before + after) / 2, atol=1e-5)


def test_a_photo_gives_its_mean_and_spread(scene):
    rng = default_rng(1)
    photo = np.clip(rng.normal((90, 120, 180), (10, 25, 15), (64, 64, 3)), 1, 255).astype(np.uint8)
    wanted = MatchPhoto.of(photo)
    solid = replace(scene, opacities=np.ones(COUNT, np.float32))
    after = rgb_of(edited(solid, [Edit(Everything(), wanted)]))
    assert_allclose(after.mean(axis=0), wanted.mean, atol=1e-4)
    assert_allclose(np.cov(after.T, bias=True), wanted.covariance, rtol=0.12, atol=2e-4)  # GRAIN


def test_a_palette_goes_from_dark_to_dark(scene):
    dark, light = COUNT // 2, COUNT - COUNT // 2
    sh = np.zeros_like(scene.sh)
    sh[:, 0] = (np.repeat([(0.2, 0.1, 0.1), (0.7, 0.8, 0.7)], [dark, light], axis=0) - 0.5) / SH_C0
    palette = Palette(((0.9, 0.8, 0.2), (0.1, 0.2, 0.3)))
    after = rgb_of(edited(replace(scene, sh=sh), [Edit(Everything(), palette)]))
    assert_allclose(after, np.repeat([(0.1, 0.2, 0.3), (0.9, 0.8, 0.2)], [dark, light], axis=0), atol=1e-5)


def test_copies_come_behind_and_are_objects_of_their_own(scene):
    rows = np.array([3, 4, 9])
    edits = [of(rows, Duplicate((1.0, 0, 0))), Edit(Copies(1), Opacity(0.5)), of(rows, Remove())]
    done = edited(scene, edits)
    assert len(done) == COUNT
    copies = done.subset(np.arange(COUNT - 3, COUNT))
    assert_array_equal(copies.means, scene.means[rows] + np.float32([1, 0, 0]))
    assert_array_equal(copies.opacities, scene.opacities[rows] * np.float32(0.5))
    assert copies.extra["object_id"].tolist() == [4, 4, 4]
    with refused("edit 2: edit 1 added nothing"):
        edited(scene, [of(rows, Remove()), Edit(Copies(1), Remove())])


def test_a_box_holds_what_is_in_it_when_the_edit_is_done(scene):
    everywhere = Box(np.array([10.0, 0, 0]), np.eye(3), np.full(3, 8.0))
    moved = Edit(Everything(), Move((10.0, 0, 0)))
    assert len(edited(scene, [Edit(everywhere, Remove())])) == COUNT
    assert len(edited(scene, [moved, Edit(everywhere, Remove())])) == 0


def test_rows_of_another_scene_are_refused(scene):
    with refused(r"edit 1: .* has row 60 of a scene of 60"):
        edited(scene, [of(np.array([COUNT]), Remove())])


# --- replaced, and filled ---


def block(center: tuple, size: tuple, count: int = 400, seed: int = 0) -> Gaussians:
    return gaussians_at(np.array(center) + (default_rng(seed).random((count, 3)) - 0.5) * size, 0.01)


def test_edits_make_no_more_rows_than_they_may(scene, monkeypatch):
    monkeypatch.setattr(draft, "MIN_ROW_LIMIT", 1000)
    doubled = Edit(Everything(), Duplicate((1.0, 0.0, 0.0)))
    assert len(edited(scene, [doubled] * 4)) == 16 * COUNT
    with refused(r"edit 5: adds 960 Gaussians to 960, and .* make up to 1,000, removed ones"):
        edited(scene, [doubled] * 5)
    copied = Edit(Rows.of(np.arange(COUNT)), Duplicate((1.0, 0.0, 0.0)))
    with refused("edit 17: adds 60 Gaussians to 960"):  # removed rows keep their numbers
        edited(scene, [*[copied] * 15, Edit(Copies(1), Remove()), copied])
    large = random_gaussians(600)
    assert len(edited(large, [doubled, doubled])) == 4 * 600  # of a large scene, four times its own
    replaced = Replace("large.ply", large.fingerprint, np.eye(4))
    rows = Rows.of(np.arange(3))
    assert len(edited(scene, [Edit(rows, replaced)] * 3, read=lambda _: large)) == COUNT - 3 + 3 * 600


@pytest.mark.parametrize(
    ("spans", "said"),
    [
        ([], "expected ascending rows of the other scene, one or more"),
        ([[3, 3]], "expected ascending rows"),
        ([[0, 2], [1, 4]], "expected ascending rows"),
        ([[0, 61]], "has row 60 of other.ply, which has 60: undo this edit"),
        ([[5, 2**31 + 4]], "has row 2,147,483,651 of other.ply"),
    ],
)
def test_rows_of_the_other_scene_are_those_that_it_has(scene, spans, said):
    def replaced():
        change = Replace("other.ply", scene.fingerprint, np.eye(4), np.array(spans, np.int64).reshape(-1, 2))
        return edited(scene, [Edit(Rows.of(np.arange(3)), change)], read=lambda _: scene)

    with refused(said):
        replaced()


@pytest.mark.parametrize(
    "change", [(Move, (3e38, 0.0, 0.0)), (Duplicate, (0.0, 1e31, 0.0)), (Scale, 1e-6, (1e36, 0.0, 0.0))]
)
def test_what_cannot_be_computed_with_is_refused(scene, change):
    with refused("beyond all numbers that a scene can hold"):
        edited(scene, [of(np.arange(3), change)])


def test_an_axis_of_any_length_is_a_direction(scene):
    turned = [edited(scene, [Edit(Everything(), Turn(20, (x, x, 0.0)))]).means for x in (1.0, 1e-300, 1e300)]
    assert_allclose(turned[1], turned[0], atol=1e-5)
    assert_allclose(turned[2], turned[0], atol=1e-5)
    with refused("up to 1,000,000 degrees"):
        Turn(1e300, (0.0, 0.0, 1.0))


def test_a_replacement_stands_where_the_object_stood(tmp_path):
    scene, other = block((1, 2, 0.5), (0.6, 0.3, 1.0)), block((-5, 0, 9), (2.0, 4.0, 2.0), seed=1)
    everything = np.arange(400)
    write_gaussians(tmp_path / "other.ply", other)
    matrix = fitted(box_of(scene, everything, UP), box_of(other, everything, UP))
    edit = of(everything, Replace("other.ply", other.fingerprint, matrix))
    listed = EditFile(tmp_path / "scene.edits.json").change(scene, lambda edits: edits.with_edit(edit))
    done = EditFile(tmp_path / "scene.edits.json").edited(scene, listed)
    assert len(done) == 400
    goes, comes = box_of(scene, everything, UP), box_of(done, everything, UP)
    assert_allclose(comes.center[:2], goes.center[:2], atol=0.02)
    assert_allclose(comes.center[2] - comes.extent[2] / 2, goes.center[2] - goes.extent[2] / 2, atol=0.02)
    assert_allclose(comes.extent[0], goes.extent[0], rtol=0.05)  # the side that is tight
    assert (comes.extent <= goes.extent * 1.05).all()
    write_gaussians(tmp_path / "other.ply", block((0, 0, 0), (1, 1, 1), seed=2), overwrite=True)
    with pytest.raises(MismatchError, match="another scene"):
        EditFile(tmp_path / "scene.edits.json").edited(scene, listed)


def on_a_floor() -> tuple[Gaussians, np.ndarray]:
    """A block in the middle of a floor that has a hole below it."""
    steps = np.linspace(-2, 2, 81)
    flat = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    flat = flat[(np.abs(flat) > 0.25).any(axis=1)]
    floor = gaussians_at(np.column_stack([flat, np.zeros(len(flat))]), (0.04, 0.04, 0.003), (0.6, 0.4, 0.2), 0.95)
    thing = block((0, 0, 0.3), (0.5, 0.5, 0.58), 2000)
    return concatenated([floor, thing]), np.arange(len(flat), len(flat) + 2000)


def test_the_floor_goes_on_below_what_was_removed():
    scene, thing = on_a_floor()
    view = look_at_view((0.0, -1.5, 2.0), (0.0, 0, 0))
    middle = (slice(50, 62), slice(74, 86))
    gone = edited(scene, [of(thing, Remove())])
    assert render(gone, view).alpha[middle].max() < 0.5
    filled = edited(scene, [of(thing, Remove()), of(thing, Fill())])
    drawn = render(filled, view)
    assert drawn.alpha[middle].min() > 0.9
    assert_allclose(drawn.rgb[middle], np.broadcast_to([0.6, 0.4, 0.2], (12, 12, 3)), atol=0.06)
    assert np.abs(filled.means[len(gone) :, 2]).max() < 0.01  # in the plane


def test_what_was_moved_leaves_a_hole_where_it_stood():
    scene, thing = on_a_floor()
    filled = edited(scene, [of(thing, Move((1.0, 0, 0))), of(thing, Fill())])
    added = filled.means[len(scene) :]
    assert len(added) > 50
    assert np.abs(added[:, :2]).max() < 0.4


def test_where_there_is_no_plane_nothing_is_filled():
    alone = block((0, 0, 0), (1, 1, 1), 300)
    with refused(r"edit 1: fill: no ground and no wall was found"):
        edited(alone, [of(np.arange(100), Fill())])
    with refused("leave no hole"):
        edited(alone, [of(np.arange(3), Fill())])


def test_a_hole_that_is_larger_than_what_is_left_is_told(monkeypatch):
    monkeypatch.setattr("drsplat.authoring.editing.closing.MAX_SHIFTS", 1)
    scene, thing = on_a_floor()
    near = (np.abs(scene.means[:, :2]) < 0.34).all(axis=1)
    small = scene.subset(near)
    rows = np.flatnonzero(np.isin(np.flatnonzero(near), thing))
    with pytest.warns(DrSplatWarning, match="of the hole could be closed"):
        edited(small, [of(rows, Remove()), of(rows, Fill())])


# --- the file ---

EVERY = (
    Remove(), Isolate(), Opacity(0.5), Move((1.0, 2.0, 3.0)), Turn(30.0, (0.0, 0.0, 1.0)), Scale(2.0, (1.0, 0.0, 0.0)),
    Duplicate((0.0, 0.0, 1.0)), Recolour((0.1, 0.2, 0.3), 0.5), Palette(((0.1, 0.2, 0.3), (1.0, 1.0, 1.0))),
    MatchPhoto(np.array([0.1, 0.2, 0.3]), 0.01 * np.eye(3)),
    Replace("a/b.ply", "3-ff", np.eye(4), np.array([[1, 3], [7, 9]])),
    Fill(record=FillRecord(np.array([[2, 5]]), (Clones(np.array([[0, 2], [7, 9]]), np.array([0.1, 0.0, -2.0])),))),
)  # fmt: skip


def every_edit() -> tuple[Edit, ...]:
    rows = Rows.of(np.array([1, 2, 3, 9]), "query", "größe 🥤")
    targets = (Box(np.ones(3), np.eye(3), np.full(3, 0.5)), Copies(7), Everything())
    return (*(Edit(rows, change) for change in EVERY), *(Edit(target, Remove()) for target in targets))


def test_what_is_written_is_read(scene, tmp_path):
    file = EditFile.beside(tmp_path / "scene.ply")
    assert file.path == tmp_path / "scene.edits.json"
    assert file.read(scene).edits == ()
    given = EditList(scene.fingerprint, every_edit(), 12)
    file.change(scene, lambda _: given)
    read = file.read(scene)
    assert (read.scene, read.done, len(read.edits)) == (given.scene, 12, 15)
    text = file.path.read_text()
    file.change(scene, lambda edits: edits)
    assert file.path.read_text() == text
    assert [type(edit.change) for edit in read.edits[:12]] == [type(change) for change in EVERY]
    assert [str(edit.target) for edit in read.edits] == [str(edit.target) for edit in given.edits]


def test_a_change_that_fails_leaves_the_file(scene, tmp_path):
    file = EditFile.beside(tmp_path / "scene.ply")
    with refused("no edit to undo"):
        file.change(scene, EditList.undone)
    assert not file.path.exists()


def test_edits_of_another_scene_are_refused(scene, tmp_path):
    file = EditFile.beside(tmp_path / "scene.ply")
    file.change(scene, lambda edits: edits.with_edit(of(np.arange(3), Remove())))
    with pytest.raises(MismatchError, match="of another scene"):
        file.read(scene.subset(np.arange(COUNT - 1)))


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("[]", "expected 'drsplat edits'"),
        ('{"format": "drsplat edits", "version": 2}', "expected 'drsplat edits' of version 1, got 2"),
        ('{"format": "drsplat edits", "version": 1, "scene": "a", "edits": {}}', "a list of up to"),
        ('{"format": "drsplat edits", "version": 1, "scene": "a", "edits": [], "done": 1}', "1 of 0 done"),
        ('{"format": "drsplat edits", "version": 1, "scene": "a", "edits": [], "doen": 1}', "'doen' is not known"),
        (r"EDIT {}", "edit 1: do: expected one of"),
        (r'EDIT {"do": "explode"}', "got 'explode'"),
        (r'EDIT {"do": "remove"}', "edit 1: of: expected an object"),
        (r'EDIT {"do": "remove", "of": {"kind": "rows", "runs": [0]}}', "pairs of lengths"),
        (r'EDIT {"do": "remove", "of": {"kind": "rows", "runs": []}}', "ascending rows"),
        (r'EDIT {"do": "remove", "of": {"kind": "rows", "runs": [0, 1e99]}}', "pairs of lengths"),
        (r'EDIT {"do": "remove", "by": 1, "of": {"kind": "everything"}}', "'by' is not known"),
        (r'EDIT {"do": "move", "of": {"kind": "everything"}}', "edit 1: by is missing"),
        (r'EDIT {"do": "move", "by": [1, 2, NaN], "of": {"kind": "everything"}}', "finite number"),
        (r'EDIT {"do": "scale", "factor": 0, "of": {"kind": "everything"}}', "factor above 0"),
        (r'EDIT {"do": "palette", "colors": [[2, 0, 0]], "of": {"kind": "everything"}}', "red, green and blue"),
        (r'EDIT {"do": "remove", "of": {"kind": "box", "center": [0, 0, 0], "extent": [0, 1, 1]}}', "lengths above 0"),
    ],
)  # fmt: skip
def test_what_is_no_edit_is_refused_in_words(scene, tmp_path, document, said):
    file = EditFile.beside(tmp_path / "scene.ply")
    edit = document.removeprefix("EDIT ")
    start = '{"format": "drsplat edits", "version": 1, "scene": "a", "done": 1, "edits": ['
    file.path.write_text(document if edit == document else f"{start}{edit}]}}")
    with malformed(r"scene\.edits\.json") as error:
        file.read(scene)
    assert said in str(error.value)
