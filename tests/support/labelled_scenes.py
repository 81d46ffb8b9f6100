"""A scene with everything that a file can carry beside its Gaussians, none of it at zero or upright."""

from dataclasses import replace

import numpy as np

from drsplat.scene.labelled import Annotation, LabelledScene, Thing
from scene_files import random_gaussians

TURNED = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
NAMES = (
    'red "mug" \\ x', "<b>é 🦊</b>", "../a/b\\c", "line\none\ttwo\x01\x7f", "7 up", "'''\"\"\"", "日本", "red mug",
    "red mug", "# no comment", "a" * 300,
)  # fmt: skip
"""Names that other places would take for markup, paths or the end of a text."""


def labelled(count: int = 40, degree: int = 3, names: tuple[str, ...] = NAMES) -> LabelledScene:
    """Make a scene of objects, a group, the answer to a query, a match and annotations."""
    rng = np.random.default_rng(0)
    gaussians = replace(random_gaussians(rng, count, degree), origin=np.array([5e5, 4e6, 100.25]))
    unit = np.float32([0.6, 0.8])
    things = tuple(
        Thing(
            name, number / 100, np.array([number, 1 / 3, -2.0]), TURNED, np.array([1.0, 2.0, 0.1]), number % 2 - 1,
            unit, 2 * number,
        )
        for number, name in enumerate(names)
    )  # fmt: skip
    notes = (
        Annotation.at("a point", [1, 2, 3]),
        Annotation.box("a box", np.array([1.0, 2, 3]), TURNED, np.array([1.0, 2, 3])),
    )
    group = Thing("dishes", 0.75, np.ones(3), np.eye(3), np.ones(3))
    return LabelledScene(
        gaussians, "room é", things, (group,), (np.arange(count) % (len(names) + 1) - 1).astype(np.int32), "red mug",
        rng.uniform(size=count).astype(np.float32), things[:1], notes, (0.6, 0.0, 0.8), "an encoder",
    )  # fmt: skip
