"""Films on disk: that they play, that none is ever half there, and what ffmpeg's failures are told as."""

import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drsplat.authoring.filming import writing
from drsplat.authoring.filming.writing import SUFFIXES, check_film, write_film
from drsplat.errors import MissingExtraError
from refusing import refused

needs_ffmpeg = pytest.mark.skipif(writing.ffmpeg() is None, reason="the program ffmpeg is not installed")
WIDTH, HEIGHT = 64, 48
COLORS = ((200, 40, 30), (30, 160, 60), (40, 70, 210), (230, 200, 40), (128, 128, 128), (250, 250, 250))


def pictures(count: int = 6, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Iterator[np.ndarray]:
    """Plain ones, each of its own colour."""
    for number in range(count):
        yield np.full((size[1], size[0], 3), COLORS[number % len(COLORS)], np.uint8)


def decoded(path: Path) -> np.ndarray:
    """All pictures of a film as ffmpeg reads it."""
    command = ["ffmpeg", "-v", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, HEIGHT, WIDTH, 3)


def files_in(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@needs_ffmpeg
@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_ffmpeg_gives_back_the_pictures_in_their_colours(suffix, tmp_path):
    path = tmp_path / f"film{suffix}"
    write_film(path, pictures(), 12.0)
    seen = decoded(path)
    assert len(seen) == 6
    for picture, color in zip(seen, COLORS, strict=True):
        np.testing.assert_allclose(picture[8:-8, 8:-8].mean((0, 1)), color, atol=6)
    assert files_in(tmp_path) == [path.name]


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_a_film_without_ffmpeg(suffix, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    path = tmp_path / f"film{suffix}"
    write_film(path, pictures(), 12.0)
    with Image.open(path) as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (6, (WIDTH, HEIGHT), 0)
        lasts = 0
        for number, color in enumerate(COLORS):
            film.seek(number)
            np.testing.assert_allclose(np.asarray(film.convert("RGB")).mean((0, 1)), color, atol=4)
            lasts += film.info["duration"]
        assert lasts == 500


def test_mp4_without_ffmpeg_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingExtraError, match=r"ffmpeg.*install it, or name a film \.webp"):
        write_film(tmp_path / "film.mp4", pictures(), 12.0)
    assert files_in(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "size", "fps", "said"),
    [
        ("film.avi", (64, 48), 30.0, r"films are written as \.mp4, \.webm, \.webp or \.gif"),
        ("film", (64, 48), 30.0, "films are written as"),
        ("film.mp4", (65, 48), 30.0, "even width and height, got 65x48"),
        ("film.webm", (64, 47), 30.0, "even width and height"),
        ("film.webp", (0, 48), 30.0, "size: expected 2x2"),
        ("film.gif", (64, 100_000), 30.0, "8192 pixels a side"),
        ("film.webp", (64, 48), 0.0, "fps: expected 0.01 to 240"),
        ("film.gif", (64, 48), 1e-300, "fps: expected 0.01 to 240"),
        ("film.webp", (64, 48), float("nan"), "fps: expected 0.01 to 240"),
        ("none/film.webp", (64, 48), 30.0, "there is no folder"),
    ],
)
def test_what_cannot_be_written_is_known_before_the_first_picture(name, size, fps, said, tmp_path):
    with refused(said):
        check_film(tmp_path / name, size, fps)


def suffixes_here() -> list[str]:
    return [suffix for suffix in SUFFIXES if suffix not in writing.ENCODED or writing.ffmpeg()]


@pytest.mark.parametrize("suffix", suffixes_here())
def test_an_error_on_the_way_leaves_nothing_and_what_was_there(suffix, tmp_path):
    def broken():
        yield from pictures(3)
        raise RuntimeError("no more light")

    path = tmp_path / f"film{suffix}"
    with pytest.raises(RuntimeError, match="no more light"):
        write_film(path, broken(), 12.0)
    assert files_in(tmp_path) == []
    path.write_bytes(b"an older film")
    with refused("exists already"):
        write_film(path, pictures(), 12.0)
    with refused("pictures of one size"):
        write_film(path, (one for size in ((64, 48), (32, 48)) for one in pictures(1, size)), 12.0, overwrite=True)
    assert path.read_bytes() == b"an older film"
    write_film(path, pictures(), 12.0, overwrite=True)
    assert path.stat().st_size > 100
    assert files_in(tmp_path) == [path.name]


def test_no_picture_is_no_film(tmp_path):
    with refused("no picture"):
        write_film(tmp_path / "film.webp", [], 12.0)


# --- an ffmpeg that fails ---

LISTS = "#!/bin/sh\ncase \"$*\" in *-encoders*) echo ' V..... libx264 H.264'; exit 0;; esac\n"
FAKES = {
    "at once": ("echo 'Unknown option: colour' >&2; exit 3", r"exit code 3\): Unknown option: colour"),
    "midway": ("head -c 20000 >/dev/null; echo 'No space left on device' >&2; exit 1", "No space left on device"),
    "at the end": ("cat >/dev/null; echo 'moov atom lost' >&2; exit 1", "moov atom lost"),
    "without a word": ("cat >/dev/null; exit 9", r"exit code 9\): it did not say why"),
    "killed": ("head -c 100 >/dev/null; kill -9 $$", "signal 9"),
    "talking on": ("yes 'a long story' | head -c 3000000 >&2; exit 1", "a long story"),
    "in escapes": ("printf '\\033[2J' >&2; exit 1", r"\\x1b\[2J"),
}


def fake_ffmpeg(folder: Path, rest: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(LISTS + rest + "\n")
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.parametrize("name", FAKES)
def test_what_ffmpeg_dies_of_is_told(name, tmp_path, monkeypatch):
    rest, said = FAKES[name]
    fake_ffmpeg(tmp_path / "bin", rest, monkeypatch)
    with refused(said) as raised:
        write_film(tmp_path / "film.mp4", pictures(60), 12.0)
    assert len(str(raised.value)) < 1000
    assert files_in(tmp_path) == ["bin"]


def test_an_ffmpeg_without_encoders_or_that_does_not_run(tmp_path, monkeypatch):
    fake_ffmpeg(tmp_path / "bin", "exit 0", monkeypatch)
    with refused(r"no encoder for \.webm \(expected one of libvpx-vp9"):
        write_film(tmp_path / "film.webm", pictures(), 12.0)
    (tmp_path / "bin" / "ffmpeg").write_text("#!/bin/sh\nexit 1\n")
    writing._encoders.cache_clear()
    with refused("does not run"):
        write_film(tmp_path / "film.webm", pictures(), 12.0)


def test_a_name_that_looks_like_an_option_or_an_address(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = [f"{stem}{suffix}" for stem in ("-y", "http:x", "a%03d b'") for suffix in suffixes_here()]
    for name in names:
        write_film(name, pictures(), 12.0)
    assert files_in(tmp_path) == sorted(names)


ENDLESS = """
import signal, sys, numpy as np
from drsplat.authoring.filming.writing import write_film
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have started the tests without one
def pictures():
    number = 0
    while True:
        number += 1
        if number == 40:
            print("going", flush=True)
        yield np.random.default_rng(number).integers(0, 255, (48, 64, 3)).astype(np.uint8)
write_film(sys.argv[1], pictures(), 12.0)
"""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", suffixes_here())
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_killed_or_interrupted_it_leaves_no_film(suffix, how, tmp_path):
    path = tmp_path / f"film{suffix}"
    running = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, str(path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert running.stdout.readline() == b"going\n"
    running.send_signal(how)
    try:
        running.wait(60)
    finally:
        running.kill()
        running.stdout.close()
    time.sleep(0.2)  # ffmpeg may go on for a moment
    left = files_in(tmp_path)
    assert path.name not in left
    assert how == signal.SIGKILL or left == []
    assert all(name.endswith(".tmp") for name in left)


MEASURED = """
import resource, sys, numpy as np
from drsplat.authoring.filming.writing import write_film
noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8)
def pictures(count):
    return (np.roll(noise, number, 1) for number in range(count))
write_film(sys.argv[1], pictures(5), 30.0, True)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
write_film(sys.argv[1], pictures(150), 30.0, True)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "darwin", reason="memory is counted otherwise there")
@pytest.mark.parametrize("suffix", suffixes_here())
def test_no_more_than_a_few_pictures_are_held(suffix, tmp_path):
    """150 pictures of noise, which no format makes much smaller: 35 MB raw."""
    command = [sys.executable, "-c", MEASURED, str(tmp_path / f"film{suffix}")]
    grown = int(subprocess.run(command, capture_output=True, check=True).stdout)
    assert grown < 12_000  # kB
