"""Photos that a robot or a phone sends to `drsplat serve`: taken, added, and asked for meanwhile."""

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from callers import KEY, Service, reason, told
from command_line import error_of
from drsplat import load_field, read_views
from drsplat.formats.replacing import claimed_output
from drsplat.fronts.serving import workbench
from drsplat.fronts.serving.guards import Limits
from drsplat.fronts.serving.live import list_views
from drsplat.fronts.serving.scene_folder import SceneFolder
from full_disk import files_of_at_most
from growing_fields import files_of
from growing_rooms import posted
from processes import asked, children_of, serving, wait_for

VIEWS = "/scenes/room/views"
WITH_KEY = {"x-api-key": KEY}
ASKED = {"vector": [1.0] * 512, "threshold": 0.5}


@pytest.fixture
def scenes(half_room: Path, tmp_path: Path) -> Path:
    """A folder with the scene `room`, which has two photos."""
    shutil.copytree(half_room, tmp_path / "scenes/room")
    return tmp_path / "scenes"


def opened(scenes: Path, **settings: Any) -> Any:
    given = {"key": KEY, "takes_views": True, "limits": Limits(workers=1)}
    return closing(Service(scenes, **given | settings))


def send(service: Service, body: Any, **headers: str) -> Any:
    return service("POST", VIEWS, json=body, headers=WITH_KEY | headers)


def listed(service: Service) -> dict[str, Any]:
    return told(service("GET", VIEWS, headers=WITH_KEY))


def states(service: Service) -> dict[str, str]:
    return {view["name"]: view["state"] for view in listed(service)["views"]}


def answer_of(service: Service) -> dict[str, Any]:
    return told(service("POST", "/scenes/room/select", json=ASKED, headers=WITH_KEY))


def wait_until_added(service: Service) -> None:
    wait_for(lambda: listed(service)["num_waiting"] == 0)


def test_photos_are_added_while_questions_are_answered(scenes, full_room):
    fields = {load_field(scenes / "room/room.field").fingerprint, load_field(full_room / "room.field").fingerprint}
    with opened(scenes) as service:
        answers = []
        for view in read_views(full_room)[2:]:
            taken = send(service, posted(view))
            assert taken.status_code == 202
            assert (taken.json()["name"], taken.json()["state"]) == (view.name, "waiting")
        cut = base64.b64encode(base64.b64decode(posted(view)["picture"])[:-400]).decode()
        assert send(service, posted(view, name="cut.png", picture=cut)).status_code == 202
        while listed(service)["num_waiting"]:
            answers.append(answer_of(service)["field"])
        answers.append(answer_of(service)["field"])
        assert fields & set(answers[-1:])
        assert len(set(answers)) <= 3
        found = listed(service)
        assert [(one["state"], one["reason"]) for one in found["views"][:2]] == [("added", "")] * 2
        assert (found["views"][2]["name"], found["views"][2]["state"]) == ("cut.png", "refused")
        assert found["views"][2]["reason"].startswith("live_views/images/cut.png: cannot be read as a photo")
        assert all(one["ended"] > one["arrived"] for one in found["views"])
        assert found["problem"] == ""
        assert len(told(service("GET", "/scenes/room", headers=WITH_KEY))["views"]) == 4
        photo = service("GET", "/scenes/room/photo", params={"view": "photo_3.png"}, headers=WITH_KEY)
        assert photo.headers["content-type"] == "image/png"
        again = send(service, posted(read_views(full_room)[3]))
        assert (again.status_code, again.json()["state"]) == (200, "added")
        lines = service("GET", "/metrics", headers=WITH_KEY).text.splitlines()
    for line in ('_views_total{outcome="taken"} 3.0', '_views_total{outcome="added"} 2.0', "_view_seconds_count 2.0",
                 '_views_total{outcome="refused"} 1.0', "_views_waiting 0.0"):  # fmt: skip
        assert f"drsplat{line}" in lines
    assert files_of(scenes / "room/room.field") == files_of(full_room / "room.field")


