"""What other pages, strangers and floods can do to the live viewer: nothing."""

import asyncio
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from browsing import eventually
from clients import HOST, OWN, Stream, Viewer, a_viewer, error_of
from drsplat.errors import DrSplatError, InputError
from drsplat.fronts.serving.replies import BusyError
from drsplat.fronts.viewing.live import service
from drsplat.fronts.viewing.live.acts import AnyAct
from drsplat.fronts.viewing.live.app import MAX_STREAMS, Events
from drsplat.fronts.viewing.live.service import listening_socket
from drsplat.fronts.viewing.live.shared import Shared
from drsplat.fronts.viewing.live.turns import Turns
from drsplat.fronts.viewing.live.uploads import UploadLimits, checked_path
from drsplat.fronts.viewing.saving import Saves
from drsplat.fronts.viewing.session import Session
from drsplat.query import Scene
from processes import asked
from viewing_scenes import THINGS, boxes_scene

JSON = {"content-type": "application/json"}
ASK = json.dumps({"act": "ask", "text": "tall lamp"})
TOKEN = "a-token-that-nobody-guesses"


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Viewer]:
    with a_viewer(folder=tmp_path / "saved") as one:
        yield one


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


# --- who comes in ---


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:3000"},
        {"origin": "http://evil.example", "host": "evil.example"},
        {"host": "evil.example"},
        {"host": "localhost.evil.example:8080"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
def test_other_pages_and_names_get_no_page_and_do_nothing(viewer, headers):
    own = {"host": HOST} | headers
    for path in ("/", "/client.js", "/view/header", "/view/state", "/view/splats", "/view/events", "/view/none"):
        answer = viewer.send("GET", path, own)
        error_of(answer, 403)
        assert "<script" not in answer.text
    error_of(viewer.send("POST", "/view/do", {"origin": f"http://{HOST}"} | own | JSON, content=ASK), 403)
    assert viewer.session.results == ()


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "[::1]"])
def test_its_own_page_comes_in_by_every_name_of_this_machine(viewer, name):
    here = {"host": f"{name}:{8080}"}
    assert viewer.send("GET", "/", here).status_code == 200
    own = here | {"origin": f"http://{name}:8080"}
    assert viewer.send("POST", "/view/do", own | JSON, content=ASK).status_code == 200
    assert [result.label for result in viewer.session.results] == ["tall lamp"]


def test_a_link_from_elsewhere_leads_to_the_page_and_to_nothing_else(viewer):
    link = {"host": HOST, "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert viewer.send("GET", "/", link).status_code == 200
    error_of(viewer.send("GET", "/view/header", link), 403)
    error_of(viewer.send("GET", "/", link | {"sec-fetch-mode": "no-cors"}), 403)


@pytest.mark.parametrize(
    "content_type", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""]
)
def test_a_form_of_any_page_changes_nothing(viewer, content_type):
    error_of(viewer.send("POST", "/view/do", OWN | {"content-type": content_type}, content=ASK), 415)
    error_of(viewer.send("POST", "/view/do", {"host": HOST} | JSON, content=ASK), 403)  # says not where it comes from
    assert viewer.session.results == ()


def test_a_page_is_not_framed_sniffed_kept_or_led_elsewhere(viewer):
    for answer in (viewer.get("/"), viewer.get("/view/none"), viewer.get("/view/header")):
        policy = answer.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'none'" in policy
        assert "connect-src 'self'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    led = viewer.get("/", next="http://evil.example")
    assert (led.status_code, led.headers["location"]) == (303, "/")


def test_no_page_of_another_site_may_read_answers(viewer):
    asked = {"host": HOST, "origin": "http://evil.example", "access-control-request-method": "POST"}
    answer = viewer.send("OPTIONS", "/view/do", asked)
    error_of(answer, 403)
    assert not any(name.startswith("access-control") for name in answer.headers)


def test_two_names_in_one_request_are_none(viewer):
    error_of(viewer.send("GET", "/", [("host", HOST), ("host", "evil.example")]), 403)


# --- beyond this machine ---


