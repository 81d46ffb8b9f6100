"""Registration: W by hand and by twin, shards, resuming, new encoders, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng

from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.field.evidence.aggregation import Sampling
from drsplat.field.registration import Registration, register
from drsplat.formats.langsplat import read_features, write_features
from drsplat.kernels import splat_arrays, view_weights
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.lens import distort_points
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.views import View, same_aspect
from fields import unit_rows
from refusing import refused
from scenes import look_at_view, random_gaussians, random_mask_map
from twins import registering as reference

DIM = 32


def named_view(i: int) -> View:
    angle = 0.9 * i
    view = look_at_view((6 * np.cos(angle), 6 * np.sin(angle), 1.0 + 0.2 * i), width=64, height=48)
    return View(f"{i:03d}.png", view.K, view.cam_from_world, view.width, view.height)


def capture(count: int = 4, masks: int = 5) -> tuple[list[View], dict[str, ViewFeatures]]:
    views = [named_view(i) for i in range(count)]
    features = {
        view.name.removesuffix(".png"): ViewFeatures(
            random_mask_map(view.height, view.width, masks, seed=i), unit_rows(default_rng(i), masks, DIM)
        )
        for i, view in enumerate(views)
    }
    return views, features


@pytest.fixture(scope="module")
def gaussians():
    return random_gaussians(400, seed=3)


@pytest.fixture(scope="module")
def registration(gaussians):
    views, features = capture()
    return register(gaussians, views, features, sampling=Sampling(10))


def same(a: Registration, b: Registration) -> bool:
    left, right = a.weights, b.weights
    return (
        a.masks.view_names == b.masks.view_names
        and np.array_equal(left.indptr, right.indptr)
        and np.array_equal(left.indices, right.indices)
        and np.array_equal(left.data, right.data)
        and np.array_equal(a.embeddings, b.embeddings)
        and np.array_equal(a.masks.ids, b.masks.ids)
    )


def test_columns_are_those_of_the_twin(gaussians, registration):
    views, features = capture()
    dense = registration.weights.toarray()
    for i, view in enumerate(views):
        twin = reference.view_weights(splat_arrays(gaussians), view, features[f"{i:03d}"].mask_ids, 10)
        expected = np.zeros((len(gaussians), 5))
        expected[twin.gaussian_ids, twin.mask_ids] = twin.weights
        ours = dense[:, registration.masks.views == i]
        assert np.abs(ours - expected).sum() <= 1e-4 * expected.sum()


@settings(max_examples=12, derandomize=True)
@given(st.permutations(range(4)), st.sampled_from([1, 2, 3]))
def test_neither_the_order_of_views_nor_the_number_of_threads_matters(order, threads):
    gaussians, (views, features) = random_gaussians(400, seed=3), capture()
    shuffled = register(gaussians, [views[i] for i in order], features, sampling=Sampling(10), threads=threads)
    assert same(shuffled, register(gaussians, views, features, sampling=Sampling(10)))


@settings(max_examples=8, derandomize=True)
@given(st.sets(st.integers(0, 3), min_size=1, max_size=3))
def test_merged_shards_are_one_pass(first):
    gaussians, (views, features) = random_gaussians(400, seed=3), capture()
    shards = [
        register(gaussians, [views[i] for i in part], features, sampling=Sampling(10))
        for part in (sorted(first), sorted(set(range(4)) - first))
    ]
    assert same(shards[0].merged(shards[1]), register(gaussians, views, features, sampling=Sampling(10)))


def test_a_second_run_computes_nothing_and_a_damaged_part_again(tmp_path, gaussians, registration):
    views, features = capture()
    first = register(gaussians, views, features, sampling=Sampling(10), parts=tmp_path)
    parts = sorted(tmp_path.iterdir())
    stamps = [part.stat().st_mtime_ns for part in parts]
    assert len(parts) == len(views)
    assert same(first, registration)
    parts[0].write_bytes(parts[0].read_bytes()[:50])
    again = register(gaussians, views, features, sampling=Sampling(10), parts=tmp_path)
    assert same(again, registration)
    assert [part.stat().st_mtime_ns for part in parts][1:] == stamps[1:]
    assert parts[0].stat().st_size > 50
    for at in (-1, -400, 12, 200):  # a flipped bit among the weights, the Gaussians, in the header
        good = parts[1].read_bytes()
        bad = bytearray(good)
        bad[at] ^= 1
        parts[1].write_bytes(bad)
        assert same(register(gaussians, views, features, sampling=Sampling(10), parts=tmp_path), registration)
        assert parts[1].read_bytes() == good


@pytest.mark.parametrize("change", ["topk", "first_hits", "scene", "camera", "mask"])
def test_parts_of_other_settings_are_not_used(change, tmp_path, gaussians):
    views, features = capture(1)
    register(gaussians, views, features, sampling=Sampling(10), parts=tmp_path)
    settings_ = Sampling(10)
    if change == "topk":
        settings_ = Sampling(2)
    if change == "first_hits":
        settings_ = Sampling(10, 3)
    if change == "scene":
        gaussians = random_gaussians(400, seed=4)
    if change == "camera":
        views = [View("000.png", views[0].K, named_view(2).cam_from_world, 64, 48)]
    if change == "mask":
        features = {"000": ViewFeatures(random_mask_map(48, 64, 5, seed=9), unit_rows(default_rng(0), 5, DIM))}
    resumed = register(gaussians, views, features, parts=tmp_path, sampling=settings_)
    assert same(resumed, register(gaussians, views, features, sampling=settings_))


def test_another_encoder_needs_no_photo(gaussians, registration):
    views, features = capture()
    other = EncoderIdentity("other", 16)
    wide = np.concatenate([unit_rows(default_rng(100 + i), 5, 16) for i in range(4)])
    swapped = registration.with_embeddings(wide, other)
    fresh = register(
        gaussians,
        views,
        {
            k: ViewFeatures(f.mask_ids, unit_rows(default_rng(100 + i), 5, 16))
            for i, (k, f) in enumerate(features.items())
        },
        sampling=Sampling(10),
    )
    assert same(swapped, fresh)
    assert swapped.encoder == other
    with refused("one per mask"):
        registration.with_embeddings(wide[1:], other)


def test_a_field_gives_its_registration_back(registration):
    field = registration.to_field()
    back = Registration.from_field(field)
    assert same(back, registration)
    assert len(field) == registration.num_registered
    bare = type(field)(*(getattr(field, n) for n in ("gaussian_ids", "code", "encoder", "scene", "num_gaussians")))
    with refused("no evidence"):
        Registration.from_field(bare)


def test_masks_are_resized_to_the_view_by_nearest_pixel(gaussians):
    view = named_view(0)
    small = random_mask_map(24, 32, 5, seed=1)
    large = np.repeat(np.repeat(small, 2, 0), 2, 1)
    a = register(gaussians, [view], {"000": ViewFeatures(small, unit_rows(default_rng(0), 5, DIM))})
    b = register(gaussians, [view], {"000": ViewFeatures(large, unit_rows(default_rng(0), 5, DIM))})
    assert same(a, b)


def test_views_without_features_are_named(gaussians):
    views, features = capture(3)
    del features["001"]
    with pytest.warns(DrSplatWarning, match=r"1 of 3 views have no features: 001\.png"):
        partial = register(gaussians, views, features)
    assert partial.masks.view_names == ("000.png", "002.png")


def test_what_does_not_belong_together_is_refused(gaussians, registration):
    views, features = capture(2)
    with refused(r"views are named like '000\.png', features like 'elsewhere'"):
        register(gaussians, views, {"elsewhere": features["000"]})
    mixed = features | {"001": ViewFeatures(features["001"].mask_ids, unit_rows(default_rng(0), 5, 8))}
    with refused(r"different sizes: 32 .*8 "):
        register(gaussians, views, mixed)
    with refused("4 views are in both"):
        registration.merged(registration)
    other = register(random_gaussians(400, seed=5), views, features)
    with pytest.raises(MismatchError, match="cannot merge"):
        registration.merged(other)


def test_each_stage_that_takes_long_can_be_followed(gaussians):
    views, features = capture(4)
    told = {}

    def follow(items, description):
        for item in items:
            told[description] = told.get(description, 0) + 1
            yield item

    followed = register(gaussians, views, features, sampling=Sampling(20), track=follow)
    field = followed.to_field(track=follow)
    assert told.keys() == {"registering views", "training the codebook", "coding Gaussians"}
    assert told["registering views"] == 4
    assert field.fingerprint == register(gaussians, views, features, sampling=Sampling(20)).to_field().fingerprint


def test_two_views_may_not_share_a_file_of_features(gaussians, tmp_path):
    """A folder finds its files by several names; that must not hide that they are the same."""
    view, features = named_view(0), capture(1)[1]["000"]
    nested = [View(f"{c}/000.png", view.K, view.cam_from_world, 64, 48) for c in ("left", "right")]
    write_features(tmp_path, "000", features.mask_ids, features.embeddings)
    assert register(gaussians, nested[:1], read_features(tmp_path)).num_registered > 0
    with refused(r"'left/000\.png' and 'right/000\.png' both find"):
        register(gaussians, nested, read_features(tmp_path))


def test_masks_lie_on_the_photo_as_stored():
    """Through a lens, one small Gaussian is seen elsewhere than in the pinhole: its mask is there."""
    camera = look_at_view((0, 0, -6), (0, 0, 0), width=64, height=48)
    view = replace(camera, name="000.png", distortion=(-0.6, 0.0, 0.0, 0.0))
    gaussian = random_gaussians(1, seed=0)
    gaussian = replace(
        gaussian,
        means=np.float32([[2.4, 1.8, 0]]),
        scales=np.full((1, 3), 0.01, np.float32),
        opacities=np.float32([0.9]),
    )
    in_camera = view.cam_from_world @ [2.4, 1.8, 0, 1]
    in_pinhole = (view.K @ in_camera[:3])[:2] / in_camera[2]
    on_photo = distort_points(view, in_pinhole)
    assert np.linalg.norm(on_photo - in_pinhole) > 3

    def weight_of_a_mask_around(place):
        ids = np.full((48, 64), -1, np.int32)
        x, y = np.floor(place).astype(int)
        ids[y - 1 : y + 2, x - 1 : x + 2] = 0
        features = {"000": ViewFeatures(ids, unit_rows(default_rng(0), 1, DIM))}
        return float(register(gaussian, [view], features).weights.sum())

    assert weight_of_a_mask_around(on_photo) > 0.5
    assert weight_of_a_mask_around(in_pinhole) == 0


def test_a_view_that_sees_nothing_adds_empty_columns(gaussians):
    away = look_at_view((0, 0, 50), (0, 0, 90), width=64, height=48)
    view = View("000.png", away.K, away.cam_from_world, 64, 48)
    features = {"000": capture(1)[1]["000"]}
    empty = register(gaussians, [view], features)
    assert empty.weights.shape == (400, 5)
    assert empty.weights.nnz == 0
    with refused("no Gaussian is under any mask"):
        empty.to_field()


def test_first_hits_can_lose_weight_that_topk_keeps(gaussians):
    view, masks = named_view(0), random_mask_map(48, 64, 5, seed=0)
    arrays = splat_arrays(gaussians)
    exact = view_weights(arrays, view, masks, 5).weights.sum(dtype=float)
    capped = view_weights(arrays, view, masks, 5, first_hits=5).weights.sum(dtype=float)
    assert capped < exact


def test_masks_of_another_shape_are_refused(gaussians):
    views, features = capture()
    name = views[0].name
    turned, stem = dict(features), name.removesuffix(".png")
    kept = features[stem]
    turned[stem] = ViewFeatures(np.ascontiguousarray(np.rot90(kept.mask_ids)), kept.embeddings)
    with pytest.raises(MismatchError, match=rf"masks of '{name}' are .* another aspect ratio"):
        register(gaussians, views, turned)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ((1080, 1920), (607, 1080), True),  # LangSplat scales so, and rounds down
        ((3024, 4032), (809, 1080), True),
        ((1920, 1080), (1440, 1080), False),
        ((1920, 1080), (1080, 1920), False),
        ((64, 48), (48, 64), False),
        ((4032, 3024), (1440, 1080), True),
        ((1000, 999), (1000, 1000), True),
        ((640, 480), (8, 6), True),
        ((500, 375), (31, 23), True),
        ((640, 480), (1, 1), False),
        ((640, 480), (2, 2), False),
        ((1920, 1080), (3, 1), False),
        ((640, 640), (1, 1), True),
    ],
)
def test_rasters_of_the_same_shape(one, other, same):
    assert same_aspect(one, other) is same
    assert same_aspect(other, one) is same
