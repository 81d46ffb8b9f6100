"""Each edit before and after, on the scene that `drsplat demo` writes: the pictures of docs/editing.md.

python benchmarks/study_edits.py drsplat-demo OUT.jpg [--side PIXELS]
"""

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drsplat import Scene, open_scene, render
from drsplat.authoring.editing import (
    Copies,
    Duplicate,
    Edit,
    Fill,
    Isolate,
    MatchPhoto,
    Move,
    Opacity,
    Palette,
    Recolour,
    Remove,
    Rows,
    Turn,
    edited,
)
from drsplat.authoring.editing.draft import OBJECT_ID
from drsplat.authoring.editing.edits import Change
from drsplat.authoring.editing.replacement import replaced_by, scaled_on_its_foot
from drsplat.authoring.editing.resolving import query_rows
from drsplat.base.arrays import OtherPixels
from drsplat.drawing.pictures import as_pixels, contact_sheet, titled, write_picture
from drsplat.scene.views import View

VASE, TABLE, COUCH, CAR = "red vase", "wooden table", "couch", "green car"
SHARE = 0.45  # of a picture's height that a thing takes up where one looks at it closely
SUNSET = np.random.default_rng(0).normal((200, 110, 60), (30, 40, 50), (64, 64, 3)).clip(1, 255).astype(np.uint8)


class Study:
    """The scene, and what its words mean."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.scene = folder, open_scene(folder)
        self.rows: dict[str, Rows] = {}

    def of(self, words: str) -> Rows:
        if words not in self.rows:
            self.rows[words] = query_rows(self.scene, words)
        return self.rows[words]

    def sides(self, words: str, edits: Sequence[Edit], view: View) -> tuple[OtherPixels, OtherPixels]:
        scene = replace(self.scene.gaussians, extra={OBJECT_ID: self.scene.object_ids()})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of holes that stay open in part: seen in the picture
            after = edited(scene, edits, read=lambda _: scene)
        changed = "" if len(after) == len(scene) else f"{len(after) - len(scene):+,} Gaussians"
        print(f"{words}: {', '.join(type(edit.change).__name__ for edit in edits)}: {changed or 'as many Gaussians'}")
        before, now = (as_pixels(render(one, view).rgb) for one in (scene, after))
        return titled(before, words), titled(now, ", ".join(_said(edit.change) for edit in edits), changed)


def _said(change: Change) -> str:
    return {MatchPhoto: "like photo", Copies: "copies"}.get(type(change), type(change).__name__.lower())


def cases(study: Study) -> list[tuple[str, list[Edit]]]:
    scene: Scene = study.scene
    vase, up = study.of(VASE), scene.up
    part = scene.gaussians.subset(_ids(vase))
    couch = study.of(COUCH)
    car = replaced_by(part, up, study.folder, _object(scene, "green toy duck"), study.folder)

    def each(words: str, *changes: Change) -> tuple[str, list[Edit]]:
        return words, [Edit(study.of(words), change) for change in changes]

    copies = [Edit(vase, Duplicate((-0.35, 0.15, 0.0))), Edit(Copies(1), Recolour((0.1, 0.6, 0.2)))]
    return [
        each(VASE, Recolour((0.12, 0.38, 1.0))),
        each(VASE, Palette(((0.15, 0.2, 0.3), (0.95, 0.85, 0.5)))),
        each(VASE, MatchPhoto.of(SUNSET)),
        each(VASE, Opacity(0.3)),
        each(VASE, Move((-0.05, -0.28, 0.0))),
        each(VASE, Turn(90, (1.0, 0.0, 0.0))),
        each(VASE, scaled_on_its_foot(part, 1.6, up)),
        (VASE, copies),
        each(VASE, car),
        each(TABLE, Isolate()),
        each(VASE, Remove(), Fill()),
        each(CAR, Move((0.05, 0.25, 0.0))),
        each(CAR, Move((0.05, 0.25, 0.0)), Fill()),
        (COUCH, [Edit(couch, Remove())]),
        (COUCH, [Edit(couch, Remove()), Edit(couch, Fill())]),
        each(TABLE, Palette(((0.10, 0.16, 0.22), (0.55, 0.62, 0.66)))),
    ]


def closer(view: View, places: np.ndarray) -> View:
    """Return the view with a longer lens, turned to what is at some places."""
    across, down, depth = view.K @ (view.cam_from_world[:3, :3] @ places.mean(axis=0) + view.cam_from_world[:3, 3])
    middle = np.array([across, down]) / depth
    size = np.linalg.norm(np.quantile(places, 0.98, axis=0) - np.quantile(places, 0.02, axis=0))
    lens = max(1.0, SHARE * view.height * depth / (view.K[0, 0] * size))
    K = np.array(
        [[lens, 0, view.width / 2 - lens * middle[0]], [0, lens, view.height / 2 - lens * middle[1]], [0, 0, 1]]
    )
    return replace(view, K=K @ view.K)


def _ids(rows: Rows) -> np.ndarray:
    return np.concatenate([np.arange(begin, end) for begin, end in rows.spans.tolist()])


def _object(scene: Scene, words: str) -> int:
    match = scene.locate(words)[0]
    assert match.object_id is not None or scene.field.objects is not None
    owners = scene.object_ids()[match.gaussian_ids]
    return int(np.bincount(owners[owners >= 0]).argmax())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--side", type=int, default=480)
    given = parser.parse_args(arguments)
    study = Study(given.folder)
    tiles: list[OtherPixels] = []
    for words, edits in cases(study):
        view = study.scene.best_view(_ids(study.of(words))).limited(given.side)
        if isinstance(edits[-1].change, Fill) or words == CAR:
            view = closer(view, study.scene.gaussians.positions[_ids(study.of(words))])
        tiles += study.sides(words, edits, view)
    write_picture(given.output, contact_sheet(tiles, 4, tile_width=given.side, gap=6), overwrite=True)


if __name__ == "__main__":
    main()