@pytest.fixture
def lent() -> Iterator[Viewer]:
    """A viewer that other machines reach."""
    with a_viewer(host="0.0.0.0", token=TOKEN) as one:
        yield one


LAB = {"host": "lab.example:8080", "origin": "http://lab.example:8080"}


def test_where_others_reach_it_nobody_comes_in_without_the_token(lent):
    for path in ("/", "/?token=", f"/?token={TOKEN[:-1]}", f"/?token={TOKEN}x", f"/view/state?token={TOKEN}"):
        error_of(lent.send("GET", path, LAB), 401)
    for path in ("/client.js", "/view/header", "/view/events", "/none"):
        error_of(lent.send("GET", path, LAB), 401)
    error_of(lent.send("POST", "/view/do", LAB | JSON, content=ASK), 401)
    error_of(lent.send("GET", "/", LAB | {"cookie": "drsplat-8080=guess"}), 401)
    error_of(lent.send("GET", "/", LAB | {"cookie": f"drsplat-8081={TOKEN}"}), 401)
    assert lent.session.results == ()


def test_the_token_becomes_a_cookie_and_leaves_the_address(lent):
    led = lent.send("GET", f"/?token={TOKEN}", LAB)
    assert (led.status_code, led.headers["location"]) == (303, "/")
    cookie = led.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {part.strip() for part in cookie.split(";")}
    kept = LAB | {"cookie": f"other={{1}}; {cookie.split(';')[0]}"}
    assert lent.send("GET", "/", kept).status_code == 200
    assert lent.send("POST", "/view/do", kept | JSON, content=ASK).status_code == 200
    error_of(lent.send("POST", "/view/do", kept | JSON | {"origin": "http://evil.example"}, content=ASK), 403)


def test_the_printed_address_has_a_token_where_others_reach_it():
    for host, has_token in (("127.0.0.1", False), ("0.0.0.0", True)):
        with listening_socket(host, 0) as listening:
            one = service.Service(Shared(Saves(None), opened_never), listening, host)
            one.close()
            assert (one.token is not None) == has_token
            assert one.address.endswith(f"/?token={one.token}") == has_token
            assert f":{listening.getsockname()[1]}" in one.address


def opened_never(path: Path) -> Scene:
    raise InputError(f"{path}: nothing is opened here")


@pytest.mark.parametrize(("host", "port"), [("300.1.1.1", 8080), ("127.0.0.1", 70000), ("no such name", 1)])
def test_where_nothing_can_listen_is_an_error(host, port):
    with pytest.raises(InputError, match=r"listen|port"):
        listening_socket(host, port)


def test_a_port_that_is_taken_is_passed_over():
    with listening_socket("127.0.0.1", 0) as one:
        port = one.getsockname()[1]
        with listening_socket("127.0.0.1", port) as other:
            assert port < other.getsockname()[1] <= port + 20


# --- on a socket ---


@pytest.fixture
def listened() -> Iterator[service.Service]:
    with listening_socket("127.0.0.1", 0) as listening:
        one = service.Service(Shared(Saves(None), opened_never), listening, "127.0.0.1")
        one.show(Session(boxes_scene(), words=THINGS), text="red mug")
        with one.running():
            yield one


def test_a_service_answers_what_it_was_asked_first_and_ends_with_streams_open(listened):
    port = listened.listening.getsockname()[1]
    eventually(lambda: b'"text":"red mug"' in asked(port, "GET", "/view/state")[1])
    eventually(lambda: b'"words":["' in asked(port, "GET", "/view/header")[1])  # nothing more comes by itself
    assert asked(port, "POST", "/view/do", json.loads(ASK), Origin=f"http://127.0.0.1:{port}")[0] == 200
    stream = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    stream.request("GET", "/view/events")
    answer = stream.getresponse()
    assert answer.readline().startswith(b'data: {"revision"')
    begin = time.monotonic()
    listened._server.should_exit = True
    assert b"data" not in answer.read()
    assert time.monotonic() - begin < 60
    stream.close()


