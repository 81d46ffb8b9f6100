"""The MCP server: the conversation's methods as tools of the protocol, computed where those of HTTP are."""

import asyncio
import json
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.stdio import stdio_server
from mcp_types import CallToolResult, ImageContent, TextContent, ToolAnnotations
from pydantic import Field, ValidationError

from ... import __version__
from ...errors import DrSplatError
from ...query.relations import OfTwo, Relation
from ...scene.boxes import BoxKind
from .catalogued import CatalogueAnswer
from .conversation import (  # fmt: skip
    MOST_MATCHES,
    MOST_OBJECTS,
    About,
    Count,
    Distance,
    Here,
    Pictured,
    Place,
    Region,
    Related,
    Shown,
)
from .limits import Limits
from .malformed import Answering
from .models import Body, Located, ObjectList, SceneList, When
from .refusals import faults_of
from .requests import WithObjects
from .scene_folder import SceneFolder
from .workbench import Job, Workbench

INSTRUCTIONS = """\
3D scenes that can be searched in words. Start with list_scenes. Name objects as people do ("red mug"); "mug, not red"
excludes some. Positions are world coordinates [x, y, z] in scene units. An empty result is an answer: the scene has
nothing like it, or another word for it. Check counts with show, which returns a picture."""

T = TypeVar("T", bound=Body)
Text = Annotated[str, Field(description="query in a few words, e.g. 'red mug'", max_length=200)]
SceneName = Annotated[str, Field(description="name from list_scenes; may be left out where there is only one")]
Names = Annotated[
    list[str] | None, Field(description="words to choose from; may be left out for encoders that know a list")
]
On = Annotated[
    str | None, Field(description="only those that stand on this, e.g. 'table'", min_length=1, max_length=200)
]
During = Annotated[
    list[float] | None,
    Field(description="[start, end] of a span of time, of a scene that moves", min_length=2, max_length=2),
]
READS = ToolAnnotations(read_only_hint=True, idempotent_hint=True, open_world_hint=False)


class _Server(MCPServer):  # type: ignore[type-arg]
    """Whose refusals are ours: what was expected where, without the name of a library and its pages.

    Arguments that a tool does not know are refused, and answers are JSON without the spaces that cost tokens.
    """

    async def run_stdio_async(self) -> None:
        """Speak on stdin and stdout; malformed lines are answered too."""
        async with stdio_server() as (messages, answers):
            server: Any = self._lowlevel_server
            await server.run(Answering(messages, answers), answers, server.create_initialization_options())

    async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:
        for tool in await self.list_tools():
            known = tool.input_schema["properties"]
            if tool.name == name and not arguments.keys() <= known.keys():
                surplus = ", ".join(sorted(arguments.keys() - known.keys()))[:200]
                raise ToolError(f"{name}: no argument {surplus}; there are: {', '.join(known)}")
        try:
            return _terse(await super().call_tool(name, arguments, context))
        except ToolError as error:
            cause = error.__cause__
            if isinstance(cause, ValidationError):
                raise ToolError(f"{name}: {faults_of(cause.errors())}") from error
            if isinstance(cause, ToolError):
                raise cause from error
            raise


def _terse(result: Any) -> Any:
    if isinstance(result, CallToolResult) and result.structured_content is not None:
        text = json.dumps(result.structured_content, separators=(",", ":"))
        result.content[0] = TextContent(type="text", text=text)
    return result


@dataclass(frozen=True, eq=False)
class _Asking:
    """How tools are computed: in a process of the workbench, and no longer than it may take."""

    scene_folder: SceneFolder
    bench: Workbench
    limits: Limits

    async def list_scenes(self) -> SceneList:
        listed = SceneList.model_validate_json(await self._answer(Job("list")))
        advice = "" if listed.scenes else "there is no scene: ask the user to add a folder with a field"
        return listed.model_copy(update={"advice": advice})

    async def tool_answer(self, model: type[T], tool: str, scene: str, **arguments: Any) -> T:
        """Return what a tool of `Conversation` answers about a scene; "" is the only one."""
        name = scene or self.scene_folder.only()
        if not name:
            known = ", ".join(map(repr, list(self.scene_folder.folders())[:MOST_MATCHES])) or "none"
            raise ToolError(f"name a scene; there are: {known}")
        asked = {"tool": tool, "name": name, "arguments": arguments}
        return model.model_validate_json(await self._answer(Job("tool", name, asked)))

    async def search(self, **asked: Any) -> CatalogueAnswer:
        return CatalogueAnswer.model_validate_json(await self._answer(Job("catalogue-ask", asked=asked)))

    async def _answer(self, job: Job) -> bytes:
        try:
            async with asyncio.timeout(self.limits.seconds):
                reply = await self.bench.run(job)
        except TimeoutError:
            raise ToolError(self.limits.too_slow) from None
        except DrSplatError as error:
            raise ToolError(str(error)) from error
        if reply.status != 200:
            raise ToolError(json.loads(reply.body)["error"])
        return reply.body


