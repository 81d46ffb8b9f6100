"""`drsplat serve`: answers, refusals, bounds, and what outlives a killed worker."""

import base64
import io
import json
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from callers import KEY, Service, reason, told
from command_line import error_of
from drsplat import LanguageField, load_field
from drsplat.evaluation.demo import story as household
from drsplat.field.codes import PQCode
from drsplat.fronts.serving import workbench
from drsplat.fronts.serving.guards import Limits
from drsplat.fronts.serving.listening import bound_socket
from drsplat.fronts.serving.scene_folder import SceneFolder, Sources, UnknownSceneError
from drsplat.query import open_scene
from processes import asked, children_of, serving, wait_for

VASE = {"text": "red vase"}
VERBS = [
    ("serve",),
    pytest.param(("mcp", "--http"), marks=pytest.mark.skipif(find_spec("mcp") is None, reason="no mcp")),
]


@pytest.fixture(scope="module")
def folder(household_story: household.Story, household_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two names of the demo's room, and a damaged scene."""
    made = tmp_path_factory.mktemp("scenes")
    for name in ("room", "same room"):
        (made / name).symlink_to(household_folder)
    (made / "damaged").mkdir()
    shutil.copytree(household_folder / "room.field", made / "damaged" / "room.field")
    (made / "damaged" / "scene.ply").write_bytes(b"ply\nnonsense")
    (made / "no scene").mkdir()
    return made


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[Service]:
    with closing(Service(folder)) as made:
        yield made


def test_scenes_are_listed_without_opening_them(service):
    listed = {one["name"]: one for one in told(service("GET", "/scenes"))["scenes"]}
    assert set(listed) == {"damaged", "room", "same room"}
    details = told(service("GET", "/scenes/same%20room"))
    assert details["num_gaussians"] == listed["room"]["num_gaussians"]
    assert (len(details["views"]), details["encoder"]) == (48, "drsplat-mini")
    assert details["up"][2] > 0.99
    assert told(service("GET", "/health")) == {"status": "ok", "num_scenes": 3}


def test_an_answer_has_ids_and_a_photo(service, folder):
    """What is asked and answered otherwise is in `test_fronts.py`."""
    asked = open_scene(folder / "room").ask("red vase")
    assert told(service.post("select", VASE | {"ids": True}))["gaussian_ids"] == asked.gaussian_ids.tolist()
    support = told(service.post("locate", VASE))["matches"][0]["support"][0]
    photo = service("GET", "/scenes/room/photo", params={"view": support["view"], "max_side": 200})
    with Image.open(io.BytesIO(photo.content)) as picture:
        assert (picture.format, max(picture.size)) == ("PNG", 200)


def test_what_is_at_a_point(service, folder):
    vase = open_scene(folder / "room").locate("red vase")[0]
    words = told(service.post("what-is", {"point": vase.center.tolist()}))
    assert words["words"][0]["name"] == "red vase"


def encoded(image: Image.Image) -> str:
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return base64.b64encode(buffer.getvalue()).decode()


def test_pictures(service):
    for given in ({}, {"text": "red vase"}, {"text": "laptop"}, {"photo": True, "view": "frame_00003"}):
        answer = service.post("picture", {**given, "max_side": 160})
        assert answer.headers["content-type"] == "image/png"
        with Image.open(io.BytesIO(answer.content)) as picture:
            colour = np.ptp(np.asarray(picture.convert("RGB"), int), axis=-1).max()
            assert picture.size == (160, 120)
        assert (colour < 4) == (given == {"text": "laptop"})


TRICKS = (
    "..", "../room", "..%2Froom", "%2e%2e", "%2e%2e%2froom", "%2Fetc", "room%2F..%2Froom", "room%00", "room%5C..",
    "room/", "%ED%A0%80", "no%20scene", "ROOM", "a" * 300, "C:%5C", "~", "*", "room.field",
)  # fmt: skip


@pytest.mark.parametrize("name", TRICKS)
def test_names_never_become_paths(name, service):
    for method, path, given in (
        ("GET", f"/scenes/{name}", {}),
        ("POST", f"/scenes/{name}/select", {"json": {"text": "mug"}}),
        ("GET", f"/scenes/{name}/photo", {"params": {"view": "frame_00001"}}),
    ):
        answer = service(method, path, **given)
        at_root = answer.url.path == "/"  # the client has resolved the dots itself
        assert answer.status_code in (404, 422, 405, 307) or at_root, (path, answer.text)
        assert "root:" not in answer.text


def test_the_scene_folder_looks_names_up(folder):
    scene_folder = SceneFolder(folder)
    for name in ("../" + folder.name, str(folder / "room"), "room/../room", "", ".", "no scene"):
        with pytest.raises(UnknownSceneError, match="'room'"):
            scene_folder.scene(name)
    assert scene_folder.scene("room") is scene_folder.scene("room")
    few = SceneFolder(folder, most=1)
    first = few.scene("room")
    assert few.scene("same room") is not first
    assert few.scene("room") is not first


def test_photos_are_those_of_the_scene(service):
    for view in ("../../truth.json", "/etc/passwd", "frame_00001.jpg/../frame_00002.jpg", "\0"):
        answer = service("GET", "/scenes/room/photo", params={"view": view})
        assert "no view" in reason(answer, 422)


WRONG: list[tuple[str, Any, str]] = [
    ("select", {}, "exactly one of"),
    ("select", {"text": "   "}, "no word"),
    ("select", {"text": "m" * 201}, "at most 200"),
    ("select", {"text": 7}, "string"),
    ("select", {"text": "mug", "treshold": 0.5}, "treshold"),
    ("select", {"text": "mug", "threshold": 7}, "threshold"),
    ("select", {"text": "mug", "threshold": "best"}, "auto"),
    ("select", {"vector": [0.0] * 512}, "not zero"),
    ("select", {"vector": []}, "vector"),
    ("select", {"point": [0, 0]}, "point"),
    ("select", {"click": {"view": "frame_00001", "x": 1e5, "y": 1}}, "640x480"),
    ("select", {"image": "not base64!"}, "base64"),
    ("select", {"image": base64.b64encode(b"GIF89a" + b"\0" * 50).decode()}, "cannot be read"),
    ("select", {"text": "mug", "objects": "always"}, "objects: Input should be 'auto' or 'never'"),
    ("segment", {"classes": None}, "body.classes: Input should be a valid list"),
    ("segment", {"classes": ["mug"], "names": None}, "body: there is no such field: names. There are threshold, "),
    ("locate", {"text": "mug", "top": 0}, "top"),
    ("locate", {"text": "mug", "top": 10**9}, "top"),
    ("locate", {"text": "mug", "min_gaussians": -1}, "min_gaussians"),
    ("segment", {"classes": []}, "classes"),
    ("segment", {"classes": ["mug", "mug"]}, "different classes"),
    ("segment", {"classes": [f"mug {n}" for n in range(65)]}, "at most 64"),
    ("what-is", {}, "one of point and click"),
    ("picture", {"max_side": 10**6}, "max_side"),
    ("picture", {"view": "../x"}, "no view"),
    ("select", [1, 2], "dict"),
    ("select", "text", "dict"),
]  # fmt: skip


@pytest.mark.parametrize(("route", "given", "said"), WRONG)
def test_what_makes_no_sense_gets_a_reason(route, given, said, service, folder):
    text = reason(service.post(route, given), 422)
    assert said.lower() in text.lower()
    assert str(folder) not in text


@pytest.mark.parametrize(
    "body",
    [b"", b"{", b"\xff\xfe", b'{"text": "\\ud800"}', b'{"point": [NaN, 0, 0]}', b"[" * 20_000, b'{"text": 1e999}'],
)
def test_malformed_bodies(body, service):
    json_type = {"content-type": "application/json"}
    answer = service("POST", "/scenes/room/select", content=body, headers=json_type)
    assert 400 <= answer.status_code < 500, answer.text
    assert reason(answer, answer.status_code)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b'{"text": "red vase", "text": "lamp"}', "'text' is given twice"),
        (b'{"click": {"view": "frame_00001", "x": 1, "y": 1, "x": 2}}', "'x' is given twice"),
        (b'{"text": "\\ud800"}', "half a character"),
        ('{"text": "lamp"}'.encode("utf-16"), "in UTF-8"),
    ],
)
def test_a_body_of_which_a_reader_would_have_to_guess_is_refused(body, said, service):
    """The last of two was taken, in silence."""
    answer = service("POST", "/scenes/room/select", content=body, headers={"content-type": "application/json"})
    assert said in reason(answer, 422)