def test_what_is_no_request_says_nothing_here(listened, caplog, capfd):
    port = listened.listening.getsockname()[1]
    with socket.create_connection(("127.0.0.1", port)) as one:
        one.sendall(b"\x1b]0;owned\x07\r\n\r\n")
        one.settimeout(60)
        assert b"owned" not in one.recv(4096)
    assert asked(port, "GET", "/")[0] == 200
    assert "owned" not in caplog.text
    assert "owned" not in "".join(capfd.readouterr())


# --- how many, how much, how often ---


def test_a_page_hears_of_what_another_does(viewer):
    async def heard() -> None:
        async with Stream(viewer) as one, Stream(viewer) as other:
            first = [await one.event(), await other.event()]
            assert first[0] == first[1]
            before = await asyncio.to_thread(viewer.state)
            state = await asyncio.to_thread(viewer.do, "ask", text="tall lamp")
            events = [await one.event(), await other.event()]
            assert events[0] == events[1]
            assert events[0]["revision"] == state["revision"] > first[0]["revision"]
            assert state["paint"] > before["paint"]
            assert state["geometry"] == before["geometry"]
        assert len(viewer.app.state.viewer.events) == 0

    asyncio.run(heard())


def test_no_more_pages_than_there_is_room_for(viewer):
    async def opened() -> None:
        pages = [await Stream(viewer).__aenter__() for _ in range(MAX_STREAMS)]
        assert {page.status for page in pages} == {200}
        refused = await Stream(viewer).__aenter__()
        assert refused.status == 503
        await pages[0].__aexit__()
        again = await Stream(viewer).__aenter__()
        assert again.status == 200
        for page in (*pages[1:], refused, again):
            await page.__aexit__()

    asyncio.run(opened())


def test_a_silent_stream_beats_and_a_slow_one_gets_only_the_latest():
    counts = {"revision": 0}

    async def read() -> None:
        events = Events(lambda: dict(counts), beat_s=0.01)
        lines = aiter(events.open())
        assert json.loads((await anext(lines))[6:]) == {"revision": 0}
        assert await anext(lines) == b": here\n\n"
        for number in range(1, 1000):
            counts["revision"] = number
            events.tell()
        await asyncio.sleep(0)
        line = await anext(lines)
        while line.startswith(b":"):
            line = await anext(lines)
        assert json.loads(line[6:]) == {"revision": 999}
        events.close()
        assert [line async for line in lines if not line.startswith(b":")] == []

    asyncio.run(read())


def test_an_address_that_asks_too_often_is_told_to_wait(viewer, monkeypatch):
    viewer.gate, now = service.Gate(viewer.app, "127.0.0.1", 8080), [100.0]
    monkeypatch.setattr(service, "BURST_REQUESTS", 3.0)
    monkeypatch.setattr(service, "MAX_PEERS", 2)
    monkeypatch.setattr(service.time, "monotonic", lambda: now[0])

    def asked(peer: str, count: int = 1) -> list[int]:
        viewer.peer = peer, 1
        return [viewer.send("GET", "/client.js").status_code for _ in range(count)]

    assert asked("10.0.0.1", 5) == [200, 200, 200, 429, 429]
    assert asked("10.0.0.2") == [200]
    now[0] += 1
    assert asked("10.0.0.1") == [200]
    for number in range(9):
        asked(f"10.1.0.{number}")
    assert len(viewer.gate._paces) == 2


class Busy(Turns):
    """A thread that is busy until it is let go."""

    def __init__(self, most_waiting: int) -> None:
        super().__init__(most_waiting)
        self.go = threading.Event()
        self.submit(lambda: self.go.wait(60))


def test_what_waits_is_bounded_and_only_the_latest_of_a_drag_is_done():
    turns, done = Busy(8), list[str]()

    async def dragged() -> list[str]:
        def act(name: str) -> Any:
            return lambda: done.append(name) or name

        drags = [
            asyncio.ensure_future(turns.take_latest("cut", act(f"cut {number}"), lambda: "overtaken"))
            for number in range(6)
        ]
        await asyncio.sleep(0)
        last = asyncio.ensure_future(turns.take(act("last")))
        await asyncio.sleep(0)
        with pytest.raises(BusyError, match="come again"):
            await turns.take(act("too many"))
        turns.go.set()
        return [await one for one in (*drags, last)]

    answers = asyncio.run(dragged())
    assert answers == [*["overtaken"] * 5, "cut 5", "last"]
    assert done == ["cut 5", "last"]
    turns.stop()


