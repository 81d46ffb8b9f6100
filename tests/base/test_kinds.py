"""Arguments of another kind: every public name says what was given and what was expected.

The checks are outside of those that the tests are run with, so both runs meet them.
"""

import inspect
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import jaxtyping
import numpy as np
import pytest

import drsplat as ds
from drsplat.base.kinds import _annotations, checked
from drsplat.fronts.viewing.session import Session
from refusing import refused
from toy_capture import balls


class Odd:
    """Of no kind that anything expects."""


def doors() -> Iterator[tuple[str, str]]:
    """Each public name and parameter of it that has a kind."""
    for name in ds.__all__:
        thing = getattr(ds, name)
        function = thing.__init__ if isinstance(thing, type) else thing
        if callable(thing) and hasattr(function, "__wrapped__"):
            for parameter in _annotations(inspect.unwrap(function))[1]:
                yield name, parameter


DOORS = list(doors())


def test_the_doors_are_those_of_all_public_functions_and_classes():
    functions = {name for name in ds.__all__ if inspect.isfunction(getattr(ds, name))}
    made = {"View", "Gaussians", "ViewFeatures", "EncoderIdentity", "TrainingSettings"}
    assert functions | made <= {name for name, _ in DOORS}
    assert len(functions) > 14
    assert len(DOORS) > 60


@pytest.mark.parametrize(("name", "parameter"), DOORS)
def test_another_kind_is_named(name, parameter):
    with refused(rf"^{name}: {parameter}: expected .+, got Odd$"):
        getattr(ds, name)(**{parameter: Odd()})


def test_the_mistakes_that_people_make(edited_room):
    gaussians, views = balls(), ds.read_views(edited_room / "capture")
    features = ds.read_features(edited_room / "capture/language_features", encoder=ds.WordEncoder.identity)
    field = ds.register(gaussians, views, features).to_field()

    mistakes = [
        (r"view: expected View \(one of read_views\(...\)\), got 'frame_1' \(str\)", ds.render, gaussians, "frame_1"),
        (r"gaussians: expected Gaussians .*, got LanguageField", ds.render, field, views[0]),
        (r"text: expected a text or None, got Gaussians", ds.Query, gaussians),
        (r"text: expected a text or None, got list of str", ds.Query, ["mug"]),
        (r"negatives: expected a list of a text or .*, got 'object'", partial(ds.Query, negatives="object"), "mug"),
        (
            r"scene: expected Gaussians \(read_gaussians\(...\)\) or Moving \(.*\), got list of View",
            ds.register, views, gaussians, features,
        ),
        (r"field: expected LanguageField .*, got Gaussians", ds.Scene, gaussians, field),
        (r"K: expected an array \(3 3\), got list", ds.View, "x", [[1, 0], [0, 1]], np.eye(4), 4, 4),
        (r"max_side: expected a whole number or None, got '640'", partial(ds.read_views, max_side="640"), edited_room),
    ]  # fmt: skip
    for said, call, *given in mistakes:
        with refused(said):
            call(*given)


@pytest.mark.parametrize("of", [Annotated, jaxtyping.Float32])
@pytest.mark.parametrize(("shape", "said"), [("n 3", r"an array \(n 3\) or None"), (" n", r"an array \(n\) or None")])
def test_arrays_are_named_by_their_shape_whoever_notes_it(of, shape, said):
    def count(points: of[np.ndarray, shape] | None) -> int:
        return 0 if points is None else len(points)

    door = checked(count)
    assert (door(np.zeros((2, 3), np.float32)), door(None)) == (2, 0)
    with refused(f"^count: points: expected {said}, got list of int$"):
        door([1, 2])


def test_what_is_right_goes_through(edited_room):
    gaussians, views = ds.read_gaussians(str(edited_room / "scene.ply")), ds.read_views(edited_room / "capture")
    drawn = ds.render(gaussians, view=views[0], background=[0.0, 0.0, 0.0], select=np.arange(3))
    assert drawn.rgb.shape == (views[0].height, views[0].width, 3)
    assert ds.render.__doc__ == inspect.unwrap(ds.render).__doc__
    assert list(inspect.signature(ds.render).parameters)[:2] == ["gaussians", "view"]
    with pytest.raises(TypeError, match="unexpected keyword"):
        ds.render(gaussians, views[0], colour=3)


def test_a_warning_points_at_the_line_of_the_caller(edited_room, request):
    if request.config.getoption("jaxtyping_packages", None):
        pytest.skip("type checkers put frames of their own between")
    features = dict(ds.read_features(edited_room / "capture/language_features"))
    features.pop(next(iter(features)))
    views = ds.read_views(edited_room / "capture")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ds.register(balls(), views, features)
    assert [Path(one.filename).name for one in caught] == ["test_kinds.py"]


def test_reprs_are_a_line(edited_room):
    gaussians, views = balls(), ds.read_views(edited_room / "capture")
    features = ds.read_features(edited_room / "capture/language_features", encoder=ds.WordEncoder.identity)
    registration = ds.register(gaussians, views, features)
    field = registration.to_field()
    scene = ds.Scene(field, gaussians, views, ds.WordEncoder, name="balls")
    answer = scene.ask("red mug")
    values = [
        gaussians,
        views[0],
        features,
        features["photo_0"],
        registration,
        field,
        answer,
        scene.locate(answer)[0],
        scene,
    ]
    for value in (*values, Session(scene)):
        said = repr(value)
        assert said.startswith(f"{type(value).__name__}(")
        assert "\n" not in said
        assert "array" not in said
        assert len(said) < 250
    assert repr(features["photo_0"]) == "LevelFeatures(2 masks on 96x72, 512-d)"
    assert repr(field) == "LanguageField(300 of 300 Gaussians, 512-d by drsplat-words, code pq)"
