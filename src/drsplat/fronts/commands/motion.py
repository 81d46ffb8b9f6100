"""drsplat motion: a scene that moves, of any format -> what is in it, or the same in another format."""

from .declaring import Facts, argument, declaration, finite, option
from .options import Verb, new_output, overwrite
from .tables import show_facts, text_of

EXAMPLES = """\
  drsplat motion gaussian_pertimestamp --times 0 1 --output film.motion
  drsplat motion film.motion --output frames

SCENE may be a folder of numbered PLY files with the same rows, or NAME.motion. An OUT that ends in .motion is written
as such; any other becomes a folder of frame0000.ply and so on, one per time."""


@declaration
class Options(Verb):
    """Options of this verb."""

    scene: str = argument("folder of numbered PLY files, or NAME.motion")
    times: list[float] | None = option(
        "times of the first and last numbered PLY file, the others evenly spaced (default: their numbers)",
        ("FIRST", "LAST"), finite, nargs=2,
    )  # fmt: skip
    output: str | None = option("NAME.motion, or a folder for numbered PLY files", "OUT", flags="-o")
    overwrite: bool = overwrite()


def run(options: Options) -> Facts:
    from ...formats.moving_scenes import read_moving, write_moving

    if options.output is not None:
        new_output(options.output, options.overwrite)
    times = None if options.times is None else (options.times[0], options.times[1])
    moving = read_moving(options.scene, times)
    if options.output is not None:
        write_moving(options.output, moving, options.overwrite)
    return {
        "scene": options.scene,
        "num_gaussians": len(moving),
        "num_times": len(moving.times),
        "times": list(moving.span),
        "fingerprint": moving.canonical.fingerprint,
        "output": options.output,
    }


def show(answer: Facts) -> None:
    start, end = answer["times"]
    show_facts(
        f"moving scene: {answer['scene']}",
        {
            "Gaussians": answer["num_gaussians"],
            "times": f"{text_of(answer['num_times'])}, from {start:g} to {end:g}",
            "written to": answer["output"] or "nothing: pass --output",
        },
    )
