"""`drsplat mcp`, driven by the SDK's own client: a conversation about the demo's room, held against its truth."""

import asyncio
import base64
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from command_line import Capture
from drsplat.evaluation.demo import story as household
from processes import children_of, serving, wait_for

pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")

from mcp import Client, StdioServerParameters

COMMAND = ["-W", "ignore", "-m", "drsplat", "mcp"]
TOOLS = {
    "list_scenes",
    "about_scene",
    "locate",
    "count",
    "where_is",
    "how_far_apart",
    "what_is_at",
    "what_is_at_pixel",
    "list_objects",
    "relations",
    "when",
    "describe_region",
    "show",
}
Talk = Callable[[Client], Awaitable[Any]]


@pytest.fixture(scope="module")
def room(household_story: household.Story, household_folder: Path) -> Path:
    return household_folder


@pytest.fixture(scope="module")
def truth(room: Path) -> dict[str, np.ndarray]:
    """Centre of each thing by its category, in metres."""
    known = json.loads((room / "truth.json").read_text(encoding="utf-8"))
    return {thing["category"]: np.array(thing["center"]) for thing in known["objects"]}


def over_stdio(folder: Path, talk: Talk) -> Any:
    async def conversation() -> Any:
        given = [*COMMAND, str(folder), "--threads", "1"]
        server = StdioServerParameters(command=sys.executable, args=given)
        async with Client(server) as client:
            return await talk(client)

    return asyncio.run(conversation())


@contextmanager
def http_server(folder: Path, *options: str) -> Iterator[str]:
    with serving("mcp", folder, "--threads", "1", "--http", *options, stderr=subprocess.DEVNULL) as (_, port):
        yield f"http://127.0.0.1:{port}/mcp"


async def told(client: Client, tool: str, **arguments: Any) -> dict[str, Any]:
    result = await client.call_tool(tool, arguments)
    assert not result.is_error, result.content
    assert isinstance(result.structured_content, dict)
    return result.structured_content


async def refused(client: Client, tool: str, **arguments: Any) -> str:
    result = await client.call_tool(tool, arguments)
    assert result.is_error
    return str(result.content[0].text)


FOOD, ON, NEAR_TO = "something to eat", "table", "candle"


def at(point: Any) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*point)


async def answers(client: Client) -> dict[str, dict[str, Any]]:
    """What is said of the demo's room: what there is to eat on the table, and which is nearer to the candle."""
    (scene,) = (await told(client, "list_scenes"))["scenes"]
    on_table = await told(client, "count", text=FOOD, on=ON)
    candle = await told(client, "where_is", text=NEAR_TO)
    names = [(await told(client, "what_is_at", point=place))["words"][0]["name"] for place in on_table["centers"]]
    return {
        "scene": scene,
        "located": await told(client, "locate", text=FOOD),
        "on_table": on_table,
        "candle": candle,
        "names": dict(zip(names, on_table["centers"], strict=True)),
        "apart": {name: await told(client, "how_far_apart", first=name, second=NEAR_TO) for name in names},
        "region": await told(client, "describe_region", center=candle["best"]["center"], radius=0.35),
    }


