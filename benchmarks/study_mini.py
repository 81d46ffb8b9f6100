"""Which rule cuts the answers of the built-in encoder `mini`.

    python benchmarks/study_mini.py world/scenes/table_2 world/scenes/table_4 ... --kept FOLDER
    python benchmarks/study_mini.py --field photos.field --ask "something red" "something blue"
    python benchmarks/study_mini.py --photos photos/ world/scenes/room_5
    python benchmarks/study_mini.py --outline PHOTO 176,105 190,85 215,80 ... --ask "orange carrot" "red bottle"

Masks of the segmenter `graph` in packed rooms of world/scenes. Asked are each name and each "colour name" of
what is in a room, the names that are not there, and 30 names that are there in colours that they do not
have. IoU is over Gaussians, by the weight that the photos give them; "nothing": how often rightly nothing is
found, fewer than 40 Gaussians. The numbers of the rule were chosen on table_1, table_3, room_5 and room_7.
--kept: where fields and truth of rooms are kept (minutes a room), and found the next time.
--field, --ask: a field of any scene, and what of several texts is found in it, without a truth.
--photos: posed or other photos, and the same number for the nouns by their pixels, before there is a field.
--outline, --ask: a thing cut out of a photo by hand, corner by corner, and how well texts and all names fit it.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from PIL import Image, ImageDraw
from study_thresholds import true_things

from benchmarks.suite.masks import features_of
from benchmarks.suite.scenes import read_scene
from drsplat import LanguageField, MiniEncoder, Mixture, Scene, load_field, register
from drsplat.fronts.scanning.choosing import PHOTOS_JUDGED
from drsplat.fronts.scanning.inputs import scan_input
from drsplat.photos.embedding.fitting import pixel_fit
from drsplat.photos.models.mini.lexicon import COLORS, NAMES
from drsplat.photos.models.word_list import list_vectors
from drsplat.query.contrast import contrast, relevancy_threshold
from drsplat.query.naming import fit_of
from drsplat.query.thresholds import PEAK_ROWS, peak_score, threshold_above
from drsplat.scene.masks.crops import crop

FIXED = (0.125, 0.15, 0.175, 0.2, 0.25, 0.3)
SHARES = (0.3, 0.36, 0.42, 0.48)
VISIBLE = 60  # Gaussians of a thing that is asked for
IN_OTHER_COLORS = 30
MINI = MiniEncoder()


def kept_room(folder: Path, kept: Path) -> tuple[LanguageField, np.ndarray, np.ndarray]:
    """A field; per Gaussian of the scene the number of its thing, and the weight that photos give it."""
    path = kept / folder.name
    if not (path.with_suffix(".npz")).is_file():
        kept.mkdir(parents=True, exist_ok=True)
        scene = read_scene(folder)
        made = register(scene.gaussians, scene.views, features_of(scene, "graph", MINI))
        made = replace(made, encoder=MINI.identity)
        made.to_field(Mixture()).save(path.with_suffix(".field"), overwrite=True)
        labels, mass = true_things(scene)
        np.savez(path.with_suffix(".npz"), labels=labels, mass=mass)
    with np.load(path.with_suffix(".npz")) as known_labels:
        labels, mass = known_labels["labels"], known_labels["mass"]
    field = load_field(path.with_suffix(".field"))
    return field, labels[field.gaussian_ids], mass[field.gaussian_ids]


def questions(folder: Path, labels: np.ndarray) -> dict[tuple[str, str], list[int]]:
    """By kind and text, the things that are meant."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    meant: dict[tuple[str, str], list[int]] = defaultdict(list)
    for thing in (*truth["objects"], *truth["structures"]):
        name, color, number = thing["name"], thing.get("color", ""), thing["id"]
        if (labels == number).sum() < VISIBLE:
            continue
        meant["names" if color else "structures", name].append(number)
        if color and color != name:
            meant["colour and name", f"{color} {name}"].append(number)
    there = {thing["name"] for thing in truth["objects"]}
    right = {f"{thing['color']} {thing['name']}" for thing in truth["objects"]}
    meant |= {("absent", name): [] for name in NAMES if name not in there}
    texts = [f"{color} {name}" for name in sorted(there) for color in COLORS if color != name]
    wrong = np.random.default_rng(0).permutation([text for text in texts if text not in right])
    return meant | {("other colour", str(text)): [] for text in wrong[:IN_OTHER_COLORS]}


