"""The MCP server: the conversation as tools of the protocol, computed where HTTP's are, and how it is spoken to."""

import asyncio
import inspect
import json
import os
import signal
import socket
from collections.abc import AsyncIterator, Sequence
from typing import Annotated, Any, TypeVar

import anyio
from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp_types import (
    INVALID_REQUEST,
    PARSE_ERROR,
    CallToolResult,
    ErrorData,
    ImageContent,
    JSONRPCError,
    JSONRPCNotification,
    TextContent,
    ToolAnnotations,
)
from pydantic import Field, ValidationError

from ... import __version__
from ...errors import DrSplatError
from .connections import run
from .conversation import MAX_MATCHES, TOOLS, Text, ToolEntry
from .guards import DoorKeeper, Limits
from .models import Body, RenderedPicture, RenderedView, SceneList
from .query_fields import CatalogueAnswer, annotation, default_of, without_nulls
from .replies import faults_of
from .scene_folder import SceneFolder
from .workbench import Job, Workbench

NOTIFICATIONS = "notifications/"  # how the methods of all notifications of the protocol begin
INSTRUCTIONS = """\
3D scenes that can be searched in words. Start with list_scenes. Name objects as people do ("red mug"); "mug, not red"
excludes some. Positions are world coordinates [x, y, z] in scene units. An empty result is an answer: the scene has
nothing like it, or another word for it. Check counts with show, which returns a picture."""
T = TypeVar("T", bound=Body)
SceneName = Annotated[str, Field(description="name from list_scenes; may be left out where there is only one")]
READ_ONLY = ToolAnnotations(read_only_hint=True, idempotent_hint=True, open_world_hint=False)
INTERRUPTED_EXIT_CODE = 130  # of shells, for Ctrl-C


class Answering:
    """The messages of a stream without the malformed ones, each of which is answered with an error.

    Args: messages: the SDK's stream of messages, and of exceptions in place of malformed ones. answers: its stream to
    the client.
    """

    def __init__(self, messages: Any, answers: Any) -> None:
        self._messages, self._answers = messages, answers

    def __aiter__(self) -> AsyncIterator[SessionMessage]:
        return self

    async def __anext__(self) -> SessionMessage:
        while True:
            item: SessionMessage | Exception = await anext(self._messages)
            if isinstance(item, SessionMessage) and not _lacks_an_id(item.message):
                return item
            error = error_for(item) if isinstance(item, Exception) else _invalid_request(None)
            if error is not None:
                await self._answers.send(SessionMessage(error))

    async def aclose(self) -> None:
        await self._messages.aclose()


def error_for(fault: Exception) -> JSONRPCError | None:
    """Return what answers a line that the SDK could not read, or None for an empty line."""
    faults = fault.errors(include_url=False) if isinstance(fault, ValidationError) else []
    line = next((str(one["input"]) for one in faults if one["type"] == "json_invalid"), None)
    if line is None:
        # the fields that an answer has and a request lacks are missing in the whole message
        return _invalid_request(next((one["input"] for one in faults if one["type"] == "missing"), None))
    if not line.strip():
        return None
    try:  # as Python's lenient reader finds it, which takes halves of surrogate pairs
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    return _error(message, PARSE_ERROR, f"expected one JSON-RPC message a line; {faults[0]['msg']}")


def _lacks_an_id(message: Any) -> bool:
    """Return whether a message asks for something under no id that an answer could name.

    The SDK takes it for a notification, which nothing answers: an id of null, 1.5 or a list is dropped.
    """
    return isinstance(message, JSONRPCNotification) and not message.method.startswith(NOTIFICATIONS)


def _invalid_request(message: object) -> JSONRPCError:
    expected = '{"jsonrpc": "2.0", "id": ..., "method": ..., "params": {...}}, the id a text or a whole number'
    return _error(message, INVALID_REQUEST, f"expected a JSON-RPC message: {expected}")


def _error(message: object, code: int, said: str) -> JSONRPCError:
    """Answer a message under its id, or under none where that cannot be written, as halves of surrogate pairs."""
    known = message.get("id") if isinstance(message, dict) else None
    if not (known.isprintable() if isinstance(known, str) else type(known) is int):
        known = None
    return JSONRPCError(jsonrpc="2.0", id=known, error=ErrorData(code=code, message=said))