@pytest.mark.slow
def test_what_there_is_to_eat_on_the_table_and_which_is_nearest_to_the_candle(room, truth):
    """The same that docs/serve.md quotes, number by number, so that nothing else stands there."""
    shown: list[Any] = []

    async def talk(client: Client) -> dict[str, dict[str, Any]]:
        shown.append((await client.call_tool("show", {"text": FOOD})).content[1].data)
        return await answers(client)

    said = over_stdio(room, talk)
    picture = Image.open(io.BytesIO(base64.b64decode(shown[0])))
    assert (picture.format, picture.size) == ("PNG", (640, 480))
    assert 0.001 < (np.ptp(np.asarray(picture.convert("RGB"), int), axis=-1) > 60).mean() < 0.2
    assert said["scene"]["num_gaussians"] > said["scene"]["num_registered"] > 90_000
    assert (said["on_table"]["count"], said["on_table"]["of"], said["located"]["num_matches"]) == (2, 2, 2)
    candle = truth["blue candle"]
    assert np.linalg.norm(np.array(said["candle"]["best"]["center"]) - candle) < 0.03
    assert sorted(said["names"]) == ["orange carrot", "yellow apple"]
    for name, apart in said["apart"].items():
        assert np.linalg.norm(said["names"][name] - truth[name]) < 0.06
        assert apart["center_distance"] == pytest.approx(np.linalg.norm(truth[name] - candle), abs=0.06)
        assert 0 < apart["gap"] < apart["center_distance"]
        assert apart["units"] == "scene units"
    distances = {name: apart["center_distance"] for name, apart in said["apart"].items()}
    present = [part["name"] for part in said["region"]["parts"]]
    assert {"table", "candle"} <= set(present)
    quoted = [
        ("`list_scenes`", f"one scene, {said['scene']['num_gaussians']:,} Gaussians", ""),
        (f"`locate` {FOOD}", "2", "2"),
        (f"`count` {FOOD} `on` {ON}", "2", "2"),
        (f"`where_is` {NEAR_TO}", at(said["candle"]["best"]["center"]), at(candle)),
        *((f"`what_is_at` {at(place)}", name, name) for name, place in said["names"].items()),
        *(
            (f"`how_far_apart` {name}, {NEAR_TO}", f"{length:.2f}", f"{np.linalg.norm(truth[name] - candle):.2f}")
            for name, length in distances.items()
        ),
        (f"`describe_region` 0.35 about the {NEAR_TO}", ", ".join(present[:4]) + ", ...", ""),
        (f"`show` {FOOD}", "a picture", ""),
    ]
    rows = "".join(f"| {' | '.join(row)} |\n".replace("|  |", "| |") for row in quoted)
    document = (Path(__file__).parents[2] / "docs/serve.md").read_text(encoding="utf-8")
    assert rows in document, f"docs/serve.md quotes other answers than these:\n{rows}"
    nearest = min(distances, key=lambda name: distances[name])
    assert f"So: two, and the {nearest.split()[1]} is nearer." in document


@pytest.mark.slow
def test_errors_say_what_to_do_next(room):
    async def talk(client: Client) -> None:
        tools = (await client.list_tools()).tools
        assert {tool.name for tool in tools} == TOOLS
        for tool in tools:
            assert tool.description
            assert len(tool.description) < 200
            assert tool.output_schema
        absent = await told(client, "where_is", text="laptop")
        assert absent["best"] is None
        assert "synonym" in absent["advice"]
        assert "The best place has a " in absent["advice"]
        assert "Words that match here: " in absent["advice"]
        assert (await told(client, "count", text="laptop"))["count"] == 0
        assert "words: apple" in await refused(client, "locate", text="zeppelin")
        for name in ("../..", "/etc", "room/../room", "room\0"):
            assert f"there are: {room.name!r}" in await refused(client, "locate", text="toy", scene=name)
        assert "no match for 'laptop'" in await refused(client, "how_far_apart", first="laptop", second="candle")
        assert "same place" in await refused(client, "how_far_apart", first="candle", second="candles")
        far = await refused(client, "what_is_at", point=[50.0, 0.0, 0.0])
        assert "the nearest Gaussian is" in far
        assert str(room) not in far
        assert "at most 200" in await refused(client, "locate", text="x" * 300)
        assert "no view 'photo'" in await refused(client, "show", view="photo")
        assert "640x480" in await refused(client, "what_is_at_pixel", view="frame_00001", x=1e9, y=0)
        none_on = await told(client, "count", text="something to eat", on="sofa")
        assert (none_on["count"], none_on["of"]) == (0, 2)
        assert "none on the sofa" in none_on["advice"]
        assert "nearest Gaussian" in await refused(client, "what_is_at", point=[1e300, 0.0, 0.0])
        for name, arguments, said in (
            ("locate", {"text": "toy", "top": 21}, "locate: top: Input should be less than"),
            ("locate", {"text": 5}, "locate: text: Input should be a valid string"),
            ("locate", {}, "locate: text: Field required"),
            (
                "show",
                {"save": "x.png"},
                "show: no argument save; there are: text, view, during, objects, present, scene",
            ),
            ("count", {"text": "toy", "objects": "always"}, "count: objects: Input should be 'auto' or 'never'"),
            ("show", {"view": "photo"}, "there is no view 'photo'"),
            ("count", {"text": "toys", "on": ""}, "count: on: "),
            ("what_is_at", {"point": ["a", 0, 0]}, "what_is_at: point.0: "),
        ):
            told_ = await refused(client, name, **arguments)
            assert told_.startswith(said)
            assert "pydantic" not in told_

    over_stdio(room, talk)


