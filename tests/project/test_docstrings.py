"""Examples in the docstrings of what is public: each has one, and each runs."""

import doctest
import inspect
import pydoc
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drsplat as ds
from drsplat.field.codes.codebook import save_codebook
from drsplat.formats.moving_scenes import read_scene
from toy_capture import write_balls
from written_captures import write_colmap_text

NEEDS_A_BENCHMARK = "evaluate"
"""Function whose data is that of a paper; docs/evaluation.md has its examples."""


def public() -> Iterator[tuple[str, object]]:
    """Functions of the package, and methods of a scene and of its answers."""
    for name in ds.__all__:
        if inspect.isfunction(getattr(ds, name)) and name != NEEDS_A_BENCHMARK:
            yield name, getattr(ds, name)
    for kind in (ds.Scene, ds.Answer):
        for name, own in inspect.getmembers(kind):
            if not name.startswith("_") and inspect.isfunction(getattr(own, "__func__", own)):
                yield f"{kind.__name__}.{name}", getattr(kind, name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_balls(tmp_path_factory.mktemp("shown"))
    camera = (1, "PINHOLE", 96, 72, (80.0, 80.0, 48.0, 36.0))
    places = ds.read_gaussians(folder / "scene.ply").means.tolist()
    points = [(k, tuple(place), (120, 120, 120)) for k, place in enumerate(places, 1)]
    write_colmap_text(folder / "colmap/sparse/0", [camera], [(1, (1, 0, 0, 0), (0, 0, 1), 1, "a.png")], points)
    vectors = np.random.default_rng(0).normal(size=(1000, 8)).astype(np.float32)
    codebook = ds.train_codebook(vectors, 2, encoder=ds.EncoderIdentity("my encoder", 8))
    save_codebook(codebook, folder / "codebook.safetensors")
    return folder


@pytest.fixture(scope="module")
def film(folder: Path) -> ds.Scene:
    moving = read_scene(folder / "frames")
    views = [replace(view, time=float(k)) for k, view in enumerate(ds.read_views(folder / "capture"))]
    features = ds.read_features(folder / "capture/language_features", encoder=ds.WordEncoder().identity)
    return ds.Scene(ds.register(moving, views, features).to_field(), moving, views)


@pytest.mark.parametrize(("name", "thing"), list(public()), ids=[name for name, _ in public()])
def test_the_example_of_what_is_public_runs(name, thing, folder, film, monkeypatch):
    monkeypatch.chdir(folder)
    scene = ds.open_scene("room.field", scene="scene.ply", views="capture")
    given = {"ds": ds, "np": np, "scene": scene, "film": film}
    examples = doctest.DocTestParser().get_doctest(inspect.getdoc(thing) or "", given, name, None, None)
    assert examples.examples, f"{name} has no example"
    assert doctest.DocTestRunner().run(examples).failed == 0


def test_help_shows_no_addresses():
    for name in ds.__all__:
        thing = getattr(ds, name)
        if callable(thing):
            assert not re.search(r" at 0x[0-9a-f]+", pydoc.plain(pydoc.render_doc(thing))), name
