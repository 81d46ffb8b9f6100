"""What is known of objects, and that a field keeps it: described from the evidence, saved, loaded, refused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import load_field
from drsplat.errors import MismatchError
from drsplat.field import loading
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.forest import ARRAYS, Objects
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from drsplat.formats.field_folder import read_manifest
from drsplat.formats.tensors import map_tensors, write_tensors
from fields import random_weights, unit_rows
from known_objects import CENTERS, EACH, SIZES, UP, described, known_field, known_scene, known_tree, with_objects
from refusing import malformed, refused

PARTS, THINGS, GROUP = (0, 1), (2, 3, 4), 5


@pytest.fixture(scope="module")
def objects() -> Objects:
    field, _ = with_objects()
    assert field.objects is not None
    return field.objects


def test_the_ways_through_the_forest(objects):
    assert len(objects) == 3
    assert objects.things.tolist() == [2, 3, 4]
    assert objects.path(0) == [0, 2, 5]
    assert objects.path(EACH) == [3, 5]
    assert objects.above(0) == 2
    assert objects.above(5) is None
    assert objects.below(5) == [2, 3]
    assert objects.below(0) == []
    assert_array_equal(objects.rows(5), np.arange(2 * EACH))
    assert_array_equal(objects.rows(1), np.arange(EACH // 2, EACH))
    assert_array_equal(objects.thing_of(), np.repeat([0, 1, 2], [EACH, EACH, EACH - 10]))


def test_rows_of_no_node_are_of_no_thing(objects):
    node_of = objects.node_of.copy()
    node_of[:7] = -1
    node_of[7:9] = GROUP  # of a group, but of none of its things
    fewer = replace(objects, node_of=node_of)
    assert fewer.path(3) == []
    assert (fewer.thing_of()[:9] == -1).all()
    assert fewer.thing_of()[9] == 0
    assert fewer.rows(GROUP)[0] == 7


def test_numbers_go_by_mass():
    scene = known_scene()
    lighter = scene.opacities.copy()
    lighter[:EACH] *= np.float32(0.5)
    scene = replace(scene, opacities=lighter)
    found = described(known_field(scene), scene)
    assert found.things.tolist() == [3, 4, 2]
    assert found.thing_of()[0] == 2


@pytest.mark.parametrize("ask", ["thing", "rows", "above", "below", "path", "masks_of", "descriptors_of"])
@pytest.mark.parametrize("number", [-1, 10_000])
def test_what_is_not_there_is_refused(objects, ask, number):
    with refused(str(number)):
        getattr(objects, ask)(number)


def test_boxes_masses_and_photos(objects):
    for node, center in zip(THINGS, CENTERS, strict=True):
        assert_allclose(objects.centers[node], center, atol=0.02)
        assert_allclose(objects.extents[node], (0.4, 0.2, 0.1), rtol=0.08)
        assert_allclose(objects.axes[node][2], UP, atol=1e-9)
    assert_allclose(objects.centers[GROUP], (0.5, 0, 0), atol=0.02)
    masses = [size * count for size, count in zip(SIZES, (EACH, EACH, EACH - 10), strict=True)]
    assert_allclose(objects.masses[list(THINGS)], masses, rtol=1e-5)
    assert objects.masses[GROUP] == pytest.approx(masses[0] + masses[1], rel=1e-5)
    assert objects.masses[0] + objects.masses[1] == pytest.approx(masses[0], rel=1e-5)
    assert objects.num_views.tolist() == [3] * 6


def test_haze_does_not_stretch_a_box():
    scene = known_scene()
    means, opacities = scene.means.copy(), scene.opacities.copy()
    means[:50, 0] += np.float32(4)
    opacities[:50] = 0.05
    field, hazy = known_field(scene), replace(scene, means=means, opacities=opacities)
    found = described(replace(field, scene=hazy.fingerprint), hazy)
    assert found.extents[THINGS[0]].max() < 0.5


def test_masks_are_those_of_the_largest_share(objects):
    masks, shares = objects.masks_of(THINGS[0])
    assert masks.tolist() == [0, 3, 6, 7]
    assert_allclose(shares, [1 / 3, 1 / 3, 1 / 6, 1 / 6], rtol=1e-6)
    masks, shares = objects.masks_of(GROUP)
    assert set(masks.tolist()) == {0, 1, 3, 4, 6, 7, 8}
    assert shares.sum() == pytest.approx(1)
    assert (np.diff(shares) <= 0).all()


def test_at_most_32_masks_and_4_descriptors():
    scene, field = known_scene(), known_field(known_scene())
    rng = np.random.default_rng(0)
    masks = field.evidence.masks
    views = np.sort(rng.integers(0, 3, 90)).astype(np.int32)
    masks = replace(masks, views=views, ids=np.arange(90, dtype=np.int32))
    evidence = Evidence(random_weights(rng, len(field), 90, 0.5), masks, unit_rows(rng, 90, 8))
    found = described(replace(field, evidence=evidence), scene)
    assert (np.diff(found.mask_starts) == 32).all()
    assert (np.diff(found.descriptor_starts) == 4).all()


def test_a_thing_that_looks_different_from_two_sides_has_two_descriptors(objects):
    """Of box 0 the first half is another word in view c; the other boxes have one embedding each."""
    unit = np.eye(8, dtype=np.float32)
    of_part = objects.descriptors_of(PARTS[0])
    assert len(of_part) == 2
    assert_allclose(np.sort(of_part @ unit[[0, 3]].T, axis=0)[::-1], [[1, 1], [0, 0]], atol=1e-6)
    assert_allclose(objects.descriptors_of(THINGS[1]), unit[[1]], atol=1e-6)


def test_one_mask_of_everything_is_no_description():
    """Weighted by the share of the mask that lies in the node."""
    scene, field = known_scene(), known_field(known_scene())
    assert field.evidence is not None
    evidence = field.evidence
    weights = evidence.weights.tolil()
    weights[:, 6] = 1.0  # one mask over all, of embedding 3
    every = Evidence(type(evidence.weights)(weights.tocsr()), evidence.masks, evidence.embeddings)
    found = described(replace(field, evidence=every), scene)
    (mean,) = found.descriptors_of(THINGS[1])[:1]
    assert mean[1] > 0.97


def test_the_same_bits_at_any_number_of_threads():
    one, several = (with_objects(threads)[0].objects for threads in (1, 3))
    assert one is not None
    assert several is not None
    for name in ARRAYS:
        assert_array_equal(getattr(one, name), getattr(several, name))


def test_what_cannot_be_described():
    scene = known_scene()
    field = known_field(scene)
    tree = known_tree(field)
    node_of = tree.node_of
    with refused("no evidence"):
        described(replace(field, evidence=None), scene)
    with pytest.raises(MismatchError):
        described(field, scene.subset(np.arange(10)))
    with refused("node 0 has no rows"):
        describe(field, scene, tree._replace(node_of=np.where(node_of == 0, -1, node_of).astype(np.int32)))
    with refused("one node for each of"):
        describe(field, scene, tree._replace(node_of=node_of[1:]))


def test_nothing_belongs_together():
    scene = known_scene()
    field = known_field(scene)
    none = np.empty(0, np.int32)
    tree = Tree(np.full(len(field), -1, np.int32), none, np.empty(0, np.uint8), np.empty(0, np.float32))
    found = describe(field, scene, tree)
    assert len(found) == 0
    assert (found.thing_of() == -1).all()
    with refused("this field has none"):
        found.thing(0)


def test_a_field_keeps_them(tmp_path, objects):
    field, _ = with_objects()
    field.save(tmp_path / "a.field")
    assert read_manifest(tmp_path / "a.field")["objects"] == 3
    again = load_field(tmp_path / "a.field")
    assert again.objects is not None
    assert again.fingerprint == field.fingerprint
    for name, array in objects.tensors().items():
        assert_array_equal(getattr(again.objects, name), array)
        assert not getattr(again.objects, name).flags.writeable
    again.with_objects(None).save(tmp_path / "a.field", overwrite=True)
    assert not (tmp_path / "a.field/objects.safetensors").exists()
    assert load_field(tmp_path / "a.field").objects is None
    assert read_manifest(tmp_path / "a.field")["objects"] is None


def test_damage_is_told_when_they_are_first_used(tmp_path):
    with_objects()[0].save(tmp_path / "a.field")
    file = tmp_path / "a.field/objects.safetensors"
    content = bytearray(file.read_bytes())
    at = content.find(np.float32(0.7).tobytes())
    content[at : at + 4] = np.float32(0.75).tobytes()  # as fine as before, but not what was written
    file.write_bytes(content)
    field = load_field(tmp_path / "a.field")
    field.scores(np.eye(8, dtype=np.float32)[0])
    with malformed(r"objects\.safetensors: damaged"):
        _ = field.objects


def test_opening_a_field_does_not_read_them(tmp_path, monkeypatch):
    """Which may take longer than all else."""
    with_objects()[0].save(tmp_path / "a.field")
    read = []
    monkeypatch.setattr(loading, "map_tensors", lambda path: read.append(path.name) or map_tensors(path))
    field = load_field(tmp_path / "a.field")
    field.scores(np.eye(8, dtype=np.float32)[0])
    assert set(read) == {"codes.safetensors", "evidence.safetensors"}
    assert field.objects is field.objects
    assert read.count("objects.safetensors") == 1


def test_a_file_of_another_field_is_refused(tmp_path):
    field, _ = with_objects()
    field.save(tmp_path / "a.field")
    replace(field, scene="another").save(tmp_path / "b.field")
    (tmp_path / "a.field/objects.safetensors").write_bytes((tmp_path / "b.field/objects.safetensors").read_bytes())
    with pytest.raises(MismatchError, match="another field"):
        load_field(tmp_path / "a.field").verify()
    (tmp_path / "a.field/objects.safetensors").unlink()
    with malformed("incomplete"):
        load_field(tmp_path / "a.field")


@pytest.mark.parametrize(
    ("name", "index", "value"),
    [
        ("node_of", 0, 6),
        ("node_of", 0, -2),
        ("parents", 0, 0),
        ("parents", 0, 6),
        ("parents", 0, -2),
        ("levels", 0, 3),
        ("levels", 0, 2),
        ("levels", 5, 1),
        ("sure", 0, np.nan),
        ("sure", 0, 1.5),
        ("centers", (0, 0), np.inf),
        ("extents", (0, 0), -1),
        ("extents", (0, 0), np.inf),
        ("axes", (0, 0, 0), 0.5),
        ("axes", (0, 0, 0), np.nan),
        ("axes", (0, 0, 0), 1e200),
        ("masses", 0, np.nan),
        ("masses", 0, np.inf),
        ("num_views", 0, -1),
        ("mask_starts", 0, 1),
        ("mask_starts", 1, 2**62),
        ("mask_starts", 6, 0),
        ("masks", 0, -1),
        ("masks", 0, 10),
        ("shares", 0, np.nan),
        ("shares", 0, 2),
        ("descriptor_starts", 2, -5),
        ("descriptors", (0, 0), 0.5),
        ("descriptors", (0, 0), np.inf),
    ],
)
def test_arrays_that_cannot_be(name, index, value, objects):
    field, _ = with_objects()
    array = getattr(objects, name).copy()
    array[index] = value
    with refused(name.removesuffix("_starts")):
        field.with_objects(replace(objects, **{name: array}))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(ARRAYS))
def test_files_with_arrays_of_another_shape_or_kind(name, tmp_path):
    with_objects()[0].save(tmp_path / "a.field")
    path = tmp_path / "a.field/objects.safetensors"
    tensors, metadata = map_tensors(path)
    array = np.array(tensors[name])
    for other in (array.astype(np.float16), array[None], array[: len(array) // 2]):
        write_tensors(path, {**tensors, name: other}, {"field": metadata["field"]}, overwrite=True)
        with malformed(r"objects\.safetensors"):
            _ = load_field(tmp_path / "a.field").objects
    write_tensors(path, {key: tensors[key] for key in tensors if key != name}, {"field": metadata["field"]}, True)
    with malformed(f"{name}: expected .* got nothing"):
        load_field(tmp_path / "a.field").verify()


def test_objects_of_another_field_are_refused(objects):
    field, _ = with_objects()
    with refused("each of 1490 rows"):
        field.with_objects(replace(objects, node_of=objects.node_of[1:]))
    with refused("descriptors of 7 numbers"):
        field.with_objects(replace(objects, descriptors=np.eye(7, dtype=np.float32)[[0] * len(objects.descriptors)]))
