"""The time that is said to be left, of work whose pace changes."""

from itertools import pairwise

import pytest

from drsplat.base.progress import Meter, seconds_left


def after(costs: list[float], done: int) -> tuple[float, float]:
    """What is said after some items, one mark each, and what is true."""
    total = len(costs)
    marks = [(number, float(sum(costs[1:number]))) for number in range(1, done + 1)]
    return seconds_left(marks, total)[0], sum(costs[done:])


@pytest.mark.parametrize("done", [40, 100, 200, 300, 390])
@pytest.mark.parametrize(
    ("last", "slack"), [(0.1, 0.02), (0.2, 0.1), (0.3, 0.2), (0.05, 0.8)], ids=["steady", "twice", "thrice", "faster"]
)
def test_work_that_grows_evenly_is_foreseen(last, slack, done):
    costs = [0.1 + (last - 0.1) * number / 399 for number in range(400)]
    said, true = after(costs, done)
    assert said == pytest.approx(true, rel=slack)


def test_it_is_nearer_than_the_mean_since_the_beginning():
    """Of training that slows down from 27 to 9 iterations a second, as a real one did."""
    costs = [1 / 27 + (1 / 9 - 1 / 27) * min(number / 300, 1.0) for number in range(400)]
    for done in (40, 80, 160, 240, 320):
        said, true = after(costs, done)
        mean = sum(costs[1:done]) / done * (400 - done)
        assert abs(said - true) < abs(mean - true)
        assert said < 1.6 * true


def test_it_never_says_that_less_than_nothing_is_left():
    marks = [(1, 0.0), (2, 1.0), (3, 1.0), (9, 1.0), (9, 5.0)]
    for end in range(1, len(marks) + 1):
        assert seconds_left(marks[:end], 9)[0] >= 0


def test_a_meter_keeps_few_marks_of_much_work(monkeypatch):
    from drsplat.base import progress

    clock = iter(2.0 * second for second in range(100_000))
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    meter = Meter("work", 5000, quiet=True)
    for done in range(1, 5000):
        left, per_item = meter.left(done)
    assert len(meter._marks) <= progress.MAX_MARKS
    assert meter._marks[0][0] == 1
    assert all(one < other for one, other in pairwise(meter._marks))
    assert (left, per_item) == pytest.approx((2.0, 2.0), rel=0.6)