@pytest.mark.slow
def test_photos_are_taken_only_with_leave_a_key_and_from_here(scenes, full_room, capsys):
    body = posted(read_views(full_room)[2])
    with opened(scenes, takes_views=False) as closed:
        assert "takes no photos" in reason(send(closed, body), 403)
        assert told(closed("GET", VIEWS, headers=WITH_KEY)) == {"num_waiting": 0, "views": [], "problem": ""}
    with opened(scenes, origins=("https://a.example",)) as service:
        reason(service("POST", VIEWS, json=body), 401)
        reason(service("GET", VIEWS), 401)
        for origin in ("https://b.example", "null", "http://here:1"):
            assert "pages of other sites" in reason(send(service, body, origin=origin), 403)
        assert not (scenes / "room/live_views").exists()
        plain = service("POST", VIEWS, content=json.dumps(body), headers=WITH_KEY | {"content-type": "text/plain"})
        assert "application/json" in reason(plain, 415)
        for origin in ("http://here", "https://a.example"):
            assert send(service, body, origin=origin).status_code in (200, 202)
    assert "--api-key-file FILE" in error_of(capsys, "serve", scenes, "--take-views")


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"name": "../../x.jpg"}, "expected a file name"),
    ({"picture": "no base64!"}, "picture: expected base64"),
    ({"picture": "R0lGODlhAQABAA=="}, "picture: expected a JPEG or PNG"),
    ({"pose": {}}, "pose: expected cam_from_world"),
    ({"pose": {"cam_from_world": [[1, 0, 0, 0]]}}, "pose.cam_from_world: List should have at least 4 items"),
    ({"lens": {"fx": 0}}, "lens.fx: Input should be greater than 0"),
    ({"lens": {"fx": 100, "k3": 0.1}}, "lens: there is no such field: k3. There are fx, fy"),
    ({"lens": {"fx": 100, "width": 10, "height": 500}}, "another aspect ratio"),
    ({"features": "AAAA"}, "features"),
    ({"masks": []}, "there is no such field: masks. "),
]


def test_what_is_no_view_gets_a_reason(scenes, full_room):
    view = read_views(full_room)[2]
    with opened(scenes) as service:
        for changes, said in WRONG:
            text = reason(send(service, posted(view, **changes)), 422)
            assert said in text
            assert str(scenes) not in text
            assert "/tmp" not in text
        assert "room" in reason(service("POST", "/scenes/nowhere/views", json=posted(view), headers=WITH_KEY), 404)
        reason(service("GET", "/scenes/nowhere/views", headers=WITH_KEY), 404)
        send(service, posted(view))
        text = reason(send(service, posted(view, lens={"fx": 50.0})), 409)
        assert "was sent before with another photo" in text
        reason(send(service, posted(view, name="photo_0.png")), 409)
    with opened(scenes, limits=Limits(body_bytes=1000)) as small:
        assert "1,000 bytes" in reason(send(small, posted(view)), 413)
    with opened(scenes, limits=Limits(pixels=1000)) as small:
        assert "at most 1,000" in reason(send(small, posted(read_views(full_room)[3])), 422)


def test_a_full_queue_is_told_when_to_come_again(scenes, full_room):
    one, other = read_views(full_room)[2:]
    with claimed_output(scenes / "room/room.field"), opened(scenes, limits=Limits(workers=1, views=1)) as service:
        assert send(service, posted(one)).status_code == 202
        full = send(service, posted(other))
        assert "1 views of this scene wait" in reason(full, 429)
        assert full.headers["retry-after"] == "1"
        assert send(service, posted(one)).status_code == 200
        assert "drsplat_views_waiting 1.0" in service("GET", "/metrics", headers=WITH_KEY).text


@pytest.mark.slow
def test_the_list_tells_which_photos_are_being_added(scenes, full_room):
    with claimed_output(scenes / "room/room.field"), opened(scenes) as service:
        for view in read_views(full_room)[2:]:
            send(service, posted(view))
    asked_for = {"working": ["photo_3.png"], "problem": "later"}
    listed = json.loads(list_views(SceneFolder(scenes).files("room"), asked_for).body)
    assert [view["state"] for view in listed["views"]] == ["waiting", "working"]
    assert (listed["num_waiting"], listed["problem"]) == (2, "later")


@pytest.mark.slow
def test_another_writer_is_waited_for(scenes, full_room, monkeypatch):

    monkeypatch.setattr(workbench, "RETRY_S", 0.2)
    with opened(scenes) as service:
        with claimed_output(scenes / "room/room.field"):
            send(service, posted(read_views(full_room)[2]))
            wait_for(lambda: listed(service)["problem"])
            text = listed(service)["problem"]
            assert text.startswith("room/room.field is being written by")
            assert states(service) == {"photo_2.png": "waiting"}
        wait_until_added(service)
        wait_for(lambda: listed(service)["problem"] == "")
        assert states(service) == {"photo_2.png": "added"}


@pytest.mark.slow
def test_a_full_disk_is_told_and_loses_nothing(scenes, full_room):
    one, other = read_views(full_room)[2:]
    with files_of_at_most(30_000), opened(scenes) as service:
        assert send(service, posted(one)).status_code == 202
        wait_for(lambda: "there is no room left" in listed(service)["problem"])
        assert states(service) == {one.name: "waiting"}
    with files_of_at_most(1000), opened(scenes) as service:
        text = reason(send(service, posted(other)), 507)
        assert "there is no room left to write it" in text
        assert str(scenes) not in text
    with opened(scenes) as service:
        send(service, posted(other))
        wait_until_added(service)
        assert set(states(service).values()) == {"added"}
    assert files_of(scenes / "room/room.field") == files_of(full_room / "room.field")


