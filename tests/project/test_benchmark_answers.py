"""What answers to words in the benchmark are scored by."""

import doctest

import numpy as np
import pytest
from benchmarks.suite import answers, numbers, reading, stamps, tables


@pytest.mark.parametrize("module", [numbers, reading, stamps, tables])
def test_examples_in_docstrings(module):
    found = doctest.testmod(module)
    assert found.attempted
    assert not found.failed


def test_the_best_threshold_is_the_best_of_all():
    rng = np.random.default_rng(1)
    values, meant, mass = rng.random(30), rng.random(30) < 0.4, rng.random(30)
    every = [(mass * ((values >= cut) & meant)).sum() / (mass * ((values >= cut) | meant)).sum() for cut in values]
    cut, best = answers.best_cut(values, meant, mass)
    assert (cut, best) == (values[int(np.argmax(every))], pytest.approx(max(every)))


def test_no_threshold_parts_equal_values():
    meant = np.array([True, True, False, False])
    assert answers.best_iou(np.ones(4), meant, np.ones(4)) == 0.5