def make_server(scene_folder: SceneFolder, bench: Workbench, limits: Limits) -> MCPServer:
    """Make an MCP server over the scenes of a folder; run it with `run("stdio")` or as streamable HTTP.

    bench: of the same folder; the caller closes it.
    """
    server = _Server(
        "drsplat",
        title="drsplat: scenes that answer words",
        instructions=INSTRUCTIONS,
        version=__version__,
        log_level="WARNING",
    )
    asking = _Asking(scene_folder, bench, limits)
    _add_scenes(server, asking)
    _add_matches(server, asking)
    _add_places(server, asking)
    _add_objects(server, asking)
    _add_times(server, asking)
    _add_pictures(server, asking)
    if scene_folder.catalogue_path is not None:
        _add_catalogue(server, asking)
    return server


def _add_scenes(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="List scenes", annotations=READS)
    async def list_scenes() -> SceneList:
        """List the scenes that can be searched, and how large they are."""
        return await asking.list_scenes()

    @server.tool(title="About a scene", annotations=READS)
    async def about_scene(scene: SceneName = "") -> About:
        """How large a scene is, where it lies, which way is up, the unit of lengths, and some of its photos."""
        return await asking.tool_answer(About, "about_scene", scene)


def _add_matches(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="Locate matches", annotations=READS)
    async def locate(
        text: Text,
        on: On = None,
        scene: SceneName = "",
        top: Annotated[int, Field(ge=1, le=MOST_MATCHES, description="most matches to list")] = 5,
        box: Annotated[
            BoxKind, Field(description="upright: the third axis of boxes is up; free: along the match's own axes")
        ] = "upright",
        during: During = None,
        tracks: Annotated[
            bool, Field(description="tell where each is over time, and when photos see it, of a scene that moves")
        ] = False,
        objects: WithObjects = "auto",
    ) -> Located:
        """All matches of a text, best first: centre, oriented box, score and supporting photos."""
        asked = {"text": text, "on": on, "top": top, "box": box, "during": during, "tracks": tracks}
        return await asking.tool_answer(Located, "locate", scene, **asked, objects=objects)

    @server.tool(title="Count matches", annotations=READS)
    async def count(
        text: Text, on: On = None, scene: SceneName = "", during: During = None, objects: WithObjects = "auto"
    ) -> Count:
        """How many matches a text has, in the scene or standing on something."""
        return await asking.tool_answer(Count, "count", scene, text=text, on=on, during=during, objects=objects)

    @server.tool(title="Where is it", annotations=READS)
    async def where_is(
        text: Text, scene: SceneName = "", during: During = None, objects: WithObjects = "auto"
    ) -> Place:
        """Find the best match of a text: where it is, how large it is, and the photo that shows it best."""
        return await asking.tool_answer(Place, "where_is", scene, text=text, during=during, objects=objects)

    @server.tool(title="How far apart", annotations=READS)
    async def how_far_apart(
        first: Text, second: Text, scene: SceneName = "", objects: WithObjects = "auto"
    ) -> Distance:
        """Distance between the best matches of two texts: centre to centre, and between their nearest parts."""
        return await asking.tool_answer(Distance, "how_far_apart", scene, first=first, second=second, objects=objects)