@pytest.mark.slow
def test_a_photo_that_ends_the_process_is_refused_and_the_others_are_added(scenes, full_room, monkeypatch):
    dying = (
        "import os, sys; from drsplat.photos.arriving.adding import _Batch; from drsplat.fronts.serving import worker; "
        "embed = _Batch.embed; "
        "_Batch.embed = lambda b, load, views: "
        "os._exit(9) if 'photo_2.png' in [v.name for v in views] else embed(b, load, views); "
        "worker.main(int(sys.argv[1]), int(sys.argv[2]))"
    )
    monkeypatch.setattr(workbench, "WORKER_COMMAND", [sys.executable, "-c", dying])
    with opened(scenes) as service:
        for view in read_views(full_room)[2:]:
            assert send(service, posted(view)).status_code == 202
        wait_until_added(service)
        assert states(service) == {"photo_2.png": "refused", "photo_3.png": "added"}
        (refused, _) = listed(service)["views"]
        assert "exit code 9" in refused["reason"]
    assert load_field(scenes / "room/room.field").evidence is not None


@pytest.fixture
def key_file(tmp_path: Path) -> str:
    (tmp_path / "key.txt").write_text(KEY)
    return str(tmp_path / "key.txt")


def served(scenes: Path, key_file: str) -> Any:
    return serving("serve", scenes, "--take-views", "--api-key-file", key_file, "--json")


def fetch(port: int, path: str, body: Any = None) -> dict[str, Any]:
    status, answer = asked(port, "GET" if body is None else "POST", path, body, **WITH_KEY)
    assert 200 <= status < 300, answer
    return dict(json.loads(answer))


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 1.0, 2.5])
def test_a_killed_service_goes_on_with_what_it_had_taken(seconds, scenes, full_room, key_file):
    with served(scenes, key_file) as (server, port):
        for view in read_views(full_room)[2:]:
            fetch(port, VIEWS, posted(view))
        time.sleep(seconds)
        server.send_signal(signal.SIGKILL)
        server.wait(60)
    with served(scenes, key_file) as (server, port):
        wait_for(lambda: fetch(port, VIEWS)["num_waiting"] == 0)
        assert [view["state"] for view in fetch(port, VIEWS)["views"]] == ["added", "added"]
        adding = children_of(server.pid)
        for process in adding:
            os.kill(process, signal.SIGKILL)
        assert fetch(port, VIEWS, posted(read_views(full_room)[3]))["state"] == "added"
    assert files_of(scenes / "room/room.field") == files_of(full_room / "room.field")


@pytest.mark.slow
def test_the_lines_of_the_document_send_photos(household_story, household_folder, tmp_path, monkeypatch):
    demo = Path(shutil.copytree(household_folder, tmp_path / "drsplat-demo"))
    (tmp_path / "key.txt").write_text(KEY)
    text = (Path(__file__).parents[2] / "docs/live_views.md").read_text(encoding="utf-8")
    shells, (program,) = (re.findall(rf"^```{kind}\n(.*?)^```$", text, re.M | re.S) for kind in ("bash", "python"))
    monkeypatch.chdir(tmp_path)
    with served(demo, str(tmp_path / "key.txt")) as (_, port):
        lines, program = (one.replace("localhost:8765", f"localhost:{port}") for one in (shells[1], program))
        done = subprocess.run(["bash", "-euc", lines], check=True, capture_output=True, text=True, timeout=120)
        first, listed = (
            json.JSONDecoder().raw_decode(done.stdout)[0],
            json.loads(done.stdout[done.stdout.rindex('{"num') :]),
        )
        assert (first["name"], first["state"]) == ("phone/0001.jpg", "waiting")
        assert [view["name"] for view in listed["views"]] == ["phone/0001.jpg"]
        exec(compile(program, "docs/live_views.md", "exec"), {})
        wait_for(lambda: fetch(port, VIEWS.replace("room", "drsplat-demo"))["num_waiting"] == 0)
        states = fetch(port, "/scenes/drsplat-demo/views")["views"]
        assert [(view["name"], view["state"]) for view in states] == [
            ("phone/0001.jpg", "added"), ("phone/0002.jpg", "added"),
        ]  # fmt: skip
        found = fetch(port, "/scenes/drsplat-demo/locate", {"text": "red vase"})["matches"]
    best = household_story.verdicts[[one.probe.text for one in household_story.verdicts].index("red vase")].center
    assert_allclose(found[0]["center"], best, atol=0.05)
    held_out = read_views(demo)
    posed = {view.name: view.cam_from_world for view in held_out}
    assert_allclose(posed["phone/0001.jpg"], posed["frame_00001.jpg"], atol=1e-4)
    assert_allclose(posed["phone/0002.jpg"], posed["frame_00009.jpg"], atol=1e-4)
