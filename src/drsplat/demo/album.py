"""The demo's pictures: one per answer, and all on one sheet."""

from pathlib import Path

import numpy as np

from ..kernels import SplatArrays, splat_arrays
from ..pictures import (
    OtherPixels,
    as_pixels,
    best_views,
    contact_sheet,
    highlighted,
    titled,
    visible_share,
    write_picture,
    zoomed,
)
from ..rendering import render
from ..views import View
from .cameras import look_at
from .capture import BACKGROUND
from .story import Answer, Story

OVERVIEW = "overview.png"
_ROOM_EYE, _ROOM_TARGET, _ROOM_FOV = (4.9, -1.75, 2.2), (2.25, 2.1, 0.78), 64.0


def write_album(folder: Path, story: Story, *, overwrite: bool = False) -> list[Path]:
    """A PNG per answer in folder/answers and folder/overview.png; returns their paths, the overview first."""
    splats = splat_arrays(story.gaussians)
    (folder / "answers").mkdir(parents=True, exist_ok=True)
    paths, pictures = [folder / OVERVIEW], []
    views = best_views(
        story.gaussians, story.views, [answer.gaussian_ids for answer in story.answers]
    )
    for answer, view in zip(story.answers, views, strict=True):
        pictures.append(_answer_picture(story, answer, view, splats))
        paths.append(folder / "answers" / f"{answer.question.text.replace(' ', '_')}.png")
        write_picture(paths[-1], pictures[-1], overwrite)
    write_picture(paths[0], _overview(story, splats, pictures), overwrite)
    return paths


def _answer_picture(story: Story, answer: Answer, view: View, splats: SplatArrays) -> OtherPixels:
    """The photo's place, through a lens that suits the size of the thing."""
    view = view if answer.found else story.views[len(story.views) // 2]
    view = view.resized(640, 480)
    view = zoomed(view, visible_share(story.gaussians, view, answer.gaussian_ids, splats=splats))
    chosen = np.zeros((len(story.gaussians), 1), np.float32)
    chosen[answer.gaussian_ids] = 1
    drawn = render(story.gaussians, view, values=chosen, background=BACKGROUND, splats=splats)
    picture = highlighted(as_pixels(drawn.rgb), drawn.channels[..., 0])
    return titled(picture, f"“{answer.question.text}”", _note(answer))


def _note(answer: Answer) -> str:
    if not answer.found:
        return f"not found (best score {answer.scores[1]:.2f})"
    count = f"found in {answer.num_instances} places" if answer.num_instances > 1 else "found"
    return count if answer.iou is None else f"{count}, IoU {answer.iou:.2f}"


def _overview(story: Story, splats: SplatArrays, pictures: list[OtherPixels]) -> OtherPixels:
    """The room, then the answers in rows of four."""
    sheet = contact_sheet(pictures, columns=4)
    width = sheet.shape[1] - 28
    view = look_at("room", _ROOM_EYE, _ROOM_TARGET, width, width * 9 // 16, _ROOM_FOV)
    room = as_pixels(render(story.gaussians, view, background=BACKGROUND, splats=splats).rgb)
    frame = np.full((room.shape[0] + 14, sheet.shape[1], 3), 255, np.uint8)
    frame[14:, 14:-14] = room
    return np.concatenate([frame, sheet])
