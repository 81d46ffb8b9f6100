"""How objects lie to each other: a table with a bowl, an apple in it, a mug, a lamp above, chairs, a wall."""

import numpy as np
import pytest

from drsplat import Gaussians, Match
from drsplat.kernels.boxes import box_of
from drsplat.query.relations import RELATIONS, related
from refusing import refused

UP = np.array([0.0, 0, 1])


def filled(low: tuple[float, float, float], high: tuple[float, float, float], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (400, 3))


def bowl() -> np.ndarray:
    """A floor and a wall around it."""
    angles = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    heights = np.tile(np.linspace(0.8, 0.95, 10), 30)
    wall = np.stack([0.3 + 0.15 * np.cos(angles), 0.15 * np.sin(angles), heights], axis=1)
    return np.concatenate([wall, filled((0.2, -0.1, 0.79), (0.4, 0.1, 0.81))])


def table() -> np.ndarray:
    legs = [filled((x, y, 0.0), (x + 0.05, y + 0.05, 0.75)) for x in (-0.8, 0.75) for y in (-0.5, 0.45)]
    return np.concatenate([filled((-0.8, -0.5, 0.75), (0.8, 0.5, 0.79)), *legs])


THINGS = {
    "table": table(),
    "bowl": bowl(),
    "apple": filled((0.25, -0.05, 0.82), (0.35, 0.05, 0.92)),
    "mug": filled((-0.1, -0.05, 0.79), (0.0, 0.05, 0.9)),
    "plate": filled((-0.6, -0.1, 0.79), (-0.4, 0.1, 0.81)),
    "lamp": filled((0.2, -0.1, 1.6), (0.4, 0.1, 1.8)),
    "chair below": filled((-0.2, -0.3, 0.0), (0.2, 0.1, 0.45)),
    "chair beside": filled((-0.2, 0.8, 0.0), (0.2, 1.2, 0.9)),
    "chair far away": filled((4.0, 0.8, 0.0), (4.4, 1.2, 0.9)),
}


@pytest.fixture(scope="module")
def room() -> tuple[Gaussians, dict[str, Match]]:
    points = np.concatenate(list(THINGS.values())).astype(np.float32)
    n = len(points)
    quats = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    full = np.full((n, 3), 0.005, np.float32), np.full(n, 0.9, np.float32), np.zeros((n, 1, 3), np.float32)
    gaussians = Gaussians(points, quats, *full)
    ends = np.cumsum([0, *(len(thing) for thing in THINGS.values())])
    matches = {}
    for number, name in enumerate(THINGS):
        ids = np.arange(ends[number], ends[number + 1])
        matches[name] = Match(*box_of(gaussians, ids, UP), 1.0, ids, object_id=number)
    return gaussians, matches


@pytest.mark.parametrize(
    ("relation", "to", "expected"),
    [
        ("on", ("table",), {"bowl", "mug", "plate", "apple"}),
        ("on", ("mug",), set()),
        ("in", ("bowl",), {"apple"}),
        ("in", ("table",), set()),  # the chair below it is not, nor is what stands on it
        ("in", ("apple",), set()),
        ("above", ("table",), {"lamp"}),
        ("above", ("apple",), {"lamp"}),
        ("above", ("lamp",), set()),
        ("above", ("chair below",), {"mug"}),  # the table's own middle is elsewhere
        ("under", ("table",), {"chair below"}),
        ("under", ("lamp",), {"bowl", "apple", "table"}),
        ("under", ("apple",), {"table"}),
        ("under", ("chair far away",), set()),
        ("next_to", ("table",), {"chair below", "chair beside"}),
        ("next_to", ("chair far away",), set()),
        ("next_to", ("bowl",), {"mug"}),
        ("between", ("plate", "bowl"), {"mug"}),
        ("between", ("bowl", "plate"), {"mug"}),
        ("between", ("lamp", "apple"), set()),
        ("between", ("chair beside", "chair far away"), set()),
    ],
)
def test_relations(relation, to, expected, room):
    gaussians, matches = room
    found = related(gaussians, relation, list(matches.values()), *(matches[name] for name in to), up=UP)
    assert {name for name, match in matches.items() if match in found} == expected


@pytest.mark.parametrize("relation", RELATIONS)
def test_up_may_be_any_direction(relation, room):
    """The room, turned: nothing else changes."""
    gaussians, matches = room
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    means = (gaussians.means @ turn.T).astype(np.float32)
    turned = Gaussians(means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    up = turn @ UP
    others = {
        name: Match(*box_of(turned, one.gaussian_ids, up), 1.0, one.gaussian_ids, object_id=one.object_id)
        for name, one in matches.items()
    }
    for name in ("table", "bowl"):
        ends = (name, "plate") if relation == "between" else (name,)
        found, expected = (
            related(scene, relation, list(every.values()), *(every[end] for end in ends), up=up_)
            for scene, every, up_ in ((turned, others, up), (gaussians, matches, UP))
        )
        assert [one.object_id for one in found] == [one.object_id for one in expected]


def test_what_shares_its_gaussians_is_itself(room):
    """Words find the table with what stands on it."""
    gaussians, matches = room
    ids = np.concatenate([matches["table"].gaussian_ids, matches["mug"].gaussian_ids])
    both = Match(*box_of(gaussians, ids, UP), 0.5, ids)
    found = related(gaussians, "on", list(matches.values()), both, up=UP)
    assert not {matches["table"].object_id, matches["mug"].object_id} & {one.object_id for one in found}


def test_what_cannot_be_told(room):
    gaussians, matches = room
    every = list(matches.values())
    with refused("which way is up"):
        related(gaussians, "on", every, every[0])
    with refused("expected two objects"):
        related(gaussians, "between", every, every[0], up=UP)
    with refused("expected one object"):
        related(gaussians, "on", every, every[0], every[1], UP)