class _Server(MCPServer):  # type: ignore[type-arg]
    """Server whose tools are computed by a workbench, no longer than they may take, and whose refusals are ours.

    They say what was expected where, without the name of a library and its pages. Arguments that a tool does not know
    are refused, and answers are JSON without the spaces that cost tokens.
    """

    def __init__(self, scene_folder: SceneFolder, bench: Workbench, limits: Limits) -> None:
        title = "drsplat: scenes that answer words"
        super().__init__(
            "drsplat", title=title, instructions=INSTRUCTIONS, version=__version__, log_level="WARNING"
        )  # fmt: skip
        self._scene_folder, self._bench, self._limits = scene_folder, bench, limits
        self.tool(title="List scenes", annotations=READ_ONLY)(self.list_scenes)
        for name, tool in TOOLS.items():
            self._add_tool(name, tool)
        if scene_folder.catalogue_path is not None:
            self.tool(title="Search all scenes", annotations=READ_ONLY)(self.search_all_scenes)

    async def run_stdio_async(self) -> None:
        """Speak on stdin and stdout; malformed lines are answered too."""
        async with stdio_server() as (messages, answers):
            server: Any = self._lowlevel_server
            await server.run(Answering(messages, answers), answers, server.create_initialization_options())

    async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:
        for tool in [tool for tool in await self.list_tools() if tool.name == name]:
            known = tool.input_schema["properties"]
            if not arguments.keys() <= known.keys():
                surplus = ", ".join(sorted(arguments.keys() - known.keys()))[:200]
                raise ToolError(f"{name}: no argument {surplus}; there are: {', '.join(known)}")
            arguments = without_nulls(arguments, known.keys() - tool.input_schema.get("required", ()))
        try:
            result = await super().call_tool(name, arguments, context)
        except ToolError as error:
            cause = error.__cause__
            if isinstance(cause, ValidationError):
                raise ToolError(f"{name}: {faults_of(cause.errors())}") from error
            if isinstance(cause, ToolError):
                raise cause from error
            raise
        if isinstance(result, CallToolResult) and result.structured_content is not None:
            text = json.dumps(result.structured_content, separators=(",", ":"))
            result.content[0] = TextContent(type="text", text=text)
        return result

    async def _answer(self, job: Job, model: type[T]) -> T:
        """Return what the workbench answers. Raises: ToolError: why it does not."""
        try:
            async with asyncio.timeout(self._limits.seconds):
                reply = await self._bench.run(job)
        except TimeoutError:
            raise ToolError(self._limits.too_slow) from None
        except DrSplatError as error:
            raise ToolError(str(error)) from error
        if reply.status != 200:
            raise ToolError(json.loads(reply.body)["error"])
        return model.model_validate_json(reply.body)

    async def list_scenes(self) -> SceneList:
        """List the scenes that can be searched, and how large they are."""
        listed = await self._answer(Job("list"), SceneList)
        advice = "" if listed.scenes else "there is no scene: ask the user to add a folder with a field"
        return listed.model_copy(update={"advice": advice})

    async def search_all_scenes(
        self,
        text: Text,
        top: Annotated[int, Field(ge=1, le=MAX_MATCHES, description="most matches to list")] = 5,
        scenes: Annotated[
            list[str] | None, Field(description="names of scenes to search; left out: all", max_length=64)
        ] = None,
    ) -> CatalogueAnswer:
        """Search all that was scanned: the best objects of a catalogue, with scene, box and photo."""
        asked = {"text": text, "top": top, "scenes": scenes or []}
        return await self._answer(Job("catalogue-ask", asked=asked), CatalogueAnswer)

    def _add_tool(self, name: str, tool: ToolEntry) -> None:
        """Offer a tool of `Conversation` with its own arguments, the fields of a query that it takes, and a scene."""
        method = inspect.signature(tool.method)
        body = method.return_annotation

        async def answer(scene: str = "", **arguments: Any) -> Any:
            name_of_scene = scene or self._scene_folder.only()
            if not name_of_scene:
                known = ", ".join(map(repr, list(self._scene_folder.folders())[:MAX_MATCHES])) or "none"
                raise ToolError(f"name a scene; there are: {known}")
            asked = {"tool": name, "name": name_of_scene, "arguments": arguments}
            found = await self._answer(Job("tool", name_of_scene, asked), body)
            if not isinstance(found, RenderedPicture):
                return found
            picture = ImageContent(type="image", data=found.png, mime_type="image/png")
            content: Any = [TextContent(type="text", text=found.view.model_dump_json()), picture]
            return CallToolResult(content=content, structured_content=found.view.model_dump())

        keyword = inspect.Parameter.KEYWORD_ONLY
        own = [one.replace(kind=keyword) for one in method.parameters.values() if one.name not in ("self", "cut")]
        cut = [
            inspect.Parameter(one.name, keyword, default=default_of(one), annotation=annotation(one))
            for one in tool.cut
        ]
        where = inspect.Parameter("scene", keyword, default="", annotation=SceneName)
        returned = Annotated[CallToolResult, RenderedView] if body is RenderedPicture else body
        signature = inspect.Signature([*own, *cut, where], return_annotation=returned)
        answer.__signature__ = signature  # type: ignore[attr-defined]
        self.add_tool(answer, name, title=tool.title, description=tool.method.__doc__, annotations=READ_ONLY)


def make_server(scene_folder: SceneFolder, bench: Workbench, limits: Limits) -> MCPServer:
    """Make an MCP server over the scenes of a folder; run it with `run("stdio")` or as streamable HTTP.

    bench: of the same folder; the caller closes it.
    """
    return _Server(scene_folder, bench, limits)


def over_stdio(server: MCPServer) -> None:
    """Speak until stdin ends, or until SIGINT or SIGTERM.

    The SDK reads stdin in a thread that nothing can interrupt, so Ctrl-C would wait for the next line for ever:
    the process ends at once, which costs nothing, for it only reads.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED_EXIT_CODE))
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    anyio.run(server.run_stdio_async)


def over_http(server: MCPServer, listening: socket.socket, key: str | None, hosts: Sequence[str] | None) -> None:
    """Speak streamable HTTP at /mcp of a socket until SIGINT or SIGTERM. key, hosts: see `DoorKeeper`."""
    app = DoorKeeper(server.streamable_http_app(host=listening.getsockname()[0]), key, hosts)
    run(app, listening, log_level="warning", timeout_graceful_shutdown=5)
