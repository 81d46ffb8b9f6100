"""drsplat tile: scenes, or blocks of one -> a folder of tiles."""

from pathlib import Path

from ...base.progress import Stopwatch
from ...base.system import folder_bytes
from ...base.terminal import counted
from .declaring import Facts, argument, count, declaration, option
from .options import Verb, new_output, overwrite
from .tables import show_facts, size_text, text_of

EXAMPLES = """\
  drsplat tile scene.ply --output city.tiles
  drsplat tile block_a.ply block_b.ply --output city.tiles
  drsplat tile blocks.json --output city.tiles
  drsplat tile streamed/lod-meta.json --output city.tiles

blocks.json is a list of {"file": "block_a.ply", "transform": 4x4 rows, "keep": {"low": [x, y, z], "high": [x, y,
z]}}; transform maps the block to the world, and Gaussians outside of keep are left out.

Every verb takes the folder as a scene. Its rows have a new order; the columns block and source_row say where each
Gaussian came from."""


@declaration
class Options(Verb):
    """Options of this verb."""

    scenes: list[str] = argument(
        "scene files in one world, a streamed SOG, or JSON that lists blocks", value="SCENE", nargs="+"
    )
    output: str = option("folder to write, conventionally NAME.tiles", "TILES", flags="-o", required=True)
    rows: int | None = option("Gaussians per tile (default: 131072)", "N", count)
    overwrite: bool = overwrite()


def run(options: Options) -> Facts:
    from ...field.tiles.cutting import TILE_ROWS, cut
    from ...formats.sources import blocks_of

    output, watch = new_output(options.output, options.overwrite), Stopwatch()
    blocks = blocks_of([Path(scene) for scene in options.scenes])
    tiles = cut(blocks, output, options.rows or TILE_ROWS, overwrite=options.overwrite)
    watch.lap("cut")
    return {
        "tiles": output,
        "num_gaussians": len(tiles),
        "num_tiles": len(tiles.tiles),
        "scene": tiles.fingerprint,
        "sources": tiles.sources,
        "origin": tiles.origin,
        "near": tiles.near,
        "bytes": folder_bytes(output),
        **watch.measures(),
    }


def show(answer: Facts) -> None:
    show_facts(
        f"cut: {answer['tiles']}",
        {
            "Gaussians": f"{text_of(answer['num_gaussians'])} of {counted(len(answer['sources']), 'file')}",
            "tiles": f"{text_of(answer['num_tiles'])}, {size_text(answer['bytes'])}",
            "time": f"{answer['seconds']:.1f} s",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )
