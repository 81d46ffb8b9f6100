"""Whether the built-in encoder finds colours on real photos, and whether it tells materials there.

    python benchmarks/study_colors.py CAPTURE=SCENE=FIELD... --kept FOLDER

CAPTURE: one of TRUTH, real photos in which things were outlined or labelled; SCENE: its trained Gaussians; FIELD:
registered with `drsplat-mini`. Asked is "something COLOUR" of each colour that an outlined thing has, and of those that
nothing in the photos has. Truth is what was seen in the photos, by eye: a thing's colour, and others that it may be
said to have in part, of which it counts neither way. IoU is over Gaussians of outlined things. Columns: the plain
field, with objects, the best threshold of the plain field, and the Gaussians found of a colour that is not there. Then,
of each material of a thing, whether it is the material that fits most of its Gaussians best.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite import places
from benchmarks.suite.answers import best_iou, place_of
from drsplat import LanguageField, MiniEncoder, Scene, load_field
from drsplat.photos.models.mini.lexicon import COLORS, MATERIALS
from drsplat.query.defaults import MIN_GAUSSIANS

MINI = MiniEncoder()
# by capture and thing: its colour, or "" where it has several; colours that it has in part; its material or ""
TRUTH = {
    "plush": {
        "carrot": ("orange", "red green", "plush"), "quilt": ("grey", "white purple", "fabric"),
        "wardrobe": ("brown", "orange", "wood"), "doll": ("", "white blue pink purple grey black", "plush"),
    },
    "apc_shelf": {
        "laugh_out_loud_joke_book": ("red", "white", "paper"),
        "i_am_a_bunny_book": ("blue", "green red yellow brown black grey", "paper"),
        "kleenex_tissue_box": ("blue", "green black grey", "cardboard"),
        "creativity_chenille_stems": ("", "red green purple pink white grey orange blue brown", ""),
    },
    "desk_penguin": {
        "bag": ("red", "black white grey", "paper"), "case": ("white", "", "plastic"),
        "mouse": ("white", "", "plastic"),
        "mat": ("green", "black white", "fabric"), "notes": ("pink", "purple", "paper"),
        "kettle": ("grey", "black white brown", "metal"), "laptop": ("black", "grey white blue", "plastic"),
        "penguin": ("grey", "black white yellow orange", "plush"), "cup": ("", "green grey white brown yellow", ""),
        "lid": ("", "green grey white brown yellow", ""),
    },
    "brighton_beach": {
        "lawn": ("green", "yellow brown", ""), "island": ("green", "brown yellow", ""),
        "table": ("green", "grey blue", ""), "car_1": ("black", "grey", "metal"),
        **{f"car_{number}": ("", "grey white blue black", "metal") for number in range(2, 7)},
        "shelter": ("grey", "brown white black", ""),
    },
}  # fmt: skip
ABSENT = {"plush": "yellow", "desk_penguin": "purple", "brighton_beach": "red orange pink purple yellow"}


def selected(scene: Scene, text: str) -> np.ndarray:
    answer = scene.ask(text)
    return np.asarray(answer.values > answer.threshold)


def study(place: places.Place, field: LanguageField, capture: str) -> tuple[list[list[float]], list[float]]:
    """Print a row for each colour; return IoUs by colour (plain, objects, best), and 1 for each absent one found."""
    labels, mass, names = place.labels[field.gaussian_ids], place.mass[field.gaussian_ids], list(place.things)
    truth = TRUTH[capture]
    plain, whole = Scene(replace(field, objects=None), encoder=MINI), Scene(field, encoder=MINI)
    ious, found = [], []
    for color in COLORS:
        text = f"something {color}"
        right = [names.index(name) for name, (own, _, _) in truth.items() if own == color]
        partly = [names.index(name) for name, (_, others, _) in truth.items() if color in others.split()]
        answers = selected(plain, text), selected(whole, text)
        if right:
            counted = mass * ((labels < len(names)) & ~np.isin(labels, partly))
            meant = np.isin(labels, right)
            parts = [(counted[some & meant].sum(), counted[some | meant].sum()) for some in answers]
            both = [float(hit / either) if either else 0.0 for hit, either in parts]
            ious.append([*both, best_iou(plain.ask(text).values, meant, counted)])
            print(f"| {capture} | {color} | " + " | ".join(f"{iou:.2f}" for iou in ious[-1]) + " | |")
        elif color in ABSENT.get(capture, "").split():
            found.append(float(answers[1].sum() >= MIN_GAUSSIANS))
            print(f"| {capture} | {color}, absent | | | | {answers[0].sum():,}, {answers[1].sum():,} |")
    return ious, found


def materials(place: places.Place, field: LanguageField, capture: str) -> list[tuple[str, str, str]]:
    """Return name, true and best fitting material of each thing of one material."""
    scores = field.scores(MINI.encode_texts([f"something {material}" for material in MATERIALS])).argmax(axis=0)
    labels, mass = place.labels[field.gaussian_ids], place.mass[field.gaussian_ids]
    said = []
    for name, (_, _, material) in TRUTH[capture].items():
        rows = np.isin(labels, place.things[name])
        if material:
            best = np.bincount(scores[rows], mass[rows], len(MATERIALS)).argmax()
            said.append((name, material, MATERIALS[best]))
    return said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--kept", type=Path, required=True)
    arguments = parser.parse_args()
    ious: list[list[float]] = []
    found: list[float] = []
    told: list[tuple[str, str, str]] = []
    print("| capture | colour | plain | objects | best threshold | absent: found |\n" + "|---" * 6 + "|")
    for given in arguments.places:
        folder, scene, path = given.split("=")
        place = place_of(f"{folder}={scene}", "graph", arguments.kept)
        field = load_field(Path(path))
        some = study(place, field, Path(folder).name)
        ious += some[0]
        found += some[1]
        told += materials(place, field, Path(folder).name)
    print(
        f"| mean | {len(ious)} colours | " + " | ".join(f"{iou:.2f}" for iou in np.mean(ious, axis=0)) + " | ", end=""
    )
    print(f"{np.sum(found):.0f} of {len(found)} |\n")
    print(f"materials: {sum(true == best for _, true, best in told)} of {len(told)} right:")
    print("; ".join(f"{name}: {true}, said {best}" for name, true, best in told))


if __name__ == "__main__":
    main()