def selections(field: LanguageField, text: str) -> Iterator[tuple[str, np.ndarray]]:
    """By rule, which rows it selects."""
    vector = MINI.encode_texts([text])[0]
    cosines, known = field.scores(vector), contrast(field, list_vectors(MINI))
    for least in FIXED:
        yield f"cosine above {least}", cosines > least
    yield "cosine above 0.2 and 0.6 of the peak (before)", cosines > threshold_above(cosines, 0.2)
    values = known.relevancy(vector, cosines)
    assert values is not None
    listed = values > relevancy_threshold(values)
    yield "list", listed
    for share in SHARES:
        yield f"list, {share} of its height", listed & (peak_score(cosines) > share * known.height)
    answer = Scene(field, encoder=MINI).ask(text)
    yield "the rule", answer.values > answer.threshold


def study(folders: list[Path], kept: Path) -> None:
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for folder in folders:
        field, labels, mass = kept_room(folder, kept)
        for (kind, text), ids in questions(folder, labels).items():
            truth = np.isin(labels, ids)
            for rule, selected in selections(field, text):
                enough = selected.sum() >= PEAK_ROWS
                both, either = mass[selected & truth].sum(), mass[selected | truth].sum()
                iou = float(both / either) if enough else 0.0
                found[rule][kind].append(iou if ids else float(not enough))
    kinds = ["names", "colour and name", "structures", "absent", "other colour"]
    asked = next(iter(found.values()))
    print("| rule |", " | ".join(f"{kind} ({len(asked[kind])})" for kind in kinds), "|")
    print("|---" * (1 + len(kinds)) + "|")
    for rule, results in found.items():
        print(f"| {rule} |", " | ".join(f"{np.mean(results[kind]):.3f}" for kind in kinds), "|")


def ask(field: LanguageField, texts: list[str]) -> None:
    print("| text | selected | cosine above 0.2 (before) | 40th highest cosine, of the list's |")
    print("|---|---|---|---|")
    height = contrast(field, list_vectors(MINI)).height
    for text in texts:
        answer = Scene(field, encoder=MINI).ask(text)
        before = (answer.scores > threshold_above(answer.scores, 0.2)).sum()
        share = peak_score(answer.scores) / height
        print(f"| {text} | {len(answer.gaussian_ids):,} | {before:,} | {share:.2f} |")


def fit(photo: str, corners: list[str], texts: list[str]) -> None:
    """Cosines of texts, and of the names that fit best, with what the corners enclose."""
    picture = np.asarray(Image.open(photo).convert("RGB"))
    drawn = Image.new("1", picture.shape[1::-1])
    ImageDraw.Draw(drawn).polygon([tuple(map(float, corner.split(","))) for corner in corners], fill=1)
    mask = np.asarray(drawn)
    left, top, right, bottom = drawn.getbbox()
    cut = crop(picture, mask[top:bottom, left:right], (left, top, right, bottom))
    seen = MINI.encode_images([cut])[0]
    asked, names = ([(float(MINI.encode_texts([t])[0] @ seen), t) for t in some] for some in (texts, MINI.nouns))
    print("; ".join(f"{text} {cosine:.2f}" for cosine, text in asked))
    print("of all names:", "; ".join(f"{text} {cosine:.2f}" for cosine, text in sorted(names, reverse=True)[:3]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", type=Path, nargs="*")
    parser.add_argument("--kept", type=Path, default=Path("kept"))
    parser.add_argument("--field", type=Path)
    parser.add_argument("--photos", type=Path, nargs="+", default=[])
    parser.add_argument("--ask", nargs="+", default=[])
    parser.add_argument("--outline", nargs="+", metavar=("PHOTO", "X,Y"))
    arguments = parser.parse_args()
    if arguments.rooms:
        study(arguments.rooms, arguments.kept)
    if arguments.field:
        field = load_field(arguments.field)
        print(f"cosine of the best noun that half of the features reach: {fit_of(MINI, field):.3f}")
        if arguments.ask:
            ask(field, arguments.ask)
    for photos in arguments.photos:
        print(f"{photos.name}: {pixel_fit(scan_input(photos).pictures(PHOTOS_JUDGED)):.3f} by pixels of its photos")
    if arguments.outline:
        fit(arguments.outline[0], arguments.outline[1:], arguments.ask)


if __name__ == "__main__":
    main()
