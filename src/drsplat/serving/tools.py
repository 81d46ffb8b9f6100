"""The MCP server: the conversation's methods as tools of the protocol."""

import json
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from mcp.server import MCPServer
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError
from mcp_types import CallToolResult, TextContent, ToolAnnotations
from pydantic import Field, ValidationError

from .. import __version__
from ..errors import DrSplatError
from ..query.relations import Relation
from .catalog import Catalog, without_paths
from .conversation import (
    MOST_MATCHES,
    MOST_OBJECTS,
    About,
    Conversation,
    Count,
    Distance,
    Here,
    Place,
    Region,
    Related,
    Shown,
)
from .models import Located, ObjectList, SceneList
from .refusals import faults_of

INSTRUCTIONS = """\
3D scenes that can be searched in words. Start with list_scenes. Name objects as people do ("red mug"); "mug, not red"
excludes some. Positions are world coordinates [x, y, z] in scene units. An empty result is an answer: the scene has
nothing like it, or another word for it. Check counts with show, which returns a picture."""

T = TypeVar("T")
Text = Annotated[str, Field(description="query in a few words, e.g. 'red mug'", max_length=200)]
Scene = Annotated[str, Field(description="name from list_scenes; may be left out where there is only one")]
Names = Annotated[
    list[str] | None, Field(description="words to choose from; may be left out for encoders that know a list")
]
On = Annotated[
    str | None, Field(description="only those that stand on this, e.g. 'table'", min_length=1, max_length=200)
]
READS = ToolAnnotations(read_only_hint=True, idempotent_hint=True, open_world_hint=False)


class _Server(MCPServer):  # type: ignore[type-arg]
    """Whose refusals are ours: what was expected where, without the name of a library and its pages.

    Arguments that a tool does not know are refused, and answers are JSON without the spaces that cost tokens.
    """

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


def make_server(catalog: Catalog) -> MCPServer:
    """An MCP server over the scenes of a catalog; run it with `run("stdio")` or as streamable HTTP."""
    server = _Server(
        "drsplat",
        title="drsplat: scenes that answer words",
        instructions=INSTRUCTIONS,
        version=__version__,
        log_level="WARNING",
    )
    talk = Conversation(catalog)

    def told(ask: Callable[[], T]) -> T:
        try:
            return ask()
        except DrSplatError as error:
            raise ToolError(without_paths(str(error), catalog.roots)) from error

    @server.tool(title="List scenes", annotations=READS)
    def list_scenes() -> SceneList:
        """The scenes that can be searched, and how large they are."""
        return told(talk.list_scenes)

    @server.tool(title="About a scene", annotations=READS)
    def about_scene(scene: Scene = "") -> About:
        """How large a scene is, where it lies, which way is up, the unit of lengths, and some of its photos."""
        return told(lambda: talk.about_scene(scene))

    @server.tool(title="Locate matches", annotations=READS)
    def locate(
        text: Text,
        on: On = None,
        scene: Scene = "",
        top: Annotated[int, Field(ge=1, le=MOST_MATCHES, description="most matches to list")] = 5,
    ) -> Located:
        """All matches of a text, best first: centre, oriented box, score and supporting photos."""
        return told(lambda: talk.locate(text, on, scene, top))

    @server.tool(title="Count matches", annotations=READS)
    def count(text: Text, on: On = None, scene: Scene = "") -> Count:
        """How many matches a text has, in the scene or standing on something."""
        return told(lambda: talk.count(text, on, scene))

    @server.tool(title="Where is it", annotations=READS)
    def where_is(text: Text, scene: Scene = "") -> Place:
        """The best match of a text: where it is, how large it is, and the photo that shows it best."""
        return told(lambda: talk.where_is(text, scene))

    @server.tool(title="How far apart", annotations=READS)
    def how_far_apart(first: Text, second: Text, scene: Scene = "") -> Distance:
        """Distance between the best matches of two texts: centre to centre, and between their nearest parts."""
        return told(lambda: talk.how_far_apart(first, second, scene))

    @server.tool(title="What is at a point", annotations=READS)
    def what_is_at(
        point: Annotated[list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)],
        scene: Scene = "",
        names: Names = None,
    ) -> Here:
        """What is at a point of the scene: the best words for it."""
        at = (point[0], point[1], point[2])
        return told(lambda: talk.what_is_at(at, scene, names))

    @server.tool(title="What is at a pixel", annotations=READS)
    def what_is_at_pixel(
        view: Annotated[str, Field(description="a photo's name, as where_is and show return")],
        x: Annotated[float, Field(description="pixels from the left of the photo")],
        y: Annotated[float, Field(description="pixels from the top")],
        scene: Scene = "",
        names: Names = None,
    ) -> Here:
        """What a pixel of a photo shows, and where that is in the scene."""
        return told(lambda: talk.what_is_at((view, x, y), scene, names))

    @server.tool(title="List objects", annotations=READS)
    def list_objects(
        scene: Scene = "", top: Annotated[int, Field(ge=1, le=MOST_OBJECTS, description="most objects to list")] = 20
    ) -> ObjectList:
        """What is in a scene, largest first, without words for it: number, name if known, box, photos."""
        return told(lambda: talk.list_objects(scene, top))

    @server.tool(title="How objects lie", annotations=READS)
    def relations(
        relation: Relation,
        to: Annotated[str, Field(description="number from list_objects, or a text", min_length=1, max_length=200)],
        and_to: Annotated[str | None, Field(description="the second one, for 'between' only", max_length=200)] = None,
        scene: Scene = "",
    ) -> Related:
        """Which objects are on, in, next to or above one, or between two: what lies on the table?"""
        return told(lambda: talk.relations(relation, to, and_to, scene))

    @server.tool(title="Describe a region", annotations=READS)
    def describe_region(
        center: Annotated[list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)],
        radius: Annotated[float, Field(gt=0, description="scene units")],
        scene: Scene = "",
        names: Names = None,
    ) -> Region:
        """What lies within a radius of a point: names, how much of the region each is, and where."""
        return told(lambda: talk.describe_region(center, radius, scene, names))

    @server.tool(title="Show a picture", annotations=READS)
    def show(
        text: Annotated[str | None, Field(description="kept in colour, the rest grey; left out: all as it is")] = None,
        view: Annotated[str | None, Field(description="a photo's name; left out: the best one")] = None,
        scene: Scene = "",
    ) -> Annotated[CallToolResult, Shown]:
        """A rendered picture (PNG) of the scene, optionally with the matches of a text kept in colour."""
        shown, data = told(lambda: talk.show(text, view, scene))
        picture = Image(data=data, format="png").to_image_content()
        content: Any = [TextContent(type="text", text=shown.model_dump_json()), picture]
        return CallToolResult(content=content, structured_content=shown.model_dump())

    return server
