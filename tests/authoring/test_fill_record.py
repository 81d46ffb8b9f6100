"""The record of a fill: a list makes the same scene with the objects at hand and without; false ones are refused."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_edits import ARRAYS, on_a_floor
from test_loose_parts import a_thing_in_a_hole

from command_line import answer_of
from drsplat import Gaussians, read_gaussians
from drsplat.authoring.editing import Copies, Edit, EditFile, EditList, Fill, Move, Remove, Rows, edited
from drsplat.authoring.editing.edits import document_of, edits_of, recorded
from drsplat.errors import FormatError, InputError
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.npy import write_npy
from drsplat.fronts.viewing.bare import open_bare
from drsplat.fronts.viewing.edits import Edits
from mutations import bounded_allocations

ALLOWANCE = 48 << 20
MAX_BYTES_PER_ROW = 12  # a run of one row and the gap before it, of up to four digits each, with their commas


def removed_and_filled(block: np.ndarray) -> tuple[Edit, Edit]:
    return Edit(Rows.of(block), Remove()), Edit(Rows.of(block), Fill())


def bare(scene: Gaussians) -> Gaussians:
    return replace(scene, extra={})


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS)


def kept(scene: Gaussians, block: np.ndarray, file: EditFile) -> EditList:
    for edit in removed_and_filled(block):
        listed = file.change(scene, lambda listed, edit=edit: listed.with_edit(edit))
    return listed


@pytest.fixture
def file(tmp_path) -> EditFile:
    return EditFile(tmp_path / "scene.edits.json")


@pytest.mark.slow
def test_a_list_is_done_again_without_the_objects(file):
    scene, block, _, _ = a_thing_in_a_hole()
    edits = removed_and_filled(block)
    made, computed = edited(scene, edits), edited(bare(scene), edits)
    assert not same(made, computed)  # so this can fail
    assert same(file.edited(scene, kept(scene, block, file)), made)
    assert same(file.edited(bare(scene), file.read(bare(scene))), made)


def test_undone_and_done_again_without_the_objects(file):
    scene, block, _, _ = a_thing_in_a_hole()
    made, text = file.edited(scene, kept(scene, block, file)), file.path.read_text()
    undone = file.change(bare(scene), EditList.undone)
    assert same(file.edited(bare(scene), undone), edited(bare(scene), removed_and_filled(block)[:1]))
    assert same(file.edited(bare(scene), file.change(bare(scene), EditList.redone)), made)
    assert file.path.read_text() == text


def test_later_edits_of_the_clones_are_done_too(file):
    scene, block, _, _ = a_thing_in_a_hole()
    kept(scene, block, file)
    lifted = file.change(scene, lambda listed: listed.with_edit(Edit(Copies(2), Move((0.0, 0.0, 1.0)))))
    low, high = file.edited(scene, lifted.undone()), file.edited(bare(scene), lifted)
    moved = (low.means != high.means).any(axis=1)
    assert moved.sum() > 50
    assert_allclose(high.means[moved] - low.means[moved], [[0, 0, 1]] * moved.sum(), atol=1e-6)


def test_a_record_is_short(file):
    scene, block, _, _ = a_thing_in_a_hole()
    change = kept(scene, block, file).edits[1].change
    assert isinstance(change, Fill)
    rows = sum(map(len, change.record.clones)) + int(np.diff(change.record.removed).sum())
    text = json.dumps(json.loads(file.path.read_text())["edits"][1]["record"], separators=(",", ":"))
    assert rows > 50
    assert len(text) < MAX_BYTES_PER_ROW * rows


def test_a_fill_that_removes_nothing_is_kept_too(file):
    scene, block = on_a_floor()
    made = file.edited(scene, kept(scene, block, file))
    assert json.loads(file.path.read_text())["edits"][1]["record"]["removed"] == []
    assert same(made, edited(scene, removed_and_filled(block)))
    assert len(made) > len(scene) - len(block)


# --- in the viewer and in the command ---


@pytest.mark.slow
def test_the_viewer_keeps_the_record(tmp_path):
    scene, block, _, _ = a_thing_in_a_hole()
    path = tmp_path / "scene.ply"
    write_gaussians(path, scene, scene.extra)
    owned = read_gaussians(path)
    edits, alone = Edits(open_bare(path)), Edits(open_bare(path), kept=False)
    for edit in removed_and_filled(block):
        edits.add(edit)
        alone.add(edit)
    made = edited(owned, removed_and_filled(block))
    assert same(edits.part(None)[0], made)
    assert same(alone.part(None)[0], made)
    edits.undo()
    edits.redo()
    assert same(edits.part(None)[0], made)
    write_gaussians(path, bare(owned), overwrite=True)
    again = Edits(open_bare(path))
    assert same(again.part(None)[0], made)
    again.stand(replace(owned, means=owned.means + np.float32(0.25)))
    assert_allclose(again.part(None)[0].means, made.means + np.float32(0.25), atol=1e-6)


def test_the_command_keeps_the_record(tmp_path, capsys):
    scene, block, _, _ = a_thing_in_a_hole()
    path, rows = tmp_path / "scene.ply", tmp_path / "block.npy"
    write_gaussians(path, scene, scene.extra)
    write_npy(rows, block)
    owned = read_gaussians(path)
    answer = answer_of(capsys, "edit", path, "--rows", rows, "--remove", "--fill")
    write_gaussians(path, bare(owned), overwrite=True)
    assert answer_of(capsys, "edit", path, "--save", tmp_path / "out.ply")["num_gaussians"] == answer["num_gaussians"]
    assert same(read_gaussians(tmp_path / "out.ply"), edited(owned, removed_and_filled(block)))


# --- from strangers ---

SCENE, BLOCK, _, _ = a_thing_in_a_hole()
LAST = len(SCENE) - 1


def stored(**fill: Any) -> dict[str, Any]:
    edit = {"of": {"kind": "everything"}, "do": "fill", "version": 4} | fill
    return {"format": "drsplat edits", "version": 1, "scene": SCENE.fingerprint, "done": 1, "edits": [edit]}


def record(*clones: object, removed: object = ()) -> dict[str, object]:
    return {"removed": list(removed) if isinstance(removed, tuple) else removed, "clones": list(clones)}


def clones(runs: object, by: object = (0, 0, 1)) -> dict[str, object]:
    return {"runs": runs, "by": list(by) if isinstance(by, tuple) else by}


@pytest.mark.parametrize(
    ("fill", "said"),
    [
        ({}, "edit 1: record is missing: expected what this fill removes and clones"),
        ({"record": []}, "record: expected an object with removed and a list of clones, got a list of 0"),
        ({"record": {"removed": [], "clones": 7}}, "a list of clones, got a dict of 2"),
        ({"record": {"clones": []}}, "record: removed: expected a list of lengths"),
        ({"record": record() | {"more": 1}}, "record: 'more' is not known; expected removed, clones"),
        ({"record": record(removed=(1,))}, "record: removed: expected pairs of lengths"),
        ({"record": record(removed=(0, 1, 0, 1))}, "fill: removed: expected ascending rows"),
        ({"record": record(removed=(0, 1e99))}, "record: removed: expected pairs of lengths"),
        ({"record": record(7)}, "record: clones 1: expected an object with runs and by, got 7"),
        ({"record": record(clones([]))}, "fill: clones: expected ascending rows of the scene, one or more"),
        ({"record": record(clones([0, -1]))}, "record: clones 1: runs: expected pairs of lengths"),
        ({"record": record(clones([0, 1]), clones([0, 1], "up"))}, "clones 2: by: expected 3 numbers, got 'up'"),
        ({"record": record(clones([0, 1], (0, 0, float("nan"))))}, "clones 1: by: expected a finite number"),
        ({"record": record(clones([0, 1]) | {"of": 1})}, "clones 1: 'of' is not known; expected runs, by"),
        ({"version": 3, "record": record()}, "fill: expected version 4, got 3"),
        ({"version": 5, "record": record()}, "fill: expected version 4, got 5"),
    ],
)  # fmt: skip
def test_a_record_that_is_none_is_refused_in_words(fill, said):
    with pytest.raises(FormatError) as error:
        edits_of(stored(**fill), "list")
    assert said in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("false", "said"),
    [
        (record(removed=(2**31 - 2, 1)), f"its record has row 2,147,483,646 of a scene of {LAST + 1:,}: undo this"),
        (record(removed=(LAST + 1, 1)), f"its record has row {LAST + 1:,} of a scene of {LAST + 1:,}"),
        (record(clones([0, 2**31 - 1])), "its record has row 2,147,483,646 of a scene"),
        (record(*[clones([0, LAST + 1])] * 2000), f"adds {2000 * (LAST + 1):,} Gaussians to {LAST + 1:,}"),
        (record(clones([0, 1], (1e99, 0, 0))), "beyond all numbers"),
    ],
)  # fmt: skip
def test_a_record_that_does_not_fit_the_scene_takes_no_memory(false, said):
    listed = edits_of(stored(record=false), "list")
    with bounded_allocations(ALLOWANCE), pytest.raises(InputError) as error:
        edited(SCENE, listed.active)
    assert said in str(error.value)


def test_a_record_may_be_of_all_rows_and_of_the_last():
    false = record(clones([LAST, 1]), removed=(0, LAST + 1))
    (only,) = edited(SCENE, edits_of(stored(record=false), "list").active).means
    assert_array_equal(only, SCENE.means[LAST] + np.float32([0, 0, 1]))


def test_a_fill_is_not_stored_without_its_record():
    listed = EditList(SCENE.fingerprint, removed_and_filled(BLOCK), 2)
    with pytest.raises(InputError, match=r"fill: its record is missing: store the list with EditFile\.change"):
        document_of(listed)
    stands = recorded(SCENE, listed)
    assert recorded(bare(SCENE), stands) is stands
    assert [type(edit.change) for edit in edits_of(document_of(stands), "list").edits] == [Remove, Fill]