@pytest.mark.parametrize("kind", [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data; x"])
def test_a_body_that_is_not_said_to_be_json_is_told_how(kind, service):
    headers = {} if kind is None else {"content-type": kind}
    answer = service("POST", "/scenes/room/select", content=b'{"text": "red vase"}', headers=headers)
    assert "Content-Type: application/json" in reason(answer, 415)
    charset = {"content-type": "application/json; charset=utf-8"}
    told(service("POST", "/scenes/room/select", content=b'{"text": "red vase"}', headers=charset))


def test_a_damaged_scene_says_so_and_others_still_answer(service, folder):
    text = reason(service.post("select", VASE, scene="damaged"), 503)
    assert "cannot be opened" in text
    assert str(folder) not in text
    assert service.post("select", {"text": "vase"}).status_code == 200


def test_a_text_without_a_match_is_told_how_near_it_came(service):
    advice = service.post("locate", {"text": "laptop"}).json()["advice"]
    assert advice.startswith("no match: The best place has a ")
    assert "Words that match here: " in advice
    assert service.post("locate", {"text": "mug"}).json().get("advice", "") == ""


def test_unknown_routes_and_methods(service):
    assert "nothing at '/nothing': GET /openapi.json" in reason(service("GET", "/nothing"), 404)
    reason(service("DELETE", "/scenes"), 405)
    assert reason(service("GET", "/scenes/room/select"), 405) == "expected POST here, got GET"
    unknown = reason(service.post("select", {"text": "mug", "txt": "mug"}), 422)
    assert unknown == "body: there is no such field: txt. Did you mean 'text'?"


def test_bodies_and_pictures_are_bounded(folder):
    small = Service(folder, limits=Limits(body_bytes=2000, pixels=1000))
    long = {"text": "mug", "exclude": ["red"] * 1000}
    assert "2,000 bytes" in reason(small.post("select", long), 413)

    async def chunks() -> Any:
        for _ in range(10):
            yield b" " * 500

    told_nothing = small("POST", "/scenes/room/select", content=chunks())
    assert "2,000 bytes" in reason(told_nothing, 413)
    large = {"image": encoded(Image.new("1", (40, 40)))}
    assert "at most 1,000" in reason(small.post("select", large), 422)


def test_who_has_no_key_is_told(folder):
    closed = Service(folder, key=KEY)
    assert "Bearer" in reason(closed("GET", "/scenes"), 401)
    for header in (
        {"authorization": "Bearer wrong"}, {"authorization": KEY}, {"authorization": f"Basic {KEY}"},
        {"x-api-key": KEY[:-1]}, {"x-api-key": ""},
    ):  # fmt: skip
        reason(closed("GET", "/scenes", headers=header), 401)
        reason(closed("GET", "/metrics", headers=header), 401)
    for scheme in ("Bearer", "bearer", "BEARER"):
        told(closed("GET", "/scenes", headers={"authorization": f"{scheme} {KEY}"}))
    told(closed("GET", "/scenes", headers={"x-api-key": KEY}))
    told(closed("GET", "/health"))


def test_only_by_its_own_names(folder):
    local = Service(folder, hosts=("127.0.0.1", "[::1]"))
    for host in ("evil.example", "127.0.0.1.evil.example", "", "[::1].evil"):
        reason(local("GET", "/health", headers={"host": host}), 400)
    for host in ("127.0.0.1", "127.0.0.1:8765", "[::1]:1"):
        told(local("GET", "/health", headers={"host": host}))


def processes_of(service: Service) -> list[int]:
    """Those that compute for it."""
    workers = service.app.state.bench._workers
    return [worker._line[0].pid for worker in workers if worker._line is not None]


@pytest.mark.slow
def test_too_slow_and_too_many(folder):
    """A stopped process is one that never has done: it is ended, and its place is free for others."""
    busy = Service(folder, limits=Limits(seconds=3.0, workers=1, waiting=2))
    with closing(busy):
        wait_for(lambda: busy.post("select", VASE).status_code == 200)
        (stuck,) = processes_of(busy)
        os.kill(stuck, signal.SIGSTOP)
        calls = [("POST", "/scenes/room/select", {"json": VASE})] * 8
        refused = busy.all([*calls, ("GET", "/health", {})])
        assert [answer.status_code for answer in refused] == [503] * 8 + [200]
        kinds = [answer.json()["kind"] for answer in refused[:8]]
        assert sorted(set(kinds)) == ["BusyError", "timeout"]
        assert kinds.count("timeout") == 3
        assert all(answer.headers["retry-after"] == "1" for answer in refused[:8])
        wait_for(lambda: not Path(f"/proc/{stuck}").exists())
        wait_for(lambda: busy.post("select", VASE).status_code == 200)


def copied(scene: Path, to: Path) -> Path:
    """The field and the Gaussians of a scene, to be changed."""
    to.mkdir()
    shutil.copytree(scene / "room.field", to / "room.field")
    shutil.copy(scene / "scene.compressed.ply", to)
    return to


def renamed(scene: Path) -> LanguageField:
    """The field of a scene, as if another encoder had made it: another fingerprint."""
    field = load_field(scene / "room.field")
    assert isinstance(field.code, PQCode)
    other = replace(field.encoder, name="other")
    book = replace(field.codebook, encoder=other)
    return replace(field, code=replace(field.code, codebook=book), encoder=other)


@pytest.mark.slow
def test_a_replaced_scene_gives_new_answers_and_a_damaged_one_ends_nothing(folder, tmp_path):
    scene = copied(folder / "room", tmp_path / "one")
    (tmp_path / "other").symlink_to(folder / "room")
    asked = {"vector": [1.0] * 512, "threshold": 0.5}
    with closing(Service(tmp_path, limits=Limits(workers=2))) as service:

        def answers(name: str) -> list[Any]:
            return service.all([("POST", f"/scenes/{name}/select", {"json": asked})] * 4)

        before = [told(answer) for answer in answers("one")]
        known = load_field(scene / "room.field").fingerprint
        assert {answer["field"] for answer in before} == {known}
        assert {answer.headers["x-drsplat-field"] for answer in answers("one")} == {known}
        other = renamed(scene)
        other.save(scene / "room.field", overwrite=True)
        assert {told(answer)["field"] for answer in answers("one")} == {other.fingerprint}
        codes = scene / "room.field" / "codes.safetensors"
        whole = codes.read_bytes()
        os.truncate(codes, 4096)
        workers = processes_of(service)
        assert {reason(answer, 503)[:18] for answer in answers("one")} == {"scene 'one' cannot"}
        assert {told(answer)["field"] for answer in answers("other")} == {known}
        assert processes_of(service) == workers
        codes.write_bytes(whole)
        assert {told(answer)["field"] for answer in answers("one")} == {other.fingerprint}


@pytest.mark.slow
def test_a_scene_cut_short_while_it_is_mapped_costs_one_answer(folder, tmp_path, monkeypatch):
    """Large files are mapped; nothing can keep a process that reads on from being ended (SIGBUS)."""
    started = workbench._process

    def dying(place: Any) -> Any:
        process, line = started(place)
        os.kill(process.pid, signal.SIGSTOP)
        process.send_signal(signal.SIGBUS)
        process.send_signal(signal.SIGCONT)
        return process, line

    (tmp_path / "room").symlink_to(folder / "room")
    with closing(Service(tmp_path, limits=Limits(workers=1))) as service:
        monkeypatch.setattr(workbench, "_process", dying)
        assert "SIGBUS" in reason(service.post("select", VASE), 503)
        monkeypatch.setattr(workbench, "_process", started)
        told(service.post("select", VASE))


def test_a_killed_process_that_was_idle_costs_nothing(service):
    told(service.post("select", VASE))
    for process in processes_of(service):
        os.kill(process, signal.SIGKILL)
    told(service.post("select", VASE))


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["1 / 0", "(_ for _ in ()).throw(type('PanicException', (BaseException,), {})())"])
def test_no_exception_of_a_request_ends_a_process(fault, folder, monkeypatch, capfd):
    broken = f"import sys; from drsplat.fronts.serving import worker; worker.answered = lambda *_: {fault}; "
    monkeypatch.setattr(
        workbench, "WORKER_COMMAND", [sys.executable, "-c", broken + "worker.main(int(sys.argv[1]), int(sys.argv[2]))"]
    )
    with closing(Service(folder, limits=Limits(workers=1))) as service:
        told(service("GET", "/scenes"))
        (process,) = children_of(os.getpid(), b"worker.answered")
        for _ in range(2):
            assert "fault of the service" in reason(service.post("select", VASE), 500)
        assert children_of(os.getpid(), b"worker.answered") == [process]
    logged = capfd.readouterr().err
    assert "Traceback" in logged
    assert "red vase" in logged


@pytest.mark.slow
def test_odd_names_and_pipes_do_not_break_the_list(folder, tmp_path):
    copied(folder / "room", tmp_path / "good")
    os.mkfifo(copied(folder / "room", tmp_path / "pipe") / "room.field" / "pipe")
    manifest = tmp_path / "pipe" / "room.field" / "field.json"
    (tmp_path / "pipe" / "room.field" / "pipe").replace(manifest)
    os.rename(copied(folder / "room", tmp_path / "x"), os.fsencode(tmp_path) + b"/b\xffd\x1b[2J")
    half = copied(folder / "room", tmp_path / "half") / "room.field" / "field.json"
    half.write_text(half.read_text().replace('"name": "drsplat-mini"', r'"name": "\ud800"'))
    huge = copied(folder / "room", tmp_path / "huge") / "room.field" / "field.json"
    known = json.loads(huge.read_text())["num_registered"]
    huge.write_text(huge.read_text().replace(f'"num_registered": {known}', '"num_registered": ' + "9" * 4000))
    with closing(Service(tmp_path)) as service:
        listed = {one["name"]: one for one in told(service("GET", "/scenes"))["scenes"]}
        assert set(listed) == {"good", "pipe", "b\\xffd\x1b[2J", "half", "huge"}
        assert "pipe" in listed["pipe"]["fault"]
        assert listed["huge"]["num_registered"] == 0
        assert "cannot be opened" in reason(service.post("select", VASE, scene="pipe"), 503)
        assert "can be written" in reason(service.post("select", VASE, scene="half"), 503)
        told(service("POST", "/scenes/b%5Cxffd%1B%5B2J/select", json=VASE))
        told(service.post("select", VASE, scene="good"))


@pytest.mark.slow
def test_refusals_tell_no_paths_and_are_not_corrupted(folder, tmp_path, monkeypatch):
    secret = tmp_path / "secret" / "words.json"
    secret.parent.mkdir()
    secret.write_text("{")
    with closing(Service(folder, sources=Sources(vocabulary=str(secret)))) as service:
        text = reason(service.post("select", VASE), 422)
        assert "secret" not in text
        assert "words.json: expected JSON" in text
    for root, name in ((folder / "room", "."), (folder, ".")):
        monkeypatch.chdir(root)
        scene = (root / "room" if root == folder else root).resolve().name
        scene = "room" if root == folder else scene
        with closing(Service(Path(name))) as service:
            click = {"click": {"view": "no.view", "x": 1, "y": 1}}
            text = reason(service.post("select", click, scene), 422)
            assert "'no.view'" in text
            assert "'frame_00001.jpg'" in text


@pytest.mark.slow
def test_a_model_that_is_not_there_is_refused_without_its_path(folder, tmp_path):
    for library in ("torch", "transformers"):  # without them the answer is another: 503, with what to install
        pytest.importorskip(library)
    away = str(tmp_path / "secret" / "model")
    with closing(Service(folder, sources=Sources(encoder=away))) as service:
        text = reason(service.post("select", VASE), 422)
        assert "secret" not in text
        assert "model: " in text


def test_heads_pages_and_origins(service, folder):
    head = service("HEAD", "/scenes/room")
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-length"] == service("GET", "/scenes/room").headers["content-length"]
    assert service("HEAD", "/nothing").status_code == 404
    for path in ("/", "/docs"):
        page = service("GET", path)
        assert page.headers["content-type"].startswith("text/html")
        assert "script" not in page.text
        assert "//" not in page.text.replace("http://localhost:8765/", "")
        for route in ("/scenes/{scene}/locate", "openapi.json", "&quot;red vase&quot;"):
            assert route in page.text
    asking = {"origin": "https://a.example", "access-control-request-method": "POST"}
    assert service("OPTIONS", "/scenes/room/select", headers=asking).status_code == 405
    got = service("GET", "/scenes", headers={"origin": "https://a.example"})
    assert not [name for name in got.headers if name.startswith("access-control")]
    with closing(Service(folder, origins=("https://a.example",), key=KEY)) as allowed:
        answer = allowed("OPTIONS", "/scenes/room/select", headers=asking)
        assert answer.status_code == 200
        assert answer.headers["access-control-allow-origin"] == "https://a.example"
        asking["origin"] = "https://b.example"
        assert allowed("OPTIONS", "/scenes/room/select", headers=asking).status_code == 400
        assert "Bearer" in reason(allowed("GET", "/scenes", headers=asking), 401)


def test_few_large_bodies_at_once(folder):
    limits = Limits(large_bodies=0, body_bytes=1 << 20)
    with closing(Service(folder, limits=limits)) as busy:
        large = {"vector": [0.123456789] * 8000}
        assert "come again" in reason(busy.post("select", large), 503)
        told(busy.post("select", VASE))


def test_what_cannot_be_served_is_said_at_the_start(folder, tmp_path, capsys):
    assert "no scene is here" in error_of(capsys, "serve", tmp_path)
    words = tmp_path / "words.json"
    words.write_text("{")
    assert "expected JSON" in error_of(capsys, "serve", folder, "--vocabulary", words)
    both = ["--vocabulary", words, "--encoder", "some/model"]
    assert "drop one" in error_of(capsys, "serve", folder, *both)


@pytest.mark.parametrize("verb", VERBS, ids=str)
def test_a_port_that_is_taken_is_told_before_an_address_is(verb, folder, capsys):
    with bound_socket("127.0.0.1", 0) as other:
        port = other.getsockname()[1]
        text = error_of(capsys, *verb, folder, "--port", port)
    assert f"port {port} of '127.0.0.1' is taken" in text
    assert "--port N" in text
    assert "cannot listen on" in error_of(capsys, *verb, folder, "--host", "127.0.0.300", "--open")


@pytest.mark.slow
def test_metrics_count(folder):
    counted = Service(folder)
    told(counted.post("select", {"text": "vase"}))
    reason(counted.post("select", {}), 422)
    reason(counted("GET", "/unheard-of"), 404)
    lines = counted("GET", "/metrics").text.splitlines()
    route = 'route="/scenes/{scene}/select"'
    assert f'drsplat_requests_total{{{route},status="200"}} 1.0' in lines
    assert f'drsplat_requests_total{{{route},status="422"}} 1.0' in lines
    assert 'drsplat_requests_total{route="none",status="404"} 1.0' in lines
    assert "drsplat_computing 0.0" in lines
    assert "drsplat_waiting 0.0" in lines


def test_the_description_has_examples_and_refusals(service):
    described = told(service("GET", "/openapi.json"))
    for path, methods in described["paths"].items():
        for method in methods.values():
            assert method["description"]
            assert "422" in method["responses"], path
    examples = described["components"]["schemas"]["Locate"]["examples"]
    for given in examples:
        assert told(service.post("locate", given))["num_matches"] >= 1


@pytest.mark.slow
def test_a_killed_worker_loses_no_field_and_a_stopped_service_ends_well(folder):
    body = {"text": "red vase", "ids": True}
    with serving("serve", folder, "--threads", "1", "--workers", "2") as (server, port):
        before = asked(port, "POST", "/scenes/room/select", body)
        assert before[0] == 200
        workers = children_of(server.pid)
        assert len(workers) == 2
        for worker in workers:
            os.kill(worker, signal.SIGKILL)
        wait_for(lambda: not set(children_of(server.pid)) & set(workers))
        wait_for(lambda: asked(port, "POST", "/scenes/room/select", body) == before)
        status, text = asked(port, "GET", "/metrics")
        assert status == 200
        assert b'route="/scenes/{scene}/select",status="200"' in text
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) in (0, -signal.SIGTERM)


@pytest.mark.parametrize("verb", VERBS, ids=str)
def test_other_machines_are_let_in_only_on_purpose(verb, tmp_path, capsys):
    argv = [*verb, tmp_path, "--host", "0.0.0.0"]
    assert "--api-key-file" in error_of(capsys, *argv)
    (tmp_path / "key").write_text("short\n")
    argv.append("--api-key-file")
    assert "16 or more" in error_of(capsys, *argv, tmp_path / "key")
    assert "no such file" in error_of(capsys, *argv, tmp_path / "none")
    assert "no such folder" in error_of(capsys, *verb, tmp_path / "none")
    assert "--timeout" in error_of(capsys, *verb, tmp_path, "--timeout", "0", code=2)