@pytest.mark.parametrize(
    ("path", "most"), [("/view/do", service.MAX_ACT_BYTES), ("/view/ask-picture", service.MAX_PICTURE_BYTES)]
)
def test_bodies_are_bounded_whatever_their_head_says(viewer, path, most):
    told = OWN | JSON | {"content-length": str(most + 1)}
    assert "at most" in error_of(viewer.send("POST", path, told, content=b""), 413)
    error_of(viewer.send("POST", path, OWN | JSON | {"content-length": "many"}, content=b""), 400)
    sent = 0

    async def endless() -> Any:
        nonlocal sent
        while True:
            sent += 1 << 16
            yield bytes(1 << 16)

    before = resident_bytes()
    error_of(viewer.send("POST", path, OWN | JSON, content=endless()), 413)
    assert sent <= most + (1 << 17)
    assert resident_bytes() - before < 3 * most + (64 << 20)
    assert viewer.gate.large == 0


# --- what may be said ---


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"null",
        b"[1, 2]",
        b'{"act": "ask"}',
        b'{"act": "shut_down"}',
        b'{"act": ["ask"], "text": "mug"}',
        b'{"act": "ask", "text": "mug", "more": 1}',
        b'{"act": "ask", "text": 7}',
        b'{"act": "ask", "text": ""}',
        b'{"act": "ask", "text": "mug", "during": [0]}',
        b'{"act": "threshold", "query": 0, "value": NaN}',
        b'{"act": "threshold", "query": 0, "value": 1e999}',
        b'{"act": "threshold", "query": true, "value": 0.5}',
        b'{"act": "threshold", "query": -1, "value": 0.5}',
        b'{"act": "click", "origin": [0, 0, 0], "direction": [0, 0]}',
        b'{"act": "lasso", "polygon": [[0, 0], [1, 1]], "camera": {}}',
        b'{"act": "edit", "change": "replace"}',
        b'{"act": "annotate", "text": "x", "at": "/etc/passwd"}',
        b'{"act": "ask", "text": "' + b"x" * 501 + b'"}',
        b'{"act": "ask", "text": "\xff"}',
        b"[" * 100_000,
        b'{"a":' * 50_000,
    ],
)
def test_what_no_page_of_ours_says_is_refused(viewer, body):
    error_of(viewer.send("POST", "/view/do", OWN | JSON, content=body), 422)
    assert viewer.state()["revision"] == 1


def test_a_route_that_is_not_there_and_a_method_that_is_not_taken(viewer):
    error_of(viewer.get("/view/none"), 404)
    error_of(viewer.get("/view/do"), 405)
    error_of(viewer.get("/../../etc/passwd"), 404)
    assert viewer.send("HEAD", "/").status_code == 200


FIELDS = sorted({name for kind in get_args(AnyAct) for name in kind.model_fields} - {"act"})
NUMBER = st.one_of(st.integers(-2, 9), st.floats(-1e12, 1e12), st.floats(0, 1), st.sampled_from([1e9, -1e9, 2**40]))
TEXT = st.one_of(
    st.sampled_from([*THINGS, "mug, not red", "remove", "scale", "isolate", "selection", "click", "answer", "classes"]),
    st.sampled_from(["as it is", "\x1b[2J<script>", "vase, not " * 40, ";", "\u202e", "view.png", "../..", "#12f"]),
    st.text(max_size=30),
)  # fmt: skip
POINT = st.lists(st.floats(-30, 30), min_size=3, max_size=3)
CAMERA = st.fixed_dictionaries(
    {"eye": POINT, "target": POINT, "fov": st.floats(1, 170), "width": st.integers(16, 300),
     "height": st.integers(16, 300)}
)  # fmt: skip
VALUE = st.one_of(
    st.none(), st.booleans(), NUMBER, TEXT, POINT, CAMERA, st.lists(NUMBER, min_size=2, max_size=2),
    st.lists(TEXT, max_size=3), st.lists(st.lists(st.floats(-99, 400), min_size=2, max_size=2), min_size=3, max_size=6),
)  # fmt: skip
LIKELY = {
    "text": TEXT, "query": st.integers(0, 2), "value": st.floats(-1, 1), "number": st.one_of(NUMBER, st.integers(0, 3)),
    "origin": POINT, "direction": POINT, "camera": CAMERA, "mode": TEXT, "by": POINT, "photo": TEXT, "at": VALUE,
    "change": st.sampled_from(["remove", "isolate", "fill", "recolour", "opacity", "move", "duplicate", "turn"]),
}  # fmt: skip


