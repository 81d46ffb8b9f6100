"""Registration of scenes that move: each view with the scene at its time, into one field."""

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drsplat import PQ, load_field, register
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.field import LanguageField
from drsplat.field.evidence.aggregation import Sampling
from drsplat.field.evidence.columns import MovingScenery, part_name
from drsplat.field.growing import add_views, change_field, remove_views, with_weights_of
from drsplat.field.registration import Registration
from drsplat.scene.moving import Frames, Moving
from drsplat.scene.views import View
from growing_fields import Killed, features, files_of, scene, views
from moving_scenes import still
from refusing import refused

TOP = Sampling(6)
CODE = PQ(4)


def timed(times: np.ndarray | None = None) -> list[View]:
    stamps = np.linspace(0, 1, len(views())) if times is None else times
    return [replace(view, time=float(time)) for view, time in zip(views(), stamps, strict=True)]


def sliding() -> Moving:
    """All of it, to the side, so far that cameras see others at other times."""
    stamps = np.array([0.0, 0.4, 1.0])

    def frame(number: int):
        return replace(scene(), means=scene().means + np.float32([0, stamps[number], 0]))

    return Moving(scene(), stamps, Frames(stamps, frame))


def parts_of(one: Registration) -> list[np.ndarray]:
    weights = one.weights
    provenance = one.provenance
    return [weights.data, weights.indices, weights.indptr, one.embeddings, provenance.keys, provenance.axes]


@pytest.fixture(autouse=True)
def only_our_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="the photos have times", category=DrSplatWarning)
        yield


@pytest.mark.slow
@settings(max_examples=15)
@given(times=st.lists(st.floats(0, 1), min_size=7, max_size=7))
def test_what_stands_still_is_registered_to_the_bit_as_a_still_scene(times):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        one = register(still(scene()), timed(np.array(times)), features(), TOP)
        other = register(scene(), views(), features(), TOP)
    assert all(np.array_equal(a, b) for a, b in zip(parts_of(one), parts_of(other), strict=True))
    assert one.masks.times.tolist() == times
    assert (one.scene, one.sampling, other.masks.times) == (other.scene, other.sampling, None)


def test_each_view_is_given_the_scene_at_its_time():
    """W's columns of a view are those of a still scene that is where the moving one is then."""
    moving = sliding()
    whole = register(moving, timed(), features(), TOP)
    for number, view in enumerate(timed()):
        assert view.time is not None
        at = moving.at(view.time)
        sampling = replace(TOP, near=scene().near)
        alone = register(replace(at), [view], {view.name: features()[view.name]}, sampling)
        columns = whole.weights[:, whole.masks.views == number]
        assert (columns != alone.weights).nnz == 0
    assert (whole.weights != register(scene(), views(), features(), TOP).weights).nnz


def test_a_moving_scene_seen_by_a_moving_camera_stands_still():
    """Where all things and the camera go along together, W is that of the still scene, but for rounding."""
    moving = sliding()
    shifted = []
    for view in timed():
        pose = view.cam_from_world.copy()
        assert view.time is not None
        pose[:3, 3] -= pose[:3, :3] @ (moving.at(view.time).means[0] - scene().means[0]).astype(np.float64)
        shifted.append(replace(view, cam_from_world=pose))
    one = register(moving, shifted, features(), Sampling(None))
    other = register(scene(), views(), features(), Sampling(None))
    assert abs(one.weights - other.weights).max() < 2e-3 * other.weights.max()


def test_rows_that_are_not_there_at_a_time_are_not_seen_then():
    """Opacities over time are used."""
    stamps = np.array([0.0, 1.0])
    gone = np.arange(len(scene())) % 2 == 0

    def frame(number):
        return replace(scene(), opacities=np.where(gone & (number == 1), np.float32(0), scene().opacities))

    moving = Moving(scene(), stamps, Frames(stamps, frame))
    late = register(moving, timed(np.ones(7)), features(), TOP)
    early = register(moving, timed(np.zeros(7)), features(), TOP)
    assert late.weights[gone].nnz == 0 < early.weights[gone].nnz


def test_a_view_without_a_time_is_told():
    some = [replace(view, time=None) if number == 3 else view for number, view in enumerate(timed())]
    with refused(r"view '003\.png' has no time, and the scene moves: give times="):
        register(sliding(), some, features(), TOP)


def test_a_time_outside_of_the_span_is_told():
    with refused("time 3 is outside of this scene's span"):
        register(sliding(), timed(np.full(7, 3.0)), features(), TOP)


def test_times_of_a_scene_that_stands_still_are_told():
    with pytest.warns(DrSplatWarning, match="the photos have times, but this scene stands still"):
        made = register(scene(), timed(), features(), TOP)
    assert made.masks.times is None


