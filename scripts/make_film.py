"""The film of the front page, of the demo's scene: ask for a thing, fly to it, cut it out; and a still of it.

usage: python make_film.py DEMO [FOLDER]    DEMO: what `drsplat demo` wrote. FOLDER: docs/images by default

Writes tour.webp, an endless film, and tour.jpg for who wants no motion. It is made again when the scene, the answers or
the way pictures look have changed; the demo's answers are the same on every machine, so the film is, too.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import drsplat as ds
from drsplat.authoring.filming.frames import Highlight
from drsplat.authoring.filming.looking import looking_at
from drsplat.authoring.filming.paths import CameraPath, KeyFrame
from drsplat.drawing.pictures import as_pixels
from drsplat.drawing.rendering import render

ROOT = Path(__file__).resolve().parent.parent
WORDS = "red vase"
SIZE, FINER = (720, 450), 2  # pixels of the film; pictures are drawn so many times as large and made smaller
FPS, FILM_S, STILL_AT_S = 12, 10.0, 3.75
TYPED_S, FOUND_S, CUT_S, AGAIN_S = (0.5, 1.5), (1.7, 2.5), (5.9, 7.0), (9.3, 10.0)
STEPS = (("Ask", 0.0), ("Fly to it", 2.9), ("Cut it out", 5.9))  # names, and seconds from which each is lit
AROUND_DEGREES, NEAR, ABOVE = 150.0, 0.62, 0.24  # of the last part: a turn, its distance and height in scene units
QUALITY, STILL_QUALITY = 62, 84
PAPER, INK, FAINT, LIT = (255, 255, 255), (28, 30, 36), (98, 104, 118), (196, 30, 112)


@dataclass(frozen=True, eq=False)
class Film:
    """The scene, and what it answers."""

    scene: ds.Scene
    answer: Highlight

    @cached_property
    def path(self) -> CameraPath:
        """From a wide look at the room to the thing, then around it."""
        thing, up = self.answer.matches[0].center, np.array([0.0, 0.0, 1.0])
        room = np.array([0.3, 0.15, 0.55])
        start = np.arctan2(-0.62, -0.42)  # of the turn, seen from above
        turns = [start + np.radians(AROUND_DEGREES) * share for share in (0, 1 / 3, 2 / 3, 1)]
        near = [thing + np.array([NEAR * np.cos(turn), NEAR * np.sin(turn), ABOVE]) for turn in turns]
        keys = [
            (np.array([-1.5, 0.35, 1.55]), room, 46.0, 0.0), (np.array([-1.28, -0.05, 1.5]), room, 44.0, 2.9),
            *((eye, thing, 34.0, 5.4 + 1.6 * number) for number, eye in enumerate(near)),
        ]  # fmt: skip
        views = [(looking_at(eye, target, up, SIZE, fov), seconds) for eye, target, fov, seconds in keys]
        return CameraPath([KeyFrame.of(view, seconds) for view, seconds in views])

    def pictures(self) -> Iterator[Image.Image]:
        first = self.picture(0)
        for number in range(round(FILM_S * FPS)):
            picture = Image.blend(self.picture(number), first, share_of(number / FPS, AGAIN_S))
            yield with_words(picture, number / FPS)

    def still(self) -> Image.Image:
        """One picture for all: the thing, from near."""
        return with_words(self.picture(round(STILL_AT_S * FPS)), STILL_AT_S)

    def picture(self, number: int) -> Image.Image:
        return Image.fromarray(self.room(self.views[number], number / FPS)).reduce(FINER)

    @cached_property
    def views(self) -> list[ds.View]:
        return list(self.path.views(round(FILM_S * FPS), (FINER * SIZE[0], FINER * SIZE[1])))

    def room(self, view: ds.View, second: float) -> np.ndarray:
        """What the camera sees: the room, the answer over it, and in the end nothing else."""
        found, alone = share_of(second, FOUND_S), share_of(second, CUT_S)
        thing = as_pixels(self.drawn(view, self.answer.matches[0].gaussian_ids).rgb) if alone > 0 else None
        if alone == 1 and thing is not None:
            return thing
        drawn = self.drawn(view, None)
        plain = as_pixels(drawn.rgb)
        picture = self.answer.over(drawn, plain, view, found) if found > 0 else plain
        return picture if thing is None else mixed(picture, thing, alone)

    def drawn(self, view: ds.View, ids: np.ndarray | None) -> object:
        scene = self.scene
        values = None if ids is not None else self.answer.values
        return render(scene.gaussians, view, select=ids, values=values, background=(1.0, 1.0, 1.0), splats=scene.splats)


def share_of(second: float, span: tuple[float, float]) -> float:
    """How much of a change is done, from 0 to 1, slow at both ends."""
    part = float(np.clip((second - span[0]) / (span[1] - span[0]), 0, 1))
    return part * part * (3 - 2 * part)


def mixed(one: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    return np.asarray(one + (other.astype(np.float32) - one) * share).astype(np.uint8)


def with_words(picture: Image.Image, second: float) -> Image.Image:
    """A box with the words as they are typed, and the three steps."""
    pen, letters, small = ImageDraw.Draw(picture), ImageFont.load_default(22), ImageFont.load_default(16)
    width, height = picture.size
    typed = "" if second >= AGAIN_S[0] else WORDS[: round(len(WORDS) * share_of(second, TYPED_S))]
    top = height - 62
    pen.rounded_rectangle((20, top, 300, top + 42), 21, PAPER, FAINT)
    pen.ellipse((36, top + 12, 50, top + 26), outline=FAINT, width=2)
    pen.line((48, top + 25, 55, top + 32), FAINT, 3)
    pen.text((68, top + 21), typed, INK, letters, anchor="lm")
    if second < FOUND_S[1] and int(second * 2.5) % 2 == 0:
        at = 70 + letters.getlength(typed)
        pen.line((at, top + 11, at, top + 31), INK, 2)
    begins = [seconds for _, seconds in STEPS]
    lit = max(number for number, seconds in enumerate(begins) if second >= seconds)
    right = width - 20
    for number, (name, _) in reversed(list(enumerate(STEPS))):
        left = right - small.getlength(name) - 26
        on = number == lit
        pen.rounded_rectangle((left, top + 4, right, top + 38), 17, LIT if on else PAPER, LIT if on else FAINT)
        pen.text(((left + right) / 2, top + 21), name, PAPER if on else INK, small, anchor="mm")
        right = left - 8
    return picture


def main(arguments: list[str]) -> int:
    scene = ds.open_scene(arguments[0])
    folder = Path(arguments[1]) if len(arguments) > 1 else ROOT / "docs/images"
    the_film = Film(scene, Highlight.of(scene, ds.Query(WORDS), boxes=True))
    pictures = list(the_film.pictures())
    film = folder / "tour.webp"
    pictures[0].save(
        film, save_all=True, append_images=pictures[1:], duration=round(1000 / FPS), loop=0, quality=QUALITY, method=6,
        kmin=0, kmax=1,  # every picture for itself: differences leave traces of what was there before
    )  # fmt: skip
    the_film.still().save(folder / "tour.jpg", quality=STILL_QUALITY, optimize=True)
    print(f"{film}: {len(pictures)} pictures, {film.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
