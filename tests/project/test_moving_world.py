"""The rooms of the world in which things move, and what is found in them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from world.moving import FIXED, KINDS, TIMES, Film, make_film, write_film

from drsplat import Mixture, Scene, WordEncoder, open_scene, register
from drsplat.cli import main
from drsplat.kernels.boxes import box_of
from drsplat.scene.boxes import solid
from drsplat.scene.moving import Frames, Moving


@pytest.mark.slow
def test_the_same_seed_makes_the_same_film():
    one, other = make_film(0), make_film(0)
    assert one.moving.canonical.fingerprint == other.moving.canonical.fingerprint
    assert make_film(1).moving.canonical.fingerprint != one.moving.canonical.fingerprint
    assert len(one.moving.times) == TIMES
    assert len(one.views) == (FIXED + 1) * TIMES
    assert len(one.names) == len(KINDS) + 1


def test_three_things_move_as_one_piece_each_and_the_others_do_not():
    film = make_film(1)
    first, later = film.moving.at(0.0), film.moving.at(float(film.moving.times[20]))
    for label in range(len(film.names)):
        rows = film.labels == label
        way = np.abs(later.means[rows] - first.means[rows]).max()
        assert (way > 0.05) == (label in film.moves), film.names[label]
        spread = [np.linalg.norm(at.means[rows] - at.means[rows].mean(0), axis=1) for at in (first, later)]
        assert np.allclose(*spread, atol=1e-4)  # rigid
    still = film.still
    assert np.array_equal(still.at(0.0).means, still.at(1.3).means)


def test_cameras_stand_but_for_one():
    film = make_film(0)
    places = np.array([view.center for view in film.views]).reshape(FIXED + 1, TIMES, 3)
    assert (np.ptp(places, axis=1).max(axis=1) < 1e-9).tolist() == [True] * FIXED + [False]


@pytest.mark.slow
def test_a_moving_car_is_found_where_it_is():
    """Of every tenth time; the study has all of them."""
    whole = make_film(0)
    views = tuple(view for number, view in enumerate(whole.views) if number % TIMES % 10 == 0)
    film = Film(whole.moving, whole.names, whole.labels, whole.moves, views)
    made = replace(register(film.moving, views, film.features(film.moving)), encoder=WordEncoder.identity)
    scene = Scene(made.to_field(Mixture()), film.moving, views)
    track = scene.tracks(scene.locate(film.names[1], top=1))[0]
    for time in film.moving.times[::15].tolist():
        at, found = film.moving.at(time), track.at(time)
        true = box_of(at, solid(at, np.flatnonzero(film.labels == 1)), np.array([0.0, 0, 1]))
        assert np.linalg.norm(found.center - true.center) < 0.02
        assert np.abs(found.extent - true.extent).max() < 0.04


@pytest.mark.slow
def test_a_film_in_files_is_registered_as_it_is(tmp_path, capsys):
    """Of the first and the last time."""
    whole = make_film(0)
    stamps = whole.moving.times[[0, -1]]
    moving = Moving(
        whole.moving.canonical, stamps, Frames(stamps, lambda number: whole.moving.at(float(stamps[number])))
    )
    views = tuple(view for number, view in enumerate(whole.views) if number % TIMES in (0, TIMES - 1))
    write_film(tmp_path / "film", Film(moving, whole.names, whole.labels, whole.moves, views))
    truth = json.loads((tmp_path / "film/truth.json").read_text())
    assert np.shape(truth["centers"]) == (2, len(whole.names), 3)
    folder = tmp_path / "film"
    argv = ["register", folder / "film.motion", folder / "capture", "--features", folder / "capture/language_features",
            "--encoder-name", "drsplat-words", "--output", folder / "film.field", "--json"]  # fmt: skip
    assert main(list(map(str, argv))) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["num_views"], told["num_times"]) == (2 * (FIXED + 1), 2)
    found = open_scene(folder).tracks(open_scene(folder).locate(whole.names[5], top=1))[0]
    assert np.linalg.norm(found.centers - np.array(truth["centers"])[:, 5], axis=1).max() < 0.02
