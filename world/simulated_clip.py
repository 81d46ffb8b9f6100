"""Embeddings with the statistics of CLIP's, for studies where its weights are not at hand.

CLIP's images and texts lie in two narrow cones (Liang et al. 2022): what fits is at a cosine of some
0.28, what does not at some 0.18, and both levels depend on the text. Here a thing is the sum of
directions of its name, kinds, colour and material; an image adds what is the thing's own and what is
the view's, a text what is the wording's. Numbers of matching and other pairs: `python -m world.simulated_clip`.
"""

import hashlib
from collections.abc import Sequence

import numpy as np

from drsplat.encoders import EncoderIdentity
from drsplat.models.mini.lexicon import ANYTHING, COLORS, GROUPS, MATERIALS, STUFFS, TONES, words_of

DIM = 512
CONE, SHARED = 2.2, 0.33  # length of a cone's axis; cosine of the two axes
NAME, KIND, COLOR, MATERIAL = 1.0, 0.35, 0.5, 0.25
OWN, SEEN, WORDING = 1.1, 1.1, 2.0
CLARITY = 0.25  # standard deviation of the log of how strongly a text says what it means


def direction(key: str) -> np.ndarray:
    """Of unit length, the same on every machine."""
    seed = int.from_bytes(hashlib.blake2b(key.encode(), digest_size=16).digest(), "little")
    vector = np.random.Generator(np.random.Philox(key=seed)).standard_normal(DIM)
    return vector / np.linalg.norm(vector)


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def kinds_of(name: str) -> list[str]:
    return [kind for kind, names in GROUPS.items() if name in names]


def concept(name: str, color: str = "", material: str = "") -> np.ndarray:
    kinds = sum((direction(f"kind {kind}") for kind in kinds_of(name)), np.zeros(DIM))
    return (
        NAME * direction(f"name {name}")
        + KIND * kinds
        + (COLOR * direction(f"color {color}") if color else 0)
        + (MATERIAL * direction(f"material {material}") if material else 0)
    )


class SimulatedClip:
    identity = EncoderIdentity("simulated-clip", DIM)

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        return np.stack([self._text(text) for text in texts]).astype(np.float32)

    def encode_thing(self, key: str, view: str, name: str, color: str, material: str) -> np.ndarray:
        """What an image of a thing in a view would give; `key` names the thing."""
        own, seen = OWN * direction(f"own {key}"), SEEN * direction(f"seen {key} {view}")
        what = concept(name, color, material) + own + seen
        return unit(CONE * direction("images") + what).astype(np.float32)

    def _text(self, text: str) -> np.ndarray:
        axis = SHARED * direction("images") + np.sqrt(1 - SHARED**2) * direction("texts")
        draw = np.random.default_rng(list(f"clarity {text}".encode())).standard_normal()
        what = np.exp(CLARITY * draw) * _meaning(text)
        return unit(CONE * axis + what + WORDING * direction(f"wording {text}"))


def _meaning(text: str) -> np.ndarray:
    words = words_of(text)
    total, left = np.zeros(DIM), []
    for word in words:
        if TONES.get(word, word) in COLORS and (len(words) > 1 or word != "orange"):
            total = total + COLOR * direction(f"color {TONES.get(word, word)}")
        elif STUFFS.get(word, word) in MATERIALS:
            total = total + MATERIAL * direction(f"material {STUFFS.get(word, word)}")
        elif word not in ANYTHING:
            left.append(word)
    return total + (concept(" ".join(left)) if left else 0)


def main() -> None:
    clip = SimulatedClip()
    names = ["mug", "bowl", "sofa", "book", "teddy bear", "pan", "vase", "chair"]
    images = np.stack([clip.encode_thing(n, "v", n, "red", "") for n in names])
    cosines = clip.encode_texts(names) @ images.T
    same = np.eye(len(names), dtype=bool)
    print("matching", cosines[same].round(2), "others", cosines[~same].mean().round(3), cosines[~same].std().round(3))
    negatives = clip.encode_texts(["object", "things", "stuff", "texture"]) @ images.T
    print("negatives", negatives.mean().round(3), negatives.max(0).round(2))


if __name__ == "__main__":
    main()