def test_times_of_another_unit_are_told():
    with pytest.warns(DrSplatWarning, match="are both of one unit"):
        register(sliding(), timed(np.linspace(0, 0.01, 7)), features(), TOP)


def field_of(names: list[str], moving: Moving | None = None) -> LanguageField:
    chosen = [view for view in timed() if view.name in names]
    return register(moving or sliding(), chosen, {name: features()[name] for name in names}, TOP).to_field(CODE)


def test_a_field_keeps_the_times_of_its_views(tmp_path):
    field = field_of([view.name for view in views()])
    field.save(tmp_path / "a.field")
    again = load_field(tmp_path / "a.field")
    assert again.times.tolist() == [view.time for view in timed()]
    assert again.equals(field)
    assert register(scene(), views(), features(), TOP).to_field(CODE).times is None


NAMES = [view.name for view in views()]


def test_views_come_and_go_to_the_bit(tmp_path):
    whole = field_of(NAMES)
    grown = add_views(field_of(NAMES[::2]), sliding(), timed(), features()).field
    assert grown.equals(whole)
    fewer = remove_views(whole, sliding(), NAMES[1::2]).field
    assert set(fewer.growth.removed) == set(NAMES[1::2])
    assert replace(fewer, growth=replace(fewer.growth, removed=())).equals(field_of(NAMES[::2]))
    field_of(NAMES[::2]).save(tmp_path / "a.field")
    change_field(tmp_path / "a.field", sliding(), lambda field: add_views(field, sliding(), timed(), features()))
    whole.save(tmp_path / "b.field")
    assert files_of(tmp_path / "a.field") == files_of(tmp_path / "b.field")


def test_views_that_are_others_now_are_replaced():
    """Another time is another view of the scene."""
    later = [replace(view, time=1.0) if view.name == NAMES[2] else view for view in timed()]
    change = add_views(field_of(NAMES), sliding(), later, features(), renew=True)
    assert change.replaced == (NAMES[2],)
    assert change.field.times[2] == 1.0


def test_a_field_of_a_film_takes_no_still_scene_and_the_reverse():
    field = field_of(NAMES[:4])
    with pytest.raises(MismatchError, match="registered with a scene that moves, the given one stands still"):
        add_views(field, scene(), views(), features())
    static = register(scene(), views()[:4], {name: features()[name] for name in NAMES[:4]}, TOP).to_field(CODE)
    with pytest.raises(MismatchError, match="registered with a scene that stands still, the given one moves"):
        add_views(static, sliding(), timed(), features())
    with pytest.raises(MismatchError, match="of a scene that moves"):
        Registration.from_field(field).merged(register(scene(), views()[4:], dict(list(features().items())[4:]), TOP))


def test_another_encoder_takes_the_weights_of_a_film():
    field = field_of(NAMES)
    swapped = with_weights_of(field, sliding(), timed(), features(1))
    full = register(sliding(), timed(), features(1), TOP)
    assert all(np.array_equal(a, b) for a, b in zip(parts_of(swapped), parts_of(full), strict=True))
    assert swapped.masks.times is not None
    with pytest.raises(MismatchError, match="other masks or poses"):
        with_weights_of(field, sliding(), timed(np.linspace(1, 0, 7)), features(1))


def test_a_killed_registration_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    looked = []
    seen = MovingScenery.visible_splats

    def dying(self, view):
        if len(looked) == 4:
            raise Killed
        looked.append(view.name)
        return seen(self, view)

    with monkeypatch.context() as patch:
        patch.setattr(MovingScenery, "visible_splats", dying)
        with pytest.raises(Killed):
            register(sliding(), timed(), features(), TOP, parts=tmp_path / "parts")
    assert all((tmp_path / "parts" / part_name(name)).exists() for name in looked)
    looked[:] = ["none"] * 5
    monkeypatch.setattr(MovingScenery, "visible_splats", dying)
    again = register(sliding(), timed(), features(), TOP, parts=tmp_path / "parts")
    assert len(looked) == 5 + 3  # only those that were not there
    once = register(sliding(), timed(), features(), TOP)
    assert all(np.array_equal(a, b) for a, b in zip(parts_of(again), parts_of(once), strict=True))


def test_parts_of_another_time_are_not_taken(tmp_path):
    register(sliding(), timed(np.zeros(7)), features(), TOP, parts=tmp_path)
    late = register(sliding(), timed(np.ones(7)), features(), TOP, parts=tmp_path)
    assert (late.weights != register(sliding(), timed(np.ones(7)), features(), TOP).weights).nnz == 0
