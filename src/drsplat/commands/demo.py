"""drsplat demo: the whole pipeline on a room that it makes itself."""

import argparse
from pathlib import Path
from typing import Any

from .options import add_overwrite, tracker

SUMMARY = "make a furnished room with known objects, register it, ask for things, check the answers"
EXAMPLES = """\
  drsplat demo
  drsplat demo --output-dir room --overwrite --json
  drsplat query drsplat-demo/room.field "blue cup" --scene drsplat-demo/scene.ply    (afterwards)"""
CAPTION = (
    "The masks of this room were embedded by an encoder that knows words and has never seen an image; it stands in "
    "for CLIP so that the demo needs no download. Real photos need the embeddings of an image-text model."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--output-dir", "--output", "-o", default="drsplat-demo", metavar="DIR",
        help="folder for the scene, the photos, the field and the pictures (default: drsplat-demo)",
    )  # fmt: skip
    add_overwrite(parser)
    parser.add_argument(
        "--seed", type=int, default=0, help="of the noise in Gaussians and masks (default: 0)"
    )


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..demo.album import write_album
    from ..demo.story import FIELD, Setup, tell
    from ..progress import Stopwatch, peak_memory_bytes

    folder, watch = Path(arguments.output_dir), Stopwatch()
    story = tell(
        folder,
        Setup(seed=arguments.seed),
        overwrite=arguments.overwrite,
        threads=arguments.threads,
        track=tracker(arguments),
    )
    watch.lap("story")
    pictures = write_album(folder, story, overwrite=arguments.overwrite)
    watch.lap("pictures")
    return {
        "output_dir": str(folder),
        "scene": str(folder / "scene.ply"),
        "field": str(folder / FIELD),
        "overview": str(pictures[0]),
        "num_gaussians": len(story.gaussians),
        "num_registered": len(story.field),
        "num_views": len(story.views),
        "num_segments": story.num_segments,
        "num_weights": story.num_weights,
        "queries": [
            _query(answer, path) for answer, path in zip(story.answers, pictures[1:], strict=True)
        ],
        "num_right": sum(answer.is_right for answer in story.answers),
        "seconds": sum(watch.seconds.values()),
        "stage_seconds": {**story.seconds, "pictures": watch.seconds["pictures"]},
        "peak_memory_bytes": peak_memory_bytes(),
        "caption": CAPTION,
    }


def show(answer: dict[str, Any]) -> None:
    from rich.console import Console

    from .tables import said, show_table, size_said

    title = f"{said(answer['num_gaussians'])} Gaussians, {answer['num_views']} photos, {answer['num_segments']} masks"
    columns = ("asked for", "", "IoU", "Gaussians", "centre (m)", "ms")
    show_table(title, columns, [_row(query) for query in answer["queries"]])
    seconds, memory = answer["seconds"], size_said(answer["peak_memory_bytes"])
    print(
        f"{answer['num_right']} of {len(answer['queries'])} answers are right; {seconds:.1f} s, {memory} at most."
    )
    print(f"Look at {answer['overview']}, then ask yourself:")
    print(f'  drsplat query {answer["field"]} "blue cup" --scene {answer["scene"]}')
    Console(highlight=False, markup=False).print(f"\n{answer['caption']}", style="dim")


def _row(query: dict[str, Any]) -> tuple[str, ...]:
    found = f"found in {query['num_instances']} places" if query["num_instances"] > 1 else "found"
    iou = "" if query["iou"] is None else f"{query['iou']:.2f}"
    center = "" if query["center"] is None else " ".join(f"{x:.2f}" for x in query["center"])
    return (
        query["text"], found if query["found"] else "not found", iou, f"{query['num_selected']:,}", center,
        f"{1000 * query['seconds']:.0f}",
    )  # fmt: skip


def _query(answer: Any, picture: Path) -> dict[str, Any]:
    return {
        "text": answer.question.text,
        "meant": list(answer.question.things),
        "found": answer.found,
        "is_right": answer.is_right,
        "iou": answer.iou,
        "num_selected": len(answer.gaussian_ids),
        "num_instances": answer.num_instances,
        "center": answer.center,
        "score_range": list(answer.scores),
        "seconds": answer.seconds,
        "picture": str(picture),
    }