@st.composite
def forged(draw: st.DrawFn) -> dict[str, Any]:
    """An act of any name: its own fields, mostly of their kinds, and now and then another."""
    kind = draw(st.sampled_from(get_args(AnyAct)))
    names = [name for name in kind.model_fields if name != "act" and draw(st.integers(0, 9))]
    if not draw(st.integers(0, 9)):
        names.append(draw(st.sampled_from(FIELDS)))
    values = {name: draw(LIKELY.get(name, VALUE) if draw(st.integers(0, 5)) else VALUE) for name in names}
    return {"act": draw(st.sampled_from(get_args(kind.model_fields["act"].annotation)))} | values


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(st.lists(forged(), min_size=1, max_size=6))
def test_forged_values_of_every_act_are_no_faults(acts):
    """Each is done or refused with a reason, the state stays one that JSON can say, and the page goes on."""
    with a_viewer() as viewer:
        for act in acts:
            answer = viewer.send("POST", "/view/do", OWN | JSON, content=json.dumps(act).encode())
            assert answer.status_code in (200, 422), (act, answer.text)
            assert answer.status_code == 200 or error_of(answer, 422)
        state = viewer.state()
        assert json.loads(json.dumps(state, allow_nan=False)) == state
        count = sum(map(len, (viewer.arrays("/view/splats")["opacity"], viewer.arrays("/view/paint")["heat"])))
        assert count == 2 * len(viewer.session.drawn)
        viewer.do("restore")
        assert viewer.ask("tall lamp")["results"][0]["num_matches"] == 1


# --- files that are sent ---


@pytest.mark.parametrize(
    "name",
    [
        "", ".", "..", "/etc/passwd", "../scene.ply", "a/../../scene.ply", "..\\scene.ply", "C:\\scene.ply",
        "C:scene.ply", "\\\\host\\share\\a.ply", "a\x00.ply", "a\n.ply", ".ssh/config", "a/.hidden", "con", "NUL.ply",
        "com1", "a.ply:stream", "a ", "a.", "x" * 300, "a/" * 9 + "b.ply", "\udcff.ply", "~/../a.ply/..",
    ],
)  # fmt: skip
def test_names_of_files_stay_inside(name):
    with pytest.raises(DrSplatError, match=r"expected|longer"):
        checked_path(name)


def test_a_file_that_lies_about_its_name_is_written_nowhere(viewer, tmp_path):
    for name in ("../../escaped.ply", str(tmp_path / "escaped.ply"), "/dev/null", "a/../../../escaped.ply"):
        for path in ("/view/open", "/view/upload"):
            answer = viewer.send(
                "POST", path, OWN | {"content-type": "application/octet-stream"}, content=b"ply",
                params={"name": name, "batch": "b"},
            )  # fmt: skip
            assert "expected a" in error_of(answer, 422)
    assert list(tmp_path.rglob("*escaped*")) == []
    assert list(viewer.shared.uploads.root.rglob("*.ply")) == []
    error = error_of(viewer.post("/view/upload?batch=../x&name=a.ply", b"ply"), 422)
    assert "batch" in error