def _add_places(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="What is at a point", annotations=READS)
    async def what_is_at(
        point: Annotated[list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)],
        scene: SceneName = "",
        names: Names = None,
    ) -> Here:
        """Name what is at a point of the scene, best words first."""
        return await asking.tool_answer(Here, "what_is_at", scene, point=point, names=names)

    @server.tool(title="What is at a pixel", annotations=READS)
    async def what_is_at_pixel(
        view: Annotated[str, Field(description="a photo's name, as where_is and show return")],
        x: Annotated[float, Field(description="pixels from the left of the photo")],
        y: Annotated[float, Field(description="pixels from the top")],
        scene: SceneName = "",
        names: Names = None,
    ) -> Here:
        """Name what a pixel of a photo shows, and tell where that is in the scene."""
        return await asking.tool_answer(Here, "what_is_at_pixel", scene, view=view, x=x, y=y, names=names)

    @server.tool(title="Describe a region", annotations=READS)
    async def describe_region(
        center: Annotated[list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)],
        radius: Annotated[float, Field(gt=0, description="scene units")],
        scene: SceneName = "",
        names: Names = None,
    ) -> Region:
        """Name what lies within a radius of a point: names, how much of the region each is, and where."""
        return await asking.tool_answer(Region, "describe_region", scene, center=center, radius=radius, names=names)


def _add_objects(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="List objects", annotations=READS)
    async def list_objects(
        scene: SceneName = "",
        top: Annotated[int, Field(ge=1, le=MOST_OBJECTS, description="most objects to list")] = 20,
        unsure: Annotated[bool, Field(description="list also what photos agree less on, most of it scraps")] = False,
    ) -> ObjectList:
        """List what is in a scene, largest first, without words for it: number, name if known, box, photos."""
        return await asking.tool_answer(ObjectList, "list_objects", scene, top=top, unsure=unsure)

    @server.tool(title="How objects lie", annotations=READS)
    async def relations(
        relation: Relation,
        to: Annotated[str, Field(description="number from list_objects, or a text", min_length=1, max_length=200)],
        and_to: Annotated[str | None, Field(description="the second one, for 'between' only", max_length=200)] = None,
        scene: SceneName = "",
    ) -> Related:
        """Find the objects on, in, next to or above one, or between two, such as what lies on the table."""
        return await asking.tool_answer(Related, "relations", scene, relation=relation, to=to, and_to=and_to)


def _add_times(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="When does it hold", annotations=READS)
    async def when(
        one: Text,
        relation: Annotated[
            OfTwo, Field(description="relation of the one to the other; left and right as seen from view")
        ],
        other: Text,
        view: Annotated[str | None, Field(description="a photo's name, for left_of and right_of only")] = None,
        scene: SceneName = "",
        objects: WithObjects = "auto",
    ) -> When:
        """In which spans of time one match stands in a relation to another, in a scene that moves."""
        asked = {"one": one, "relation": relation, "other": other, "view": view, "objects": objects}
        return await asking.tool_answer(When, "when", scene, **asked)


def _add_pictures(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="Show a picture", annotations=READS)
    async def show(
        text: Annotated[str | None, Field(description="kept in colour, the rest grey; left out: all as it is")] = None,
        view: Annotated[str | None, Field(description="a photo's name; left out: the best one")] = None,
        scene: SceneName = "",
        objects: WithObjects = "auto",
    ) -> Annotated[CallToolResult, Shown]:
        """Render a picture (PNG) of the scene, optionally with the matches of a text kept in colour."""
        found = await asking.tool_answer(Pictured, "show", scene, text=text, view=view, objects=objects)
        picture = ImageContent(type="image", data=found.png, mime_type="image/png")
        content: Any = [TextContent(type="text", text=found.shown.model_dump_json()), picture]
        return CallToolResult(content=content, structured_content=found.shown.model_dump())


def _add_catalogue(server: MCPServer, asking: _Asking) -> None:
    @server.tool(title="Search all scenes", annotations=READS)
    async def search_all_scenes(
        text: Text,
        top: Annotated[int, Field(ge=1, le=MOST_MATCHES, description="most matches to list")] = 5,
        scenes: Annotated[
            list[str] | None, Field(description="names of scenes to search; left out: all", max_length=64)
        ] = None,
    ) -> CatalogueAnswer:
        """Search all that was scanned: the best objects of a catalogue, with scene, box and photo."""
        return await asking.search(text=text, top=top, scenes=scenes or [])
