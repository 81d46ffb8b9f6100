"""Our order of a SAM's mask decoder against transformers' own, number by number."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_sam import fill, library, tiny_model  # noqa: F401  (a fixture)

from drsplat.photos.models.point_decoder import PointDecoder

KINDS = ("sam", "sam2", "sam3_tracker")


@pytest.fixture(scope="module", params=KINDS)
def model(request, library) -> Any:  # noqa: F811
    made = tiny_model(library, request.param)
    fill(made, 0)
    return made


def encoded(model: Any, seed: int = 0) -> Any:
    import torch

    pixels = torch.randn((1, 3, 64, 64), generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        return model.get_image_embeddings(pixels)


def some_points(count: int) -> np.ndarray:
    return np.random.default_rng(count).uniform(0, 64, (count, 2)).astype(np.float32)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_answers_are_those_of_the_model(model, count):
    import torch

    features, points = encoded(model), some_points(count)
    with torch.no_grad():
        masks, iou = PointDecoder(model, features).answers(points)
        asked, labels = torch.from_numpy(points)[None, :, None], torch.ones((1, count, 1), dtype=torch.int64)
        own = model(image_embeddings=features, input_points=asked, input_labels=labels, multimask_output=True)
    spread = float(own.pred_masks.std())
    assert masks.shape == own.pred_masks.shape[1:]
    assert_allclose(masks, own.pred_masks[0], atol=1e-4 * spread)
    assert_allclose(iou, own.iou_scores[0], atol=1e-4)
    assert count == 1 or float((masks[0] - masks[-1]).abs().max()) > 1e-3 * spread  # points have answers of their own


def test_an_image_is_shared_by_all_that_follow(model):
    """What is prepared for an image stays as it is, and another image has other answers."""
    import torch

    points = some_points(3)
    with torch.no_grad():
        image, other = (PointDecoder(model, encoded(model, seed)) for seed in (0, 1))
        first = image.answers(points)[0]
        assert_allclose(image.answers(points)[0], first)
        assert_allclose(image.answers(points[:1])[0], first[:1], atol=1e-4 * float(first.std()))
        assert float((other.answers(points)[0] - first).abs().max()) > 1e-3 * float(first.std())
