"""The MCP server: the conversation's questions as tools of the protocol."""

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from mcp.server import MCPServer
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError
from mcp_types import CallToolResult, TextContent, ToolAnnotations
from pydantic import Field

from .. import __version__
from ..errors import DrSplatError
from .catalog import Catalog, without_paths
from .conversation import MOST_THINGS, Conversation, Count, Distance, Here, Place, Region, Shown
from .models import SceneList, Things

INSTRUCTIONS = """\
3D scenes that can be searched in words. Start with list_scenes. Name things as people do ("red mug"); "mug, not red"
leaves some out. Positions are world coordinates [x, y, z] in scene units. An empty result is an answer: the scene has
no such thing, or another word for it. Check counts with show, which returns a picture."""

T = TypeVar("T")
Text = Annotated[str, Field(description="a thing in a few words, e.g. 'red mug'", max_length=200)]
Scene = Annotated[
    str, Field(description="name from list_scenes; may be left out where there is only one")
]
Names = Annotated[
    list[str] | None,
    Field(description="words to choose from; may be left out for encoders that know a list"),
]
READS = ToolAnnotations(read_only_hint=True, idempotent_hint=True, open_world_hint=False)


def make_server(catalog: Catalog) -> MCPServer:
    """An MCP server over the scenes of a catalog; run it with `run("stdio")` or as streamable HTTP."""
    server = MCPServer(
        "drsplat",
        title="drsplat: scenes that answer words",
        instructions=INSTRUCTIONS,
        version=__version__,
        log_level="WARNING",
    )
    asking = Conversation(catalog)

    def told(ask: Callable[[], T]) -> T:
        try:
            return ask()
        except DrSplatError as error:
            raise ToolError(without_paths(str(error), catalog.folder)) from error

    @server.tool(title="List scenes", annotations=READS)
    def list_scenes() -> SceneList:
        """The scenes that can be asked, and how large they are."""
        return told(asking.list_scenes)

    @server.tool(title="Find things", annotations=READS)
    def find(
        text: Text,
        scene: Scene = "",
        limit: Annotated[int, Field(ge=1, le=MOST_THINGS, description="most things")] = 5,
    ) -> Things:
        """All things that a text means, best first: centre, oriented box, score, and the photos that say so."""
        return told(lambda: asking.find(text, scene, limit))

    @server.tool(title="Count things", annotations=READS)
    def count(
        text: Text,
        on: Annotated[
            str | None, Field(description="count only those that stand on this, e.g. 'table'")
        ] = None,
        scene: Scene = "",
    ) -> Count:
        """How many things a text means, in the scene or on something."""
        return told(lambda: asking.count(text, on, scene))

    @server.tool(title="Where is it", annotations=READS)
    def where_is(text: Text, scene: Scene = "") -> Place:
        """Where the thing is that fits a text best, how large it is, and the photo that shows it best."""
        return told(lambda: asking.where_is(text, scene))

    @server.tool(title="How far apart", annotations=READS)
    def how_far_apart(first: Text, second: Text, scene: Scene = "") -> Distance:
        """Distance between two things: centre to centre, and between their nearest parts."""
        return told(lambda: asking.how_far_apart(first, second, scene))

    @server.tool(title="What is at a point", annotations=READS)
    def what_is_at(
        point: Annotated[
            list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)
        ],
        scene: Scene = "",
        names: Names = None,
    ) -> Here:
        """What is at a point of the scene: the best words for it."""
        at = (point[0], point[1], point[2])
        return told(lambda: asking.what_is_at(at, scene, names))

    @server.tool(title="What is at a pixel", annotations=READS)
    def what_is_at_pixel(
        view: Annotated[str, Field(description="a photo's name, as where_is and show return")],
        x: Annotated[float, Field(description="pixels from the left of the photo")],
        y: Annotated[float, Field(description="pixels from the top")],
        scene: Scene = "",
        names: Names = None,
    ) -> Here:
        """What a pixel of a photo shows, and where that is in the scene."""
        return told(lambda: asking.what_is_at((view, x, y), scene, names))

    @server.tool(title="Describe a region", annotations=READS)
    def describe_region(
        center: Annotated[
            list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)
        ],
        radius: Annotated[float, Field(gt=0, description="scene units")],
        scene: Scene = "",
        names: Names = None,
    ) -> Region:
        """What lies within a radius of a point: names, how much of the region each is, and where."""
        return told(lambda: asking.describe_region(center, radius, scene, names))

    @server.tool(title="Show a picture", annotations=READS)
    def show(
        text: Annotated[
            str | None, Field(description="kept in colour, the rest grey; left out: all as it is")
        ] = None,
        view: Annotated[
            str | None, Field(description="a photo's name; left out: the best one")
        ] = None,
        scene: Scene = "",
    ) -> Annotated[CallToolResult, Shown]:
        """A rendered picture (PNG) of the scene, if wanted with what a text means kept in colour."""
        shown, data = told(lambda: asking.show(text, view, scene))
        picture = Image(data=data, format="png").to_image_content()
        content: Any = [TextContent(type="text", text=shown.model_dump_json()), picture]
        return CallToolResult(content=content, structured_content=shown.model_dump())

    return server
