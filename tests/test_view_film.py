"""Key frames in the viewer: taken, played, saved and filmed; keys and the look. No browser: pages that talk."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("msgspec", reason="the extra drsplat[viewer] is not installed")

from browsing import a_browser, a_page, eventually, needs_chromium, pixels_of
from drsplat.errors import InputError
from drsplat.filming.encoding import ffmpeg
from drsplat.filming.path_files import read_path, write_path
from drsplat.viewing import film
from test_film_paths import nerfstudio_file
from viewer_clients import CAMERA, Stranger, a_viewer

PLACES = ([6.0, -9.0, 4.0], [-7.0, -8.0, 3.0], [1.0, -12.0, 8.0])


@pytest.fixture
def panel(tmp_path: Path) -> Iterator[Any]:
    with a_viewer(tmp_path / "saved") as one:
        yield one


def only_client(panel: Any) -> Any:
    eventually(lambda: len(panel.window.server.get_clients()) == 1)
    return next(iter(panel.window.server.get_clients().values()))


def settle(panel: Any) -> None:
    assert panel.actions.settled(120.0)


def key(panel: Any, label: str) -> str:
    """The name that viser has for what a key does."""
    commands = panel.window.server.gui._command_handle_from_uuid
    return next(uuid for uuid, one in commands.items() if one.label == label)


def taken(panel: Any, stranger: Stranger) -> None:
    """A key frame at each of three places, by the key K."""
    for number, place in enumerate(PLACES):
        at = CAMERA | {"position": place}
        stranger.say(**{"kind" if name == "type" else name: value for name, value in at.items()})
        eventually(lambda place=place: np.allclose(only_client(panel).camera.position, place))
        stranger.say("CommandTriggerMessage", uuid=key(panel, "Add key frame"))
        eventually(lambda number=number: len(panel.film.keys) == number + 1)


def test_key_frames_are_what_the_browser_sees_and_render_takes_the_path(panel: Any, tmp_path: Path) -> None:
    stranger = Stranger(panel)
    taken(panel, stranger)
    frame = panel.session.shown.frame
    for one, place in zip(panel.film.keys, PLACES, strict=True):
        np.testing.assert_allclose(one.eye, frame.world(np.array(place)), atol=1e-9)
        np.testing.assert_allclose(one.rotation[2], -np.array(place) / np.linalg.norm(place), atol=1e-9)
        assert one.fov_degrees == pytest.approx(np.degrees(0.8))
    assert "3 key frames" in panel.film.said.content
    event = SimpleNamespace(client=only_client(panel), client_id=0)
    panel._do("save", event, panel.film.save_path)
    settle(panel)
    path = read_path(tmp_path / "saved" / "path.json")
    assert (path.seconds, path.fps, path.size, len(path.keys)) == (8.0, 24.0, (960, 720), 3)
    np.testing.assert_allclose(path.keys[1].eye, panel.film.keys[1].eye)
    stranger.close()


def loaded(panel: Any, document: object) -> None:
    data = document if isinstance(document, bytes) else json.dumps(document).encode()
    panel.film.file = SimpleNamespace(value=SimpleNamespace(content=data, name="my path.json"))
    panel._do("load", SimpleNamespace(client=only_client(panel), client_id=0), panel.film.load_path)
    settle(panel)


def test_a_saved_path_is_loaded_again(panel: Any, tmp_path: Path) -> None:
    stranger = Stranger(panel)
    taken(panel, stranger)
    panel.film.closed.value, panel.film.seconds.value = True, 5.0
    before = panel.film.path()
    write_path(tmp_path / "path.json", before)
    for _ in before.keys:
        panel.film.remove(None)
    panel.film.closed.value, panel.film.seconds.value = False, 8.0
    loaded(panel, (tmp_path / "path.json").read_bytes())
    assert panel.fault.content == ""
    after = panel.film.path()
    assert (after.closed, after.seconds, len(after.keys)) == (True, 5.0, 3)
    for one, other in zip(before.keys, after.keys, strict=True):
        np.testing.assert_allclose(one.eye, other.eye, atol=1e-9)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-9)
    frame = panel.session.shown.frame  # the browser stands at the first one
    np.testing.assert_allclose(only_client(panel).camera.position, frame.shown(before.keys[0].eye), atol=1e-6)
    stranger.close()


def test_a_path_of_nerfstudio_or_with_times_is_loaded_and_goes_on(panel: Any) -> None:
    stranger = Stranger(panel)
    taken(panel, stranger)
    loaded(panel, nerfstudio_file(3) | {"seconds": 3.0})
    assert panel.fault.content == ""
    path = panel.film.path()
    assert (path.even, path.seconds) == (True, 3.0)
    np.testing.assert_allclose(path.at(np.array([0.5]))[0].eye, (2, -4, 1), atol=1e-9)
    timed = [{"eye": place, "target": [0, 0, 0], "up": [0, 0, 1], "seconds": 2.0 * n} for n, place in enumerate(PLACES)]
    loaded(panel, {"format": "drsplat-path", "version": 1, "key_frames": timed})
    assert panel.film.path().seconds == 4.0
    panel.film.add(SimpleNamespace(client=only_client(panel)))
    assert len(panel.film.path().keys) == 4
    assert not panel.film.path().is_timed
    stranger.close()


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (b"", "1 to"),
        (b"\xff{", "expected JSON"),
        (b"[" * 100_000, "expected JSON"),
        ({"key_frames": []}, "drsplat-path"),
        ({"format": "drsplat-path", "version": 1, "key_frames": [{"eye": [0, 0, 0]}]}, "target"),
        ({"camera_path": [], "camera_type": "fisheye"}, "not supported"),
        ([1], "expected a path"),
    ],
)
def test_what_is_no_path_is_said_and_changes_nothing(panel: Any, document: object, said: str) -> None:
    stranger = Stranger(panel)
    taken(panel, stranger)
    loaded(panel, document)
    assert said in panel.fault.content
    assert "my path.json" in panel.fault.content
    assert len(panel.film.keys) == 3
    stranger.close()


def test_a_path_is_played_and_stopped(panel: Any) -> None:
    stranger = Stranger(panel)
    taken(panel, stranger)
    panel.film.seconds.value = 1.0
    seen: list[np.ndarray] = []
    stand = panel.window.stand
    panel.window.stand = lambda client, at: (seen.append(at.eye), stand(client, at))
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Play the path"))
    eventually(lambda: len(seen) > 3)
    eventually(lambda: not panel.film.is_playing)
    first, last = panel.film.keys[0].eye, panel.film.keys[-1].eye
    assert np.linalg.norm(seen[0] - first) < 0.3 * np.linalg.norm(last - first)
    np.testing.assert_allclose(seen[-1], last, atol=1e-9)
    assert panel.film.playing.label == "Play"
    panel.film.seconds.value = 60.0
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Play the path"))
    eventually(lambda: panel.film.is_playing and panel.film.playing.label == "Stop")
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Play the path"))
    eventually(lambda: panel.film.playing.label == "Play")
    stranger.close()


@pytest.mark.parametrize("suffix", [".webp", ".gif", ".mp4"])
def test_a_film_shows_what_the_viewer_shows(
    suffix: str, panel: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if suffix == ".mp4" and ffmpeg() is None:
        pytest.skip("the program ffmpeg is not installed")
    monkeypatch.setattr(film, "SIZE", (64, 48))
    stranger = Stranger(panel)
    taken(panel, stranger)
    panel.session.ask("tall lamp")
    panel.film.seconds.value, panel.film.suffix.value = 1.0, suffix
    panel._do("film", SimpleNamespace(client=only_client(panel), client_id=0), panel.film.film)
    settle(panel)
    assert panel.fault.content == ""
    path = tmp_path / "saved" / f"film{suffix}"
    if suffix == ".mp4":
        asked = ["-count_frames", "-show_entries", "stream=nb_read_frames,width,height", "-of", "json"]
        told = subprocess.run(["ffprobe", "-v", "error", *asked, path], capture_output=True, check=True)
        assert json.loads(told.stdout)["streams"] == [{"width": 64, "height": 48, "nb_read_frames": "24"}]
    else:
        with Image.open(path) as shown:
            assert (shown.n_frames, shown.size) == (24, (64, 48))  # type: ignore[attr-defined]
    assert "3 key frames" in panel.film.said.content
    stranger.close()


def test_too_few_or_too_many_key_frames(panel: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="two key frames or more, and there are 0"):
        panel.film.path()
    panel.film.remove(None)
    assert "No key frames" in panel.film.said.content
    monkeypatch.setattr(film, "MOST_KEYS", 0)
    with pytest.raises(InputError, match="up to 0 key frames"):
        panel.film.add(SimpleNamespace(client=None))


def test_keys_turn_boxes_colours_and_the_look(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    panel.ask("tall lamp")
    settle(panel)
    assert panel.mode.value == "answer"
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Next colours"))
    eventually(lambda: panel.session.mode.value == "heat map")
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Boxes and names"))
    eventually(lambda: not panel.window.boxes and not panel.boxes.value)
    stranger.heard(0.3)
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Dark or light"))
    eventually(lambda: panel.look.value == "light")
    themes = [one["dark_mode"] for one in stranger.heard(1.0) if one["type"] == "ThemeConfigurationMessage"]
    assert themes == [False]
    stranger.say("CommandTriggerMessage", uuid="nobody")
    stranger.say("CommandTriggerMessage", uuid=7)
    stranger.say("CommandTriggerMessage", uuid=key(panel, "Dark or light"))
    eventually(lambda: panel.look.value == "dark")
    stranger.close()


def test_a_panel_that_is_closed_leaves_no_key_behind(panel: Any) -> None:
    """A catalogue opens one scene after the other on the same server."""
    commands = panel.window.server.gui._command_handle_from_uuid
    assert len(commands) == 5
    panel.close()
    assert not commands


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)], ids=["desk", "hand"])
def test_keys_in_a_real_browser(size: tuple[int, int], panel: Any) -> None:
    """K keeps what is seen, L turns the look; on a phone the scene stays in sight beside the controls."""
    port = panel.window.server.get_port()
    with a_browser() as browser, a_page(browser, *size) as page:
        page.goto(f"http://127.0.0.1:{port}")
        page.get_by_text("Query by picture").wait_for()
        client = only_client(panel)
        eventually(lambda: client.camera.image_width > 0)
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        page.keyboard.press("k")
        eventually(lambda: len(panel.film.keys) == 1)
        here = panel.window.session.shown.frame.world(np.array(client.camera.position))
        np.testing.assert_allclose(panel.film.keys[0].eye, here, atol=0.05)
        page.keyboard.press("l")
        eventually(lambda: panel.look.value == "light")
        eventually(lambda: np.median(pixels_of(page, size[0])[-40:, -40:]) > 0.8)
