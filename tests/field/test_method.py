"""The method on one screen gives the bits that the product gives."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import drsplat as ds
from drsplat.field.method import TOPK, coded_features, cosines
from fields import unit_rows
from scenes import look_at_view, random_gaussians, random_mask_map

DIM = 128


@pytest.fixture(scope="module")
def capture() -> tuple[ds.Gaussians, list[ds.View], dict[str, ds.ViewFeatures]]:
    eyes = [(6 * np.cos(t), 6 * np.sin(t), 1.5) for t in (2.0, 0.4, 1.2)]  # not in the order of the names
    views = [look_at_view(eye, width=64, height=48) for eye in eyes]
    views = [ds.View(f"{i}.png", view.K, view.cam_from_world, view.width, view.height) for i, view in enumerate(views)]
    features = {
        view.name: ds.ViewFeatures(random_mask_map(48, 64, 6, seed=i), unit_rows(np.random.default_rng(i), 6, DIM))
        for i, view in enumerate(views)
    }
    return random_gaussians(500, seed=3), views[::-1], features


def test_it_is_what_register_to_field_and_scores_do(capture):
    gaussians, views, features = capture
    query = np.zeros(DIM, np.float32)
    query[[3, 40, 77, 100]] = 0.5  # of length 1 to the bit
    ids, code = coded_features(gaussians, views, features)
    field = ds.register(gaussians, views, features, ds.Sampling(TOPK)).to_field(ds.PQ())
    assert_array_equal(ids, field.gaussian_ids)
    assert_array_equal(code.codes().codes, field.code.codes().codes)
    assert_array_equal(cosines(code, query), field.scores(query))


def test_a_smaller_k_keeps_less(capture):
    assert len(coded_features(*capture, topk=1)[0]) < len(coded_features(*capture)[0])
