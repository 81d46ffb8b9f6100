"""Pictures of the demo: one per answer, and all on one sheet under a photo of the room."""

from pathlib import Path

import numpy as np
from PIL import Image

from ...base.arrays import OtherPixels
from ...base.terminal import counted
from ...drawing.pictures import (
    as_pixels,
    best_views,
    contact_sheet,
    highlighted,
    photo_or_rendering,
    titled,
    visible_share,
    write_picture,
    zoomed,
)
from ...drawing.rendering import render
from ...formats.replacing import saying_what_is_full
from ...scene.views import View
from .story import Story, Verdict

OVERVIEW = "overview.png"


def write_album(folder: Path, story: Story, *, overwrite: bool = False) -> list[Path]:
    """Write a PNG per answer to folder/answers, and folder/overview.png; return the paths, the overview first."""
    with saying_what_is_full(folder / "answers"):
        (folder / "answers").mkdir(parents=True, exist_ok=True)
    paths, pictures = [folder / OVERVIEW], []
    selections = [verdict.gaussian_ids for verdict in story.verdicts]
    views = best_views(story.gaussians, story.held_out + story.views, selections)
    for verdict, view in zip(story.verdicts, views, strict=True):
        picture = _answer_picture(story, verdict, view)
        pictures.append(titled(picture, f"“{verdict.probe.text}”", note(verdict)))
        paths.append(folder / "answers" / f"{verdict.probe.text.replace(' ', '_')}.png")
        write_picture(paths[-1], picture, overwrite)
    write_picture(paths[0], _overview(story, pictures), overwrite)
    return paths


def note(verdict: Verdict) -> str:
    """Return the result of a probe, in a few words."""
    if not verdict.found:
        manner = "rightly" if verdict.is_right else "miss:"
        return f"{manner} no match (best score {verdict.scores[1]:.2f})"
    count = counted(verdict.num_matches, "match", "matches")
    if verdict.iou is None:
        return f"wrong: {count}, but there is none"
    return f"{'' if verdict.is_right else 'miss: '}{count}, IoU {verdict.iou:.2f}"


def _answer_picture(story: Story, verdict: Verdict, view: View) -> OtherPixels:
    """Draw the Gaussians of an answer from the view that shows most of them, with a lens that suits their size."""
    view = view if verdict.found else story.held_out[0]
    view = zoomed(view, visible_share(story.gaussians, view, verdict.gaussian_ids, splats=story.splats))
    chosen = np.zeros((len(story.gaussians), 1), np.float32)
    chosen[verdict.gaussian_ids] = 1
    drawn = render(story.gaussians, view, values=chosen, splats=story.splats)
    return highlighted(as_pixels(drawn.rgb), drawn.channels[..., 0])


def _overview(story: Story, pictures: list[OtherPixels]) -> OtherPixels:
    """Put two photos of the room above the answers in rows of four."""
    sheet = contact_sheet(pictures, columns=4)
    views = [story.held_out[0], story.held_out[-1]]
    photos = [Image.fromarray(photo_or_rendering(story.gaussians, view)) for view in views]
    width = (sheet.shape[1] - 42) // 2
    height = width * photos[0].height // photos[0].width
    frame = Image.new("RGB", (sheet.shape[1], height + 14), "white")
    for number, photo in enumerate(photos):
        frame.paste(photo.resize((width, height)), (14 + number * (width + 14), 14))
    return np.concatenate([np.asarray(frame), sheet])
