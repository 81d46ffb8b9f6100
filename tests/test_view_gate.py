"""What other pages, strangers and floods can do to a viewer that listens: nothing."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

from browsing import eventually
from drsplat.errors import InputError, MissingExtraError
from drsplat.viewing import gate, messages, uploads
from drsplat.viewing.control_values import fits
from drsplat.viewing.listening import listening_socket
from drsplat.viewing.saving import png_of
from viewer_clients import CAMERA, Stranger, a_viewer, get, port_of

PART = 512 << 10


@pytest.fixture
def panel(tmp_path: Path) -> Iterator[Any]:
    with a_viewer(tmp_path / "saved") as one:
        yield one


def refused(panel: Any, **headers: str) -> int:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus) as caught:
        Stranger(panel, **headers)
    return caught.value.response.status_code


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


# --- who comes in ---


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:3000"},
        {"Host": "evil.example", "Origin": "http://evil.example"},
        {"Host": "evil.example"},
        {"Host": "localhost.evil.example:8080"},
    ],
)
def test_other_pages_and_names_get_no_page_and_no_socket(panel: Any, headers: dict[str, str]) -> None:
    assert refused(panel, **headers) == 403
    answer = get(panel, **headers)
    assert answer.status == 403
    assert b"<script" not in answer.body


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "[::1]"])
def test_its_own_page_comes_in_by_every_name_of_this_machine(panel: Any, name: str) -> None:
    here = f"{name}:{port_of(panel)}"
    assert get(panel, Host=here).status == 200
    own = Stranger(panel, Host=here, Origin=f"http://{here}")
    assert len(own.heard()) > 20
    own.close()


def test_a_page_that_is_framed_or_led_elsewhere_is_not_served(panel: Any) -> None:
    policy = get(panel).headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in policy
    assert f"ws://127.0.0.1:{port_of(panel)}" in policy
    led = get(panel, "/?websocket=ws://evil.example")
    assert (led.status, led.headers["Location"]) == (303, "/")


def test_a_viser_that_goes_round_the_gate_is_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate.Gate, "serve", lambda self, listening, *given, **more: gate.serve(*given, **more))
    with pytest.raises(MissingExtraError, match="lets every page in"), a_viewer():
        pass


def test_websockets_own_serve_is_back_when_the_viewer_has_started(panel: Any) -> None:
    from websockets.asyncio import server

    assert server.serve is gate.serve


def test_what_is_no_request_says_nothing_here(
    panel: Any, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_connection(("127.0.0.1", port_of(panel))) as one:
        one.sendall(b"\x1b]0;owned\x07\r\n\r\n")
        one.settimeout(60)
        assert one.recv(1) == b""
    assert get(panel).status == 200
    assert caplog.text == ""
    assert "owned" not in "".join(capfd.readouterr())


# --- beyond this machine ---


def test_where_others_reach_it_nobody_comes_in_without_the_token() -> None:
    with a_viewer(host="0.0.0.0") as panel:
        token = panel.window.served.token
        assert f"?token={token}" in panel.window.served.address
        for path in ("/", "/?token=", f"/?token={token[:-1]}", f"/?token={token}x"):
            assert get(panel, path).status == 401
            assert refused(panel, path=path) == 401
        assert refused(panel, Cookie=f"drsplat-{port_of(panel)}=guess") == 401
        with_it = Stranger(panel, path=f"/?token={token}")
        with_it.close()


def test_the_token_becomes_a_cookie_and_leaves_the_address() -> None:
    with a_viewer(host="0.0.0.0") as panel:
        led = get(panel, f"/?token={panel.window.served.token}")
        assert (led.status, led.headers["Location"]) == (303, "/")
        cookie = led.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        kept = cookie.split(";")[0]
        assert get(panel, Cookie=f"other={{1}}; {kept}").status == 200
        here = f"lab.example:{port_of(panel)}"
        Stranger(panel, Cookie=kept, Host=here, Origin=f"http://{here}").close()
        assert refused(panel, Cookie=kept, Host=here, Origin="http://evil.example") == 403


def test_on_this_machine_there_is_no_token(panel: Any) -> None:
    assert panel.window.served.token is None
    assert panel.window.served.address == f"http://127.0.0.1:{port_of(panel)}"


@pytest.mark.parametrize(("host", "port"), [("300.1.1.1", 8080), ("127.0.0.1", 70000), ("no such name", 1)])
def test_where_nothing_can_listen_is_an_error(host: str, port: int) -> None:
    with pytest.raises(InputError, match=r"listen|port"):
        listening_socket(host, port)


def test_a_port_that_is_taken_is_passed_over() -> None:
    with listening_socket("127.0.0.1", 0) as one:
        port = one.getsockname()[1]
        with listening_socket("127.0.0.1", port) as other:
            assert port < other.getsockname()[1] <= port + 20


# --- how many ---


def test_connections_that_say_nothing_give_way(panel: Any) -> None:
    silent = [socket.create_connection(("127.0.0.1", port_of(panel))) for _ in range(gate.MOST_WAITING + 5)]
    assert get(panel).status == 200
    silent[0].settimeout(60)
    assert silent[0].recv(1) == b""  # the oldest was cut off
    for one in silent:
        one.close()


def test_no_more_pages_than_there_is_room_for(panel: Any) -> None:
    pages = [Stranger(panel) for _ in range(gate.MOST_INSIDE)]
    assert refused(panel) == 503
    pages[0].close()
    eventually(lambda: len(panel.window.server._websock_server._live_connections) < len(pages))
    Stranger(panel).close()
    for one in pages[1:]:
        one.close()


# --- what may be said ---


@pytest.mark.parametrize(
    "message",
    [
        {"type": "ShareUrlRequest"},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"update_cb": []}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1, "visible": False}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": float("nan")}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": "x" * (messages.MOST_TEXT + 1)}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [1, 2, float("nan")]}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [1, 2, "x"]}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [1] * 1000}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": {"a": 1}}},
        {"type": "GuiUpdateMessage", "uuid": 1, "updates": {"value": True}},
        {"type": "ScenePointerMessage", "event_type": "rect-select"},
        {"type": ["GuiUpdateMessage"]},
        CAMERA | {"position": [0.0, 0.0, float("inf")]},
        CAMERA | {"fov": 0},
        CAMERA | {"look_at": [0.0] * 4},
        {key: value for key, value in CAMERA.items() if key != "fov"},
        [1, 2],
        None,
    ],
)
def test_what_no_page_of_ours_says_is_not_read(message: Any) -> None:
    import msgspec

    assert messages.read(msgspec.msgpack.encode(message)) is None


@pytest.mark.parametrize(
    "data", [b"", b"\xc1", b"\x91" * 100_000, b"\x81\xa4type\xa1\xff", b"\xdf\xff\xff\xff\xff", b"{}"]
)
def test_what_is_no_message_is_not_read(data: bytes) -> None:
    assert messages.read(data) is None


def test_what_is_read_is_what_was_checked() -> None:
    """A second `type` of the same map, which another reader might take."""
    import msgspec

    plain = msgspec.msgpack.encode({"type": "FileTransferPart"} | {"a": 1})
    assert messages.read(plain) is None
    read = messages.read(msgspec.msgpack.encode(CAMERA | {"more": 1}))
    assert read == CAMERA
    assert msgspec.msgpack.decode(messages.written(CAMERA)) == CAMERA


def test_no_stranger_changes_a_control_but_its_value(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    before = dict(vars(panel.text._impl))
    for updates in ({"update_cb": []}, {"sync_cb": None}, {"removed": True}, {"uuid": "x"}):
        stranger.say("GuiUpdateMessage", uuid=panel.text._impl.uuid, updates=updates)
    stranger.press(panel.text, "tall lamp\n")
    eventually(lambda: panel.session.results)
    after = vars(panel.text._impl)
    assert all(after[name] is before[name] for name in ("update_cb", "sync_cb", "removed", "uuid"))
    stranger.close()


FORGED: tuple[Any, ...] = (
    float("nan"), float("inf"), 1e9, -1e9, 0.5, 7, True, None, {}, [], [1, 2, 3], [256, 0, 0], [0.5, 0.5, 0.5], [1, 2],
    "x", "x" * 500, "\x1b[2J<script>", "vase, not " * 40,
)  # fmt: skip


def test_forged_values_of_every_control_are_no_faults(panel: Any, capfd: pytest.CaptureFixture[str]) -> None:
    """A value that a control cannot have changes nothing; all others are acted on, and no act fails for its kind."""
    stranger = Stranger(panel)
    stranger.look()
    controls = list(panel.gui._gui_input_handle_from_uuid.values())
    kinds = {id(one): type(one.value) for one in controls}
    assert len(controls) > 20
    for control in controls:
        for value in FORGED:
            if not (control._impl.is_button and value is True):  # a press is no forgery
                stranger.press(control, value)
    stranger.press(panel.text, "tall lamp\n")
    eventually(lambda: "tall lamp" in panel.told.content, 120.0)
    assert panel.actions.settled(60.0)
    assert {id(one): type(one.value) for one in controls} == kinds
    assert "went wrong here" not in panel.fault.content
    assert "Traceback" not in "".join(capfd.readouterr())
    stranger.close()


@pytest.mark.parametrize(
    ("own", "bounds", "fine", "wrong"),
    [
        (0.5, {"min": 0.0, "max": 1.0}, (0, 0.25, 1), (-0.1, 1.5, True, "0.5", [0.5], None)),
        (3, {"min": None, "max": None}, (7, 2.0), (2.5, "7", True)),
        (False, {}, (True, False), (1, 0, "True", [])),
        ("a", {"options": ("a", "b")}, ("b",), ("c", 1, True, ["a"])),
        ("a", {}, ("", "x" * 500), (1, ["a"])),
        ((1, 2, 3), {}, ([0, 255, 7],), ([256, 0, 0], [0.5, 0, 0], [1, 2], (1, 2, 3), "abc")),
        ((0.0, 0.0, 0.3), {"min": None, "max": None}, ([0.1, -2, 3],), ([0.1, 0.2], ["a", 0, 0])),
        ((0.0, 1.0), {"min": 0.0, "max": 1.0}, ([0.2, 0.4],), ([0.2, 1.4], [0.1, 0.2, 0.3])),
        (SimpleNamespace(content=b""), {}, (), (True, 1, "x", {})),
    ],
)
def test_values_are_of_the_kind_of_their_control(own: Any, bounds: Any, fine: Any, wrong: Any) -> None:
    control = SimpleNamespace(_impl=SimpleNamespace(value=own, props=SimpleNamespace(**bounds), removed=False))
    assert all(fits(control, value) for value in fine)
    assert not any(fits(control, value) for value in wrong)


# --- pictures ---


def test_an_upload_that_never_ends_takes_no_memory(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    button, before = panel.upload._impl.uuid, resident()
    part = {"source_component_uuid": button, "transfer_uuid": "t", "content": bytes(PART)}
    for name, parts in (("t", 10**6), ("u", 40), ("v", 40)):  # too large; then one, and a second beside it
        stranger.say(
            "FileTransferStartUpload",
            source_component_uuid=button,
            transfer_uuid=name,
            filename="x.png",
            mime_type="image/png",
            part_count=parts,
            size_bytes=parts * PART,
        )
        for index in range(100):
            stranger.say("FileTransferPart", **part | {"transfer_uuid": name, "part_index": index})
    stranger.press(panel.text, "tall lamp\n")  # said last, so all before has been read
    eventually(lambda: panel.session.results)
    assert resident() - before < uploads.MOST_BYTES + (60 << 20)
    stranger.close()


def test_a_message_that_is_too_large_ends_its_connection_alone(panel: Any) -> None:
    from websockets.exceptions import ConnectionClosed

    large, other = Stranger(panel), Stranger(panel)
    large.socket.send(bytes(messages.MOST_MESSAGE + 1))
    with pytest.raises(ConnectionClosed):
        large.heard()
    other.look()
    other.press(panel.text, "tall lamp\n")
    eventually(lambda: panel.session.results)
    other.close()


def test_uploads_are_one_at_a_time_and_of_the_size_that_was_told() -> None:
    one = uploads.Uploads()

    def start(name: str, size: int) -> Any:
        return one.passed({"type": messages.UPLOAD, "transfer_uuid": name, "size_bytes": size, "part_count": 2})

    def part(name: str, size: int) -> Any:
        return one.passed({"type": messages.PART, "transfer_uuid": name, "content": bytes(size)})

    assert part("a", 1) is None
    assert start("a", 10)["size_bytes"] == 10
    assert start("b", 10) is None
    assert part("b", 1) is None
    assert part("a", 0) is None
    assert part("a", 6) is not None
    assert part("a", 5) is None
    assert part("a", 4) is not None
    assert start("c", uploads.MOST_BYTES + 1)["size_bytes"] == 0
    assert part("c", 1) is None
    one.count = uploads.MOST_UPLOADS
    assert start("d", 10) is None


def test_a_picture_that_is_whole_arrives_and_one_that_is_too_large_is_refused(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    data = png_of(np.zeros((4, 4, 3), np.uint8))

    def send(size: int) -> None:
        stranger.say(
            "FileTransferStartUpload",
            source_component_uuid=panel.upload._impl.uuid,
            transfer_uuid=str(size),
            filename="x.png",
            mime_type="image/png",
            part_count=1,
            size_bytes=size,
        )
        stranger.say(
            "FileTransferPart",
            source_component_uuid=panel.upload._impl.uuid,
            transfer_uuid=str(size),
            part_index=0,
            content=data,
        )

    send(len(data))
    eventually(lambda: panel.fault.visible and "images" in panel.fault.content)  # words have no eyes
    send(1 << 30)
    eventually(lambda: "1 to 20,971,520 bytes" in panel.fault.content)
    stranger.close()


# --- floods ---


def test_a_flood_of_presses_is_done_a_few_times(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    go = threading.Event()
    panel.actions.do("wait", lambda: [go.wait(60)].clear())
    for _ in range(150):
        stranger.press(panel.asking)
    stranger.press(panel.text, "tall lamp\n")
    eventually(lambda: "tall lamp" in panel.text.value)
    assert len(panel.actions._waiting) <= 4
    go.set()
    assert panel.actions.settled(60.0)
    stranger.close()


def test_asking_again_and_again_leaves_nothing_to_repeat_to_the_next_page(panel: Any) -> None:
    def told_to_a_new_page() -> int:
        one = Stranger(panel)
        count = len(one.heard())
        one.close()
        return count

    for text in ("mug", "tall lamp", "mug; tall lamp"):
        panel.ask(text)
        assert panel.actions.settled(60.0)
    first = told_to_a_new_page()
    for text in ("mug", "tall lamp", "mug; tall lamp") * 6:
        panel.ask(text)
        assert panel.actions.settled(60.0)
    assert told_to_a_new_page() <= first + 5


def test_who_says_too_much_is_read_more_slowly() -> None:
    visitor = gate.Visitor.__new__(gate.Visitor)
    visitor._free, visitor._last = 0.0, time.monotonic()

    async def said() -> None:
        await asyncio.wait_for(visitor._paced(), 60)

    asyncio.run(said())
    assert visitor._free < 0


# --- files ---


def test_a_stranger_cannot_fill_the_disk(panel: Any) -> None:
    stranger = Stranger(panel)
    stranger.look()
    panel.saves.files_left = 2
    for number in range(4):
        panel.saved.content = ""
        panel.fault.content = ""
        panel._do("save", Press(), lambda event: panel._save_ply(event, False))
        assert panel.actions.settled(60.0), number
    assert sorted(path.name for path in panel.saves.folder.iterdir()) == ["found-2.ply", "found.ply"]
    assert "saved enough" in panel.fault.content
    stranger.close()


class Press:
    """Of a button, by a page that takes all files at once."""

    client_id = 0
    client = SimpleNamespace(
        send_file_download=lambda name, data: None,
        _websock_connection=SimpleNamespace(get_message_buffer=lambda: SimpleNamespace(message_from_id={})),
    )


def test_errors_go_away_with_the_next_press(panel: Any) -> None:
    panel._do("save", Press(), lambda event: panel._save_ply(event, True))
    assert panel.actions.settled(60.0)
    assert panel.fault.visible
    assert "nothing is selected" in panel.fault.content
    panel.ask("tall lamp")
    assert panel.actions.settled(60.0)
    assert not panel.fault.visible
    assert panel.fault.content == ""
    assert "tall lamp: 1 match" in panel.told.content
