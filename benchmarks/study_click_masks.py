"""What a click cuts out of real captures with better masks: `graph`'s, and simulated ones of whole things.

    python benchmarks/study_click_masks.py CAPTURE=SCENE... --clip FOLDER --kept FOLDER

CAPTURE: a folder whose things are outlined (`tests/support/*_outlines.json`), with the scene that was trained on it.
"sam": masks of whole things, their borders up to three pixels off (`suite/places.py`). What masks show is drawn as in
`suite/trials.py`. Columns are those of `study_clicks.py`. "limit": the Gaussians that have most of their weight in
masks of the thing, drawn alone: what the masks would be enough for.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import places_of
from benchmarks.suite.outlines import Clicks, outlines_path, read_outlines
from benchmarks.suite.places import Place
from benchmarks.suite.trials import trial
from benchmarks.suite.vocabularies import Clip
from drsplat import Scene


def clicks_of(place: Place, folder: Path, clip: Clip) -> Clicks:
    """Return clicks into a scene whose objects are of the masks of a place."""
    field = trial(place, clip, "rough", 0.0, 0).field
    outlines = read_outlines(outlines_path(folder.resolve().name))
    return Clicks(Scene(field, place.gaussians, views=place.views), outlines)


def row(place: Place, clicks: Clicks, thing: str) -> str:
    answers, best = zip(*(clicks.answered(thing, photo) for photo in clicks.masks[thing]), strict=True)
    ious = np.array([answer.ious for answer in answers])
    return (
        f"| {place.name}: {thing} | {ious.mean():.2f} | {ious.min():.2f} to {ious.max():.2f} "
        f"| {np.mean([found.mean for found in best]):.2f} | {limit(clicks, place, thing):.2f} |"
    )


def limit(clicks: Clicks, place: Place, thing: str) -> float:
    """Return the mean IoU, over the outlined photos, of the Gaussians that are most in masks of a thing."""
    owned, count = np.flatnonzero(place.owners >= 0), int(place.owners.max()) + 1
    of_thing = csr_array((np.ones(len(owned)), (owned, place.owners[owned])), shape=(len(place.owners), count))
    votes = csr_array(place.evidence.weights @ of_thing).toarray()
    ids = np.flatnonzero(votes.any(1) & np.isin(votes.argmax(1), place.things[thing]))
    return float(np.mean(clicks.fit(thing, "", "limit", ids).ious))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True)
    arguments = parser.parse_args()
    clip = Clip(arguments.clip)
    print("| place, masks, thing | click | in single photos | best level | limit |\n" + "|---" * 5 + "|")
    for given in arguments.captures:
        for place in places_of(given, arguments.kept):
            clicks = clicks_of(place, Path(given.partition("=")[0]), clip)
            for thing in clicks.masks:
                print(row(place, clicks, thing), flush=True)


if __name__ == "__main__":
    main()