@pytest.mark.slow
def test_find_on_and_about_a_scene(room, truth):
    async def talk(client: Client) -> None:
        every = await told(client, "locate", text="something to eat")
        on_table = await told(client, "locate", text="something to eat", on="table")
        assert (every["num_matches"], on_table["num_matches"]) == (2, 2)
        assert [one for one in every["matches"] if one in on_table["matches"]] == on_table["matches"]
        nothing = await told(client, "locate", text="something to eat", on="sofa")
        assert (nothing["num_matches"], "none on the sofa" in nothing["advice"]) == (0, True)
        free = await told(client, "locate", text="something to eat", box="free")
        assert [one["center"] for one in free["matches"]] != [one["center"] for one in every["matches"]]
        assert all(abs(one["axes"][2][2]) > 0.99 for one in every["matches"])
        assert not all(abs(one["axes"][2][2]) > 0.99 for one in free["matches"])
        about = await told(client, "about_scene")
        assert about["up"][2] > 0.99
        assert (about["units"], about["num_photos"]) == ("scene units", 48)
        low, high = np.array(about["low"]), np.array(about["high"])
        for center in truth.values():
            assert (low < center).all()
            assert (center < high).all()
        assert {answer["field"] for answer in (every, on_table, about)} == {about["field"]}
        (text,) = (await client.call_tool("about_scene", {})).content
        assert json.loads(text.text) == about
        assert text.text.count("\n") == 0
        numbers = re.findall(r"-?\d+\.\d+", json.dumps([every, about]))
        assert max(len(number) for number in numbers) <= 9
        await told(client, "show", view=about["some_photos"][-1])

    over_stdio(room, talk)


