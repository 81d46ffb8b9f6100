"""Encoder of words and crops to unit vectors in one space."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....base.arrays import ArraysByName, Embedding, Embeddings, Float32, OtherPixels
from ....errors import InputError, did_you_mean
from ....formats.tensors import map_tensors
from ....kernels.algebra import convolve, dense_rows
from ....scene.encoders import EncoderIdentity
from ..word_list import nearest_in_meaning
from .lexicon import (
    COLORS,
    NAMES,
    PAINTS,
    STRUCTURES,
    SYNONYMS,
    WORDS,
    colors_in,
    from_other_language,
    only_colors,
    words_of,
)

DIM = 512
BATCH_CROPS = 64  # whose layers take some 20 MiB
_ROWS = {word: row for row, word in enumerate(WORDS)}
INPUT_SIDE_PIXELS = 64
STRIDES = (2, 2, 1, 2, 1, 2, 1)
"""Strides of the convolutions conv0, conv1 ..., each with one pixel of zeros around its input."""

Tensors = ArraysByName


class MiniEncoder:
    """Encoder that knows the objects, colours and materials of `lexicon`, and nothing else.

    A text is the sum of its words; one that asks for a colour alone has vectors that were fitted to photos.
    nouns: what queries are contrasted with. least_share: share of the cosine that the nouns reach in a scene which a
    query has to reach, too: "blue mug" fits a red one better than any other name does, but not well. least_fit: cosine
    of the best noun that half of a scene's features reach where it looks like the rooms of the training. threshold:
    fixed cosine that finds most in rooms of the training split; queries follow the scene instead. threads: of the
    network, 0 for all cores; no bit depends on them. weights: by name; "words" has a row for each of `WORDS`, of which
    a text is the sum. photo_colors: a row for each of `COLORS`, in their place where a text asks for a colour alone.
    """

    name = "drsplat-mini"
    threshold = 0.2
    nouns = (*NAMES, *STRUCTURES)
    least_share = 0.42
    least_fit = 0.33

    def __init__(self, *, threads: int = 0) -> None:
        file = Path(__file__).with_name("mini.safetensors")
        self.threads = threads
        self.weights = {name: array.astype(np.float32) for name, array in map_tensors(file)[0].items()}
        # A file of its own, not part of the identity: it changes queries and not the embeddings of masks, so older
        # fields stay valid.
        self.photo_colors: np.ndarray = map_tensors(file.with_name("photo_colors.safetensors"))[0]["photo_colors"]
        weights = hashlib.blake2b(file.read_bytes(), digest_size=8).hexdigest()
        self.identity = EncoderIdentity(self.name, DIM, weights, f"square {INPUT_SIDE_PIXELS} px")

    def on_one_thread(self) -> "MiniEncoder":
        """Return the same encoder on one thread, for several threads to call at once."""
        return MiniEncoder(threads=1)

    def encode_texts(self, texts: Sequence[str]) -> Embeddings:
        """Return unit vectors of texts. Raises: InputError: an unknown word, or no word."""
        return np.stack([self._text(text) for text in texts])

    def encode_images(self, images: Sequence[OtherPixels]) -> Embeddings:
        """Return unit vectors of square crops on black; other images get black borders."""
        rows = [
            embed_images(_pixels(images[at : at + BATCH_CROPS]), self.weights, threads=self.threads)
            for at in range(0, len(images), BATCH_CROPS)
        ]
        return np.concatenate(rows) if rows else np.empty((0, DIM), np.float32)

    def rivals(self, text: str) -> Embeddings | None:
        """Return the vectors that replace the nouns for a text: all colours, for a colour alone; else None.

        A colour is judged against other colours, on photos too, where no noun fits and any of them may fit better.
        """
        return self.photo_colors if only_colors(text) else None

    @property
    def taught_colors(self) -> Float32[np.ndarray, "11 d"]:
        """Vectors of `COLORS` that were trained with the nouns, from made-up rooms only."""
        rows = self.weights["words"][[_ROWS[paint] for paint in PAINTS]]
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), np.float32)

    def _text(self, text: str) -> Embedding:
        words = words_of(text)
        strange = [word for word in words if word not in _ROWS]
        if strange or not words:
            raise InputError(_unknown(text, strange))
        if only_colors(text):  # "a red thing" is something red
            total = self.photo_colors[[COLORS.index(color) for color in colors_in(text)]].sum(0)
        else:
            total = self.weights["words"][[_ROWS[word] for word in words]].sum(0)
        return np.asarray(total / np.linalg.norm(total), np.float32)


def _unknown(text: str, strange: Sequence[str]) -> str:
    if not strange:
        return f"{text!r} has no word to look for: name an object, e.g. 'red mug'"
    language, english = from_other_language(words_of(text))
    if english:
        return f"{text!r} is {language}, and the built-in encoder reads English: ask for {english!r}"
    meant = ""
    for word in strange:
        near = ", ".join(nearest_in_meaning(word, WORDS))
        meant += f" The nearest to {word!r} that it knows: {near}." if near else did_you_mean(word, WORDS, 2)
    return (
        f"the built-in encoder was not taught {', '.join(map(repr, strange))}.{meant} It knows "
        f"{len(WORDS) + len(SYNONYMS)} English words: {', '.join(NAMES)}; {', '.join(COLORS)}; and kinds, materials "
        "and other names of these. For all others embed the photos with CLIP (`drsplat embed CAPTURE`), then register"
    )


def _pixels(images: Sequence[OtherPixels]) -> Float32[np.ndarray, "n s s 3"]:
    from PIL import Image

    size, scaled = (INPUT_SIDE_PIXELS, INPUT_SIDE_PIXELS), []
    for image in images:
        h, w = image.shape[:2]
        square = picture = Image.fromarray(image)
        if h != w:
            square = Image.new("RGB", (max(h, w), max(h, w)))
            square.paste(picture, ((square.width - w) // 2, (square.height - h) // 2))
        scaled.append(np.asarray(square.resize(size, Image.Resampling.BILINEAR)))
    return np.stack(scaled).astype(np.float32) / 127.5 - 1


def embed_images(pixels: Float32[np.ndarray, "n h w 3"], weights: Tensors, *, threads: int = 0) -> Embeddings:
    """Return unit vectors, the same bits at any `threads`. pixels: from -1 to 1, squares of INPUT_SIDE_PIXELS.

    weights: conv<i>.weight (9 * inputs, outputs), rows in the order of row, column, channel; conv<i>.bias;
    projection (2 * channels, D), of the mean and the largest of each channel.
    """
    x = pixels
    for layer, stride in enumerate(STRIDES):
        x = convolve(x, weights[f"conv{layer}.weight"], weights[f"conv{layer}.bias"], stride, threads=threads)
    pooled = np.concatenate([x.mean((1, 2)), x.max((1, 2))], axis=1)
    out = dense_rows(pooled, weights["projection"], threads=threads)
    return out / np.linalg.norm(out, axis=1, keepdims=True)
