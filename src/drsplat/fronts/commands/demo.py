"""drsplat demo: photos to answers, on a small scene that ships."""

from pathlib import Path
from typing import Any

from ...base.progress import Stopwatch
from ...base.terminal import counted
from .declaring import Facts, declaration, option
from .options import Verb, overwrite
from .tables import place_text, show_table, size_text, text_of

EXAMPLES = """\
  drsplat demo
  drsplat demo --output-dir room --overwrite --json
  drsplat locate drsplat-demo "red vase"        (afterwards)
  drsplat objects drsplat-demo --picture objects.jpg
  drsplat view drsplat-demo --export page.html --ask "red vase; couch"

To resume a stopped run, give the same command again without --overwrite."""
PAGE, TITLE = "index.html", "A room, searched in words"
CAPTION = (
    "The photos are renderings of a made-up room that neither the segmenter nor the encoder learned from; both are "
    "built in, small, and know this kind of room only. Real photos need SAM and CLIP: see drsplat embed --help."
)


@declaration
class Options(Verb):
    """Options of this verb."""

    output_dir: str = option(
        "folder for the scene, the photos, the field and the pictures (default: drsplat-demo)", "DIR", None,
        "drsplat-demo", flags="--output-dir --output -o",
    )  # fmt: skip
    overwrite: bool = overwrite()


def run(options: Options) -> Facts:
    from ...evaluation.demo.story import FIELD, SCENE, resumable, tell, write_album
    from ...query import Scene
    from ..viewing.exporting import export_page

    folder, threads = Path(options.output_dir), options.threads
    watch, page = Stopwatch(), folder / PAGE
    with resumable(folder, options.overwrite):
        story = tell(folder, overwrite=True, anew=options.overwrite, **options.running)
        watch.lap("story")
        pictures = write_album(folder, story, overwrite=True)
        watch.lap("pictures")
        scene = Scene(story.field, story.gaussians, story.views, threads=threads)
        export_page(page, scene, [one.probe.text for one in story.verdicts], title=TITLE, edits="none", overwrite=True)
    watch.lap("page")
    spent = watch.measures()
    return {
        "output_dir": folder,
        "scene": folder / SCENE,
        "field": folder / FIELD,
        "overview": pictures[0],
        "page": page,
        "num_gaussians": len(story.gaussians),
        "num_registered": len(story.field),
        "num_photos": len(story.views),
        "num_held_out": len(story.held_out),
        "num_masks": story.num_masks,
        "num_weights": story.num_weights,
        "queries": [_query(verdict, path) for verdict, path in zip(story.verdicts, pictures[1:], strict=True)],
        "num_right": sum(verdict.is_right for verdict in story.verdicts),
        **spent,
        "stage_seconds": {**story.seconds, "pictures": watch.seconds["pictures"], "page": watch.seconds["page"]},
        "caption": CAPTION,
    }


def interrupted(options: Options) -> str:
    """Return what a stopped demo keeps, and how to go on."""
    again = ", without --overwrite," if options.overwrite else ""
    return f"the photos embedded so far are kept in {options.output_dir}: give the same command again{again} to go on"


def show(answer: Facts) -> None:
    from rich.console import Console

    photos, masks = answer["num_photos"], answer["num_masks"]
    sizes = f"{text_of(answer['num_gaussians'])} Gaussians, {photos} photos, {text_of(masks)} masks"
    title = f"{sizes}; lengths in scene units, here metres"
    columns = ("query", "", "", "IoU", "Gaussians", "centre", "ms")
    show_table(title, columns, [_row(query) for query in answer["queries"]])
    seconds, memory = answer["seconds"], size_text(answer["peak_memory_bytes"])
    print(
        f"{answer['num_right']} of {len(answer['queries'])} answers are right, by what they are sure of in "
        f"{answer['num_held_out']} photos held out; {seconds:.1f} s, {memory} at most."
    )
    folder = answer["output_dir"]
    print(f"Open {answer['page']} in a browser: it shows the room and answers words, without a server or a network.")
    print(f"{answer['overview']} has all answers on one picture. Then try your own query:")
    print(f'  drsplat locate {folder} "red vase"')
    print(f"  drsplat objects {folder} --picture objects.jpg")
    Console(highlight=False, markup=False).print(f"\n{answer['caption']}", style="dim")


def _row(query: Facts) -> tuple[str, ...]:
    matches = counted(query["num_matches"], "match", "matches")
    matches += "" if query["count"] == query["num_matches"] else f", {query['count']} sure"
    iou = "" if query["iou"] is None else f"{query['iou']:.2f}"
    center = "" if query["center"] is None else place_text(query["center"])
    return (
        query["text"], "right" if query["is_right"] else "MISS", matches, iou,
        f"{query['num_selected']:,}", center, f"{1000 * query['seconds']:.0f}",
    )  # fmt: skip


def _query(verdict: Any, picture: Path) -> Facts:
    return {
        "text": verdict.probe.text,
        "expected": verdict.probe.meant,
        "is_right": verdict.is_right,
        "iou": verdict.iou,
        "num_selected": len(verdict.gaussian_ids),
        "num_unsure": len(verdict.unsure_ids),
        "count": verdict.count,
        "num_matches": verdict.num_matches,
        "center": verdict.center,
        "score_range": verdict.scores,
        "seconds": verdict.seconds,
        "picture": picture,
    }
