"""Films on the command line, from files: convert, register, ask where and when."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drsplat import load_field
from drsplat.cli import main
from drsplat.formats.moving_scenes import read_moving, write_moving
from moving_scenes import drifting, write_film


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As others have it."""
    folder = tmp_path_factory.mktemp("film")
    write_film(folder)
    return folder


def run(capsys: pytest.CaptureFixture[str], *argv: object) -> dict:
    assert main([*map(str, argv), "--json"]) == 0
    answer: dict = json.loads(capsys.readouterr().out)
    return answer


@pytest.fixture(scope="module")
def field(film: Path) -> Path:
    """By frame numbers: those of the photos and those of the PLY files are the same."""
    argv = ["register", film / "frames", film / "capture", "--features", film / "capture/language_features",
            "--times", "cam*/{time}.png", "--encoder-name", "drsplat-words",
            "--output", film / "film.field"]  # fmt: skip
    assert main(list(map(str, argv))) == 0
    return film / "film.field"


def test_a_film_is_registered_with_the_times_of_names(field):
    times = load_field(field).times
    assert times.tolist() == [*range(6), *range(6)]


def test_a_film_needs_times(film, capsys):
    argv = ["register", film / "frames", film / "capture", "--features", film / "capture/language_features"]
    assert main([*map(str, argv), "--output", str(film / "other.field")]) == 1
    assert "has no time, and the scene moves" in capsys.readouterr().err
    assert not (film / "other.field").exists()


def test_where_and_when(field, film, capsys):
    found = run(capsys, "locate", field, "red car", "--scene", film / "frames", "--tracks", "--during", 0, 3)
    track = found["matches"][0]["track"]
    assert track["times"] == list(range(6))
    assert np.allclose(np.diff(np.array(track["centers"])[:, 1]), 0.4, atol=1e-2)
    assert track["spans"] == [[0, 5]]
    shared = (field, "red car", "left_of", "white vase", "--scene", film / "frames")
    when = run(capsys, "when", *shared, "--views", film / "capture", "--view", "cam0/00")
    assert when["spans"] == [[0, 2]]
    assert main(["when", *map(str, shared), "--views", str(film / "capture"), "--view", "cam0/00"]) == 0
    assert "'red car' is left of 'white vase': 0 to 2 (of 0 to 5)" in capsys.readouterr().out
    assert main(["locate", str(field), "red car", "--scene", str(film / "frames"), "--tracks"]) == 0
    assert "goes from (" in capsys.readouterr().out
    assert main(["when", *map(str, shared)]) == 1
    assert "pass --view" in capsys.readouterr().err.replace("give", "pass")


def test_objects_tell_what_drifts(field, film, capsys):
    found = run(capsys, "objects", field, "--scene", film / "frames")
    assert found["drifting"]["num_gaussians"] <= 6
    assert main(["objects", str(field), "--scene", str(film / "frames")]) == 0
    assert "what it belongs to over time" in capsys.readouterr().out


def test_a_picture_is_of_its_time(field, film, tmp_path):
    for number in (0, 5):
        argv = ["locate", field, "red car", "--scene", film / "frames", "--views", film / "capture", "--times",
                "cam*/{time}.png", "--picture", tmp_path / f"{number}.png", "--view", f"cam0/{number:02d}"]  # fmt: skip
        assert main(list(map(str, argv))) == 0
    first, last = (np.asarray(Image.open(tmp_path / f"{number}.png")) for number in (0, 5))
    assert first.shape == last.shape
    assert (first != last).any()


def test_films_are_described(field, film, capsys):
    told = run(capsys, "inspect", film / "frames")
    assert (told["kind"], told["num_gaussians"], told["num_times"], told["times"]) == ("scene", 300, 6, [0, 5])
    assert run(capsys, "inspect", field)["times"] == [0, 5]
    assert run(capsys, "inspect", film / "capture")["kind"] == "capture"


def test_films_are_converted(tmp_path, capsys):
    film = drifting(20)
    write_moving(tmp_path / "given", film)
    told = run(capsys, "motion", tmp_path / "given", "--times", 0, 1, "--output", tmp_path / "film.motion")
    assert (told["num_gaussians"], told["num_times"], told["times"]) == (20, 5, [0, 1])
    run(capsys, "motion", tmp_path / "film.motion", "--output", tmp_path / "frames")
    told = run(capsys, "motion", tmp_path / "frames", "--times", 0, 1)
    assert told["times"] == [0, 1]
    assert told["output"] is None
    assert np.allclose(read_moving(tmp_path / "frames", (0.0, 1.0)).at(0.5).means, film.at(1.0).means, atol=1e-5)
    assert main(["motion", str(tmp_path / "film.motion"), "--output", str(tmp_path / "frames")]) == 1
    assert "exists already" in capsys.readouterr().err