def test_a_stranger_cannot_fill_the_disk_with_files_that_are_sent():
    with a_viewer(limits=UploadLimits(bytes=1000, files=3, batches=2)) as viewer:
        for number in range(3):
            assert viewer.post(f"/view/upload?batch=a&name={number}.ply", bytes(100)).json() == {"bytes": 100}
        error_of(viewer.post("/view/upload?batch=a&name=3.ply", bytes(100)), 413)
        error_of(viewer.post("/view/upload?batch=b&name=0.ply", bytes(701)), 413)
        assert stored(viewer) == 300  # half of a file is not kept
        assert viewer.post("/view/upload?batch=b&name=0.ply", bytes(700)).status_code == 200
        error_of(viewer.post("/view/upload?batch=b&name=1.ply", bytes(1)), 413)
        assert viewer.post("/view/upload?batch=c&name=0.ply", bytes(200)).status_code == 200
        assert set(viewer.shared.uploads.batches) == {"b", "c"}  # the oldest went
        assert stored(viewer) == 900
        error_of(viewer.post("/view/upload?batch=c&name=0.ply", bytes(1)), 422)  # it is there already
        root = viewer.shared.uploads.root
    assert not root.exists()


def test_a_file_that_is_sent_to_be_opened_leaves_nothing_where_it_is_refused(viewer):
    for _ in range(2 * viewer.shared.uploads.limits.batches):
        error_of(viewer.post("/view/open?name=../a.ply", b"ply"), 422)
        error_of(viewer.post("/view/open?name=a.ply", b"ply"), 422)
    assert viewer.shared.uploads.batches == {}
    assert stored(viewer) == 0


def test_a_disk_that_is_nearly_full_takes_no_file():
    with a_viewer(limits=UploadLimits(free=1 << 62)) as viewer:
        error_of(viewer.post("/view/upload?batch=a&name=a.ply", bytes(100)), 507)
        assert stored(viewer) == 0


def stored(viewer: Viewer) -> int:
    return sum(path.stat().st_size for path in viewer.shared.uploads.root.rglob("*") if path.is_file())


def test_a_photo_outside_of_what_was_sent_is_not_shown(tmp_path):
    """A capture that is sent may name any photo of this machine."""
    from dataclasses import replace

    from drsplat.fronts.viewing.live.shared import confined
    from scenes import look_at_view

    secret, own = tmp_path / "secret.png", tmp_path / "sent/own.png"
    view = look_at_view((0.0, -3.0, 1.0))
    assert confined(replace(view, image_path=secret), tmp_path / "sent").image_path is None
    assert confined(replace(view, image_path=tmp_path / "sent/../secret.png"), tmp_path / "sent").image_path is None
    assert confined(replace(view, image_path=own, mask_path=secret), tmp_path / "sent").mask_path is None
    assert confined(replace(view, image_path=own), tmp_path / "sent").image_path == own


# --- errors ---


def test_errors_tell_no_paths(viewer, tmp_path):
    answer = viewer.post("/view/open?name=broken.ply", b"ply\nnonsense")
    said = error_of(answer, 422)
    assert "broken.ply" in said
    assert str(viewer.shared.uploads.root) not in said
    assert "/tmp" not in said
    assert stored(viewer) == 0


def test_a_fault_of_the_system_is_said_without_a_path(viewer, monkeypatch):
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device", "/home/somebody/secret.ply")

    monkeypatch.setattr(Session, "ask", full)
    said = error_of(viewer.post("/view/do", {"act": "ask", "text": "mug"}), 503)
    assert "No space left" in said
    assert "secret" not in said


def test_errors_are_told_to_whoever_asked_and_to_nobody_else(viewer):
    assert "nothing is selected" in viewer.refused("edit", change="remove")
    assert viewer.state()["message"] == ""
    assert viewer.ask("tall lamp")["message"].startswith("tall lamp: 1 match")


def test_what_waits_is_dropped_at_the_end():
    """A viewer that ends waits for what is being done, and for nothing else: a thread in the kernels would abort."""
    turns, goes_on = Turns(), threading.Event()
    first, second = turns.submit(goes_on.wait), turns.submit(lambda: "late")
    eventually(first.running)
    ending = threading.Thread(target=turns.stop)
    ending.start()
    while not turns.is_ending:
        ending.join(0.01)
    goes_on.set()
    ending.join()
    assert first.result() is True
    assert second.cancelled()