@pytest.mark.slow
def test_malformed_lines_are_answered(tmp_path):
    lines: list[tuple[bytes, Any, int, str]] = [
        (rb'{"jsonrpc":"2.0","id":5,"method":"tools/call","params":{"name":"\ud800"}}', 5, -32700, "hex escape"),
        (rb'{"jsonrpc":"2.0","id":"five","method":"\udc00\ud800"}', "five", -32700, "hex escape"),
        (rb'{"jsonrpc":"2.0","id":"\ud800","method":"ping"}', None, -32700, "hex escape"),
        (b"[" * 100_000, None, -32700, "one JSON-RPC message a line"),
        (b"\xff\xfe", None, -32700, "one JSON-RPC message a line"),
        (b'{"jsonrpc":"1.0","id":1,"method":"ping"}', 1, -32600, "expected a JSON-RPC message"),
        (b'{"jsonrpc":"2.0","id":"six","method":"tools/list","params":5}', "six", -32600, "expected a JSON-RPC"),
        (b'{"jsonrpc":"2.0","id":[1],"method":"ping"}', None, -32600, "the id a text or a whole number"),
        (b'{"jsonrpc":"2.0","id":null,"method":"tools/list"}', None, -32600, "the id a text or a whole number"),
        (b'{"jsonrpc":"2.0","id":1.5,"method":"tools/list"}', None, -32600, "the id a text or a whole number"),
    ]
    command = [sys.executable, *COMMAND, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as server:
        ending = threading.Timer(120, server.kill)  # a line that gets no answer fails, and hangs nothing
        ending.start()
        for line, number, code, said in lines:
            server.stdin.write(line + b"\n")
            server.stdin.flush()
            answer = json.loads(server.stdout.readline())
            assert (answer["id"], answer["error"]["code"]) == (number, code), line[:80]
            assert said in answer["error"]["message"]
        # an empty line needs no answer
        server.stdin.write(b'\n{"jsonrpc":"2.0","id":7,"method":"initialize","params":{}}\n')
        server.stdin.flush()
        assert json.loads(server.stdout.readline())["id"] == 7
        server.stdin.close()
        assert server.wait(60) == 0
        ending.cancel()


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_ends_it_while_it_waits_for_a_line(number, code, tmp_path):
    command = [sys.executable, *COMMAND, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    client = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "x", "version": "1"}}
    greeting = {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": client}
    with subprocess.Popen(command, stderr=subprocess.PIPE, **pipes) as server:
        server.stdin.write(json.dumps(greeting).encode() + b"\n")
        server.stdin.flush()
        assert json.loads(server.stdout.readline())["id"] == 1
        server.send_signal(number)
        assert server.wait(60) == code
        assert server.stderr.read() == b""


@pytest.mark.slow
def test_a_key_is_asked_for(tmp_path):
    key = tmp_path / "key"
    key.write_text("0123456789abcdef-key")
    with http_server(tmp_path, "--api-key-file", str(key)) as url:
        for headers, status in (({}, 401), ({"x-api-key": key.read_text()}, 400)):
            request = urllib.request.Request(url, b"{}", headers)
            with pytest.raises(urllib.error.HTTPError) as refused_:
                urllib.request.urlopen(request, timeout=60)
            assert refused_.value.code == status
            refused_.value.close()


@pytest.mark.slow
def test_over_streamable_http(room, tmp_path):
    (tmp_path / "a room").symlink_to(room)
    (tmp_path / "another").symlink_to(room)

    async def talk(url: str) -> None:
        async with Client(url) as client:
            scenes = (await told(client, "list_scenes"))["scenes"]
            assert [scene["name"] for scene in scenes] == ["a room", "another"]
            assert "name a scene" in await refused(client, "locate", text="candle")
            found = await told(client, "locate", text="candle", scene="a room")
            pixel = {"view": "frame_00008", "x": 10.0, "y": 10.0}
            here = await told(client, "what_is_at_pixel", **pixel, scene="another", names=["wall", "floor"])
            assert {word["name"] for word in here["words"]} == {"wall", "floor"}
            assert found["num_matches"] == 1

    with http_server(tmp_path) as url:
        asyncio.run(talk(url))


@pytest.mark.slow
def test_what_takes_too_long_is_ended_and_the_next_question_is_answered(room):
    async def talk(url: str) -> None:
        async with Client(url) as client:
            await answered(client)
            (server,) = children_of(os.getpid(), b"mcp")
            (worker,) = children_of(server)
            os.kill(worker, signal.SIGSTOP)
            assert await refused(client, "locate", text="candle") == "no answer within 4 s: ask for less, or later"
            await answered(client)
            assert worker not in children_of(server)

    async def answered(client: Client) -> None:
        """Opening a scene may take longer than a request."""
        while (await client.call_tool("locate", {"text": "candle"})).is_error:
            await asyncio.sleep(0.5)

    with http_server(room, "--timeout", "4") as url:
        asyncio.run(talk(url))


@pytest.mark.slow
def test_a_signal_ends_the_process_that_computes_too(room):
    async def talk(client: Client) -> int:
        await told(client, "list_scenes")
        (server,) = children_of(os.getpid(), b"mcp")
        (worker,) = children_of(server)
        os.kill(server, signal.SIGTERM)
        return worker

    worker = over_stdio(room, talk)
    wait_for(lambda: not Path(f"/proc/{worker}").exists())


def test_what_cannot_start_says_why(tmp_path, capsys):
    assert "stdout speaks the protocol" in json.dumps(error_json(capsys, "mcp", str(tmp_path), "--json"))


def error_json(capsys: Capture, *argv: str) -> dict[str, Any]:
    from drsplat.cli import main

    capsys.readouterr()
    assert main([*argv]) == 1
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer
