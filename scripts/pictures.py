"""Whether pictures of the documents are older than what they show.

usage: python -m scripts.pictures            names those that are, and the command that makes each
       python -m scripts.pictures NAME...    notes that these were made again, or looked at and found to be as they were

These pictures need a browser, another program, captures or hours. docs/images/made.json has a hash of what each was
made from, without comments and docstrings. Pictures of the demo are not among them: the tests draw those again.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.suite.stamps import PACKAGE, ROOT, stamp

IMAGES = ROOT / "docs" / "images"
STAMPS = IMAGES / "made.json"
MODELS = PACKAGE / "photos" / "models"


@dataclass(frozen=True)
class Made:
    """How a picture is made. inputs: files and folders that decide how it looks."""

    command: str
    inputs: tuple[Path, ...]

    @property
    def stamp(self) -> str:
        return stamp(self.inputs)


def _viewer() -> Made:
    written = PACKAGE / "fronts" / "viewing"
    inputs = ROOT / "web" / "src", written / "client.css", written / "client.html"
    return Made("python benchmarks/study_viewer.py DEMO FOLDER", (*inputs, ROOT / "benchmarks" / "study_viewer.py"))


def _words() -> Made:
    script = ROOT / "scripts" / "make_words_picture.py"
    return Made(
        f"python scripts/{script.name} DEMO/index.html docs/images/page_words.jpg", (*_viewer().inputs[:-1], script)
    )


def _photos() -> Made:
    script = ROOT / "scripts" / "make_page_pictures.py"
    return Made("python scripts/make_page_pictures.py DEMO FILM FOLDER", (script,))


MADE: dict[str, Made] = {
    "walk.jpg": _photos(),
    "trained.jpg": _photos(),
    "moving.jpg": _photos(),
    "fill.jpg": Made(
        "study_fill.py room_6 --objects 3 at 50554f8f", (PACKAGE / "authoring" / "editing" / "planes.py",)
    ),
    "viewer_city.jpg": Made("study_city.py STREET FOLDER at 4a01ca08", _viewer().inputs[:-1]),
    "viewer.jpg": _viewer(),
    "viewer_objects.jpg": _viewer(),
    "viewer_page.jpg": _viewer(),
    "page_words.jpg": _words(),
    "real_capture.jpg": Made(
        "python scripts/make_capture_picture.py FIELD SCENE CAPTURE docs/images/real_capture.jpg",
        (MODELS / "graph" / "network.safetensors", MODELS / "mini" / "mini.safetensors"),
    ),
    "export_viewers.jpg": Made(
        "python scripts/make_export_pictures.py",
        (ROOT / "scripts" / "make_export_pictures.py", *sorted((ROOT / "tests" / "foreign").glob("*.html"))),
    ),
    "export_earth.jpg": Made(
        "python scripts/make_export_pictures.py",
        (ROOT / "scripts" / "make_export_pictures.py", ROOT / "tests" / "foreign" / "cesium.html"),
    ),
    "blender.jpg": Made("integrations/blender/picture.py in Blender", (ROOT / "integrations" / "blender",)),
    "supersplat.jpg": Made("docs/integrations.md, in SuperSplat's window", (ROOT / "integrations" / "supersplat",)),
    "graph_masks.jpg": Made(
        "python -m world.segmenter.measuring TEST_SCENE... --plain --picture docs/images/graph_masks.jpg at 5f81d639",
        (MODELS / "graph" / "network.safetensors", MODELS / "graph" / "rule.safetensors"),
    ),
    "eyes.jpg": Made(
        "python scripts/make_eyes_picture.py plush/20240212_003932.jpg docs/images/eyes.jpg",
        (MODELS / "graph" / "network.safetensors", MODELS / "outlines" / "network.safetensors"),
    ),
    "objects_beach.jpg": Made(
        "drsplat objects FIELD --scene SCENE --views CAPTURE --picture SHEET.jpg, 1300 pixels wide",
        (MODELS / "graph" / "network.safetensors", MODELS / "graph" / "rule.safetensors"),
    ),
    "mini_confusion.png": Made(
        "python -m world.mini.measuring --test test.npz --picture docs/images/mini_confusion.png at 5f81d639",
        (MODELS / "mini" / "mini.safetensors",),
    ),
    "worst_answers.jpg": Made("study_worst.py at 4a01ca08, three of its pictures", (ROOT / "docs" / "answers.json",)),
    "worst_ten.jpg": Made(
        "study_worst.py --records FILE at 4a01ca08, eight of its pictures", (ROOT / "docs" / "answers.json",)
    ),
    "worst_names.jpg": Made(
        "study_eyes.py PLACE=FIELD... --kept FOLDER --worst docs/images/worst_names.jpg at 5f81d639",
        (MODELS / "graph" / "network.safetensors", MODELS / "graph" / "rule.safetensors"),
    ),
    "refusal.svg": Made(
        "study_rules.py --curve docs/images/refusal.svg at 5f81d639", (ROOT / "docs" / "answers.json",)
    ),
}


def older() -> dict[str, str]:
    """For each picture that is older than what it was made from, the command that makes it."""
    stamps = json.loads(STAMPS.read_text(encoding="utf-8"))
    return {name: made.command for name, made in MADE.items() if stamps.get(name) != made.stamp}


def note(names: list[str]) -> None:
    """Note that pictures are as new as what they show. Raises: KeyError: no such picture is made here."""
    stamps = json.loads(STAMPS.read_text(encoding="utf-8")) if STAMPS.exists() else {}
    stamps |= {name: MADE[name].stamp for name in names}
    text = json.dumps({name: stamps[name] for name in sorted(MADE) if name in stamps}, indent=1)
    STAMPS.write_text(text + "\n", encoding="utf-8")


def main(names: list[str]) -> int:
    unknown = sorted(set(names) - set(MADE))
    if unknown:
        print(f"expected names of pictures ({', '.join(MADE)}), got {', '.join(unknown)}", file=sys.stderr)
        return 2
    if names:
        note(names)
        return 0
    for name, command in older().items():
        print(f"{name} is older than what it shows: {command}")
    return 1 if older() else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
