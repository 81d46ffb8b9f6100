"""How answers change with the length of the list of texts that a vocabulary has.

    python benchmarks/study_short_lists.py drsplat-demo

Vocabularies of the demo's encoder: the query, and others drawn from all "colour name" that it knows. Answers are
compared with those of the built-in encoder: the mean IoU of the selected Gaussians, and how many matches there are for
one that is there.
"""

import argparse

import numpy as np

from drsplat import MiniEncoder, Scene, open_scene
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.photos.models.mini.lexicon import COLORS, NAMES

QUERIES = ("yellow apple", "green mug", "toy duck", "green car", "red vase", "blue candle", "couch", "houseplant")
LENGTHS, DRAWS = (8, 16, 32, 64, 100, 128, 256, 400), 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    scene = open_scene(parser.parse_args().folder)
    mini, texts = MiniEncoder(), [*NAMES, *(f"{color} {name}" for name in NAMES for color in COLORS)]
    known = {query: (set(scene.ask(query).gaussian_ids.tolist()), len(scene.locate(query))) for query in QUERIES}
    print("| texts | IoU with the built-in answer | matches, of 1 | nothing found |\n|--:|--:|--:|--:|")
    for length in LENGTHS:
        ious, matches = [], []
        for seed in range(DRAWS):
            drawn = np.random.default_rng(seed).permutation(texts)[: length - 1]
            for query, (meant, count) in known.items():
                listed = [query, *(str(text) for text in drawn if text != query)]
                words = VocabularyEncoder(mini.identity, listed, mini.encode_texts(listed))
                asked = Scene(scene.field, scene.gaussians, encoder=words)
                found = set(asked.ask(query).gaussian_ids.tolist())
                ious.append(len(found & meant) / max(len(found | meant), 1))
                matches.append(len(asked.locate(query)) / max(count, 1))
        print(f"| {length} | {np.mean(ious):.2f} | {np.mean(matches):.1f} | {np.mean(np.equal(matches, 0)):.0%} |")


if __name__ == "__main__":
    main()
