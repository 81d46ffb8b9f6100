"""A small scene whose views see different parts of it, and fields of any of them, registered at once or grown."""

import os
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from drsplat.field import LanguageField, learning
from drsplat.field.codes import CodeSpecification
from drsplat.field.evidence.aggregation import AGGREGATORS, Sampling
from drsplat.field.registration import register
from drsplat.formats.replacing import LOCK
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.views import View
from scenes import look_at_view, random_gaussians, random_mask_map

DIM, COUNT = 8, 7


@lru_cache
def scene() -> Gaussians:
    return random_gaussians(260, seed=3, size=0.1)


@lru_cache
def views() -> tuple[View, ...]:
    """Each looks at a corner of its own, so that most Gaussians are not seen by most views; the first two at one."""
    rng = np.random.default_rng(5)
    targets = rng.uniform(-1.3, 1.3, (COUNT, 3))
    targets[1] = targets[0]
    eye = np.array((2.5, 0.4, 1))
    found = [look_at_view(target + eye, target, width=40, height=30, fov_degrees=28) for target in targets]
    return tuple(replace(view, name=f"{number:03d}.png") for number, view in enumerate(found))


@lru_cache
def features(seed: int = 0) -> dict[str, ViewFeatures]:
    """In the first two views, which see the same, a mask says the opposite: what it alone covers has no feature."""
    found = {}
    for number, view in enumerate(views()):
        rows = np.random.default_rng([seed, number]).normal(size=(3, DIM)).astype(np.float32)
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        masks = random_mask_map(view.height, view.width, 3, hole_share=0.4, seed=max(number, 1))
        if number < 2:  # along an axis: products are then exact
            rows[np.bincount(masks[masks >= 0]).argmax()] = np.eye(DIM)[0] * (1 - 2 * number)
        found[view.name] = ViewFeatures(masks, rows)
    return found


def at_once(names: tuple[str, ...], code: CodeSpecification, aggregator: str = "mean", seed: int = 0) -> LanguageField:
    """The field of some views. It depends on how many of them codes are learnt from, which some tests change."""
    return _at_once(names, code, aggregator, seed, learning.MAX_LEARNING_VIEWS)


@cache
def _at_once(names: tuple[str, ...], code: CodeSpecification, aggregator: str, seed: int, _: int) -> LanguageField:
    chosen = [view for view in views() if view.name in names]
    sampling = AGGREGATORS[aggregator].sampling or Sampling(6)
    registration = register(scene(), chosen, {name: features(seed)[name] for name in names}, sampling)
    return registration.to_field(code, aggregator=aggregator, gaussians=scene())


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


class Killed(BaseException):
    """What a process does not survive."""


@contextmanager
def killed_at(step: int, monkeypatch_context: Callable[[], object]) -> Iterator[list[str]]:
    """In the block, the `step`-th change of the disk does not happen, and none after it, nor any cleaning up.

    Yields the changes so far.
    """
    done: list[str] = []
    with monkeypatch_context() as patch:  # type: ignore[attr-defined]
        for module, name in ((os, "fsync"), (os, "replace"), (os, "rename"), (os, "unlink"), (os, "rmdir"),
                             (os, "mkdir"), (shutil, "rmtree")):  # fmt: skip
            patch.setattr(module, name, _fatal(getattr(module, name), name, done, step))
        from drsplat.formats import field_folder

        patch.setattr(field_folder, "_exchange", _fatal(field_folder._exchange, "exchange", done, step))
        yield done


def _fatal(change: Callable[..., object], name: str, done: list[str], step: int) -> Callable[..., object]:
    def changes(*given: object, **named: object) -> object:
        done.append(name)
        if len(done) > step and str(given[0]).endswith(LOCK):
            return None  # or it would not be closed, as the kernel does
        if len(done) > step:
            raise Killed
        return change(*given, **named)

    return changes


def remaining(names: Collection[str]) -> tuple[str, ...]:
    return tuple(sorted(names))
