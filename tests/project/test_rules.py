"""Rules that answers to words are compared with, and the picture of how many are answered."""

from xml.etree import ElementTree

import numpy as np
import pytest
from benchmarks.suite.chart import Line, Mark, curves
from benchmarks.suite.trimmed import best_clusters, trimmed_means, trimmed_values
from scipy.sparse import csr_array

WEIGHTS = csr_array(np.array([[4.0, 3, 2, 1], [0, 0, 1, 1]]))


def test_a_trimmed_mean_leaves_out_the_masks_least_like_it() -> None:
    """The last mask, a tenth of the first node's weight, shows the opposite."""
    embeddings = np.array([[1, 0.1], [1, 0], [1, -0.1], [-1, 0]], np.float32)
    plain, trimmed = (trimmed_means(WEIGHTS, embeddings, share) for share in (0.0, 0.1))
    np.testing.assert_allclose(plain[0], np.array([8, 0.2]) / np.hypot(8, 0.2), atol=1e-6)
    np.testing.assert_allclose(trimmed[0], np.array([9, 0.2]) / np.hypot(9, 0.2), atol=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.25, 0.4])
def test_a_trimmed_mean_of_values_is_that_of_as_many_copies(share: float) -> None:
    values = np.array([0.9, 0.1, 0.5, 0.3], np.float32)
    copies = np.sort(np.repeat(values, 100 * np.array([4, 3, 2, 1])))
    out = round(share * len(copies))
    expected = copies[out : len(copies) - out].mean()
    assert trimmed_values(WEIGHTS, values, share)[0] == pytest.approx(expected, abs=1e-6)


def test_clusters_of_a_fifth_of_the_weight_speak_for_a_node() -> None:
    """A few wrong masks say nothing of the first node; the second has none; of small ones the first speaks."""
    values = np.array([0.4, 0.6, 0.9, 0.3, 0.8], np.float32)
    shares, starts = np.array([0.5, 0.4, 0.1, 0.1, 0.1]), np.array([0, 3, 3, 5])
    np.testing.assert_array_equal(best_clusters(values, shares, starts), np.array([0.6, -1, 0.3], np.float32))
    assert not len(best_clusters(values[:0], shares[:0], np.array([0])))


def test_curves_name_their_lines_and_marks() -> None:
    drawn = curves("Title", "x", "y", [Line("ours", [100, 0], [100, 50], [Mark("sure", 0, 50)]), Line("b", [0], [0])])
    texts = [one.text for one in ElementTree.fromstring(drawn).iter() if one.tag.endswith("text")]
    assert {"Title", "ours", "b", "sure", "x", "y"} <= {*texts}
    assert drawn.count("<polyline") == 2
    assert drawn.count("<circle") == 1
