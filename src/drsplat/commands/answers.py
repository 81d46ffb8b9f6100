"""From a field and a query on the command line to what it selects; for `query` and `render`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from ..encoders import Encoder
    from ..field import LanguageField, Negatives

RELEVANCY_THRESHOLD, COSINE_THRESHOLD = 0.5, 0.5
MIN_GAUSSIANS = 40


@dataclass(frozen=True, eq=False)
class Asked:
    """query: its unit vector. values: per row of the field what is compared with the threshold."""

    field: LanguageField
    query: np.ndarray
    values: np.ndarray
    measure: str
    threshold: float


@dataclass(frozen=True)
class Ask:
    """The query as given: a text, an image or a file with a vector; who embeds it; how to measure.

    Defaults are those of the options.
    """

    text: str | None = None
    vector: str | None = None
    image: str | None = None
    vocabulary: str | None = None
    encoder: str | None = None
    device: str = "auto"
    relevancy: bool = False
    negatives: str | None = None
    threshold: float | None = None


def asked(field: LanguageField, ask: Ask, threads: int = 0) -> Asked:
    """Scores of the field for a query.

    Words of a loaded encoder are measured by relevancy: CLIP's cosines of words with photos are seldom
    above 0.3, fit or not, and no threshold suits all of them.

    Raises: InputError: not one of text, image and vector; no encoder for it. MismatchError: another encoder.
    """
    from ..search import relevancy_from_scores

    query, encoder = _query(field, ask)
    scores = field.scores(query, threads=threads)
    own = getattr(encoder, "threshold", None)  # the built-in encoders' cosines mean something
    uncertain = ask.text is not None and ask.encoder is not None and own is None
    if not (ask.relevancy or ask.negatives or uncertain):
        default = COSINE_THRESHOLD if own is None else own
        return Asked(
            field, query, scores, "cosine", default if ask.threshold is None else ask.threshold
        )
    values = relevancy_from_scores(scores, _negatives(field, encoder, ask, threads).maxima)
    return Asked(
        field,
        query,
        values,
        "relevancy",
        RELEVANCY_THRESHOLD if ask.threshold is None else ask.threshold,
    )


def _query(field: LanguageField, ask: Ask) -> tuple[np.ndarray, Encoder | None]:
    """The query's vector, and the encoder where one made it."""
    from ..errors import InputError
    from ..search import embed_query

    if sum(given is not None for given in (ask.text, ask.image, ask.vector)) != 1:
        raise InputError("give one of these: a text, --image PICTURE or --vector FILE.npy")
    if ask.vector is not None:
        return read_vector(ask.vector), None
    encoder = _encoder(field, ask)
    if ask.text is not None:
        return embed_query(encoder, field, ask.text), encoder
    return _embedded_image(encoder, str(ask.image)), encoder


def _encoder(field: LanguageField, ask: Ask) -> Encoder:
    from .options import encoder_for

    return encoder_for(field, ask.vocabulary, ask.encoder, ask.device)


def _embedded_image(encoder: Encoder, path: str) -> np.ndarray:
    """A picture of a thing as the masks were: padded with black to a square.

    Raises: InputError: an encoder of words only.
    """
    import numpy as np

    from ..crops import crop
    from ..encoders import ImageEncoder
    from ..errors import InputError

    if not isinstance(encoder, ImageEncoder):
        raise InputError(
            f"{encoder.identity.name} sees no images: pass --encoder NAME, the model that embedded the masks"
        )
    picture = read_picture(path)
    height, width = picture.shape[:2]
    square = crop(picture, np.ones((height, width), bool), (0, 0, width, height))
    vector: np.ndarray = encoder.encode_images([square])[0]
    return vector


def read_picture(path: str) -> np.ndarray:
    """The RGB of a picture file, upright, on black where it is transparent.

    Raises: InputError: there is no such file. FormatError: damaged, or not a picture.
    """
    import numpy as np
    from PIL import Image, ImageOps

    from ..errors import FormatError, InputError
    from ..photos import PHOTO_FORMATS

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such picture")
    try:
        with Image.open(path, formats=PHOTO_FORMATS) as file:
            picture = ImageOps.exif_transpose(file).convert("RGBA")
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(
            f"{path}: cannot be read as a picture ({'/'.join(PHOTO_FORMATS)}): {error}"
        ) from error
    black = Image.new("RGBA", picture.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, picture).convert("RGB"))


def _negatives(field: LanguageField, encoder: Encoder | None, ask: Ask, threads: int) -> Negatives:
    from ..errors import InputError
    from ..search import NEGATIVES, text_negatives

    if ask.negatives is not None and ask.negatives.endswith(".npy"):
        return field.score_negatives(read_vectors(ask.negatives), threads=threads)
    if ask.negatives is not None:
        words = [word.strip() for word in ask.negatives.split(",")]
        return text_negatives(field, encoder or _encoder(field, ask), words, threads=threads)
    if field.negatives is not None:
        return field.negatives
    if encoder is None:
        raise InputError(
            "relevancy compares the query with negatives and this field has none stored: pass --negatives FILE.npy"
        )
    return text_negatives(field, encoder, NEGATIVES, threads=threads)


def read_vector(path: str) -> np.ndarray:
    """One vector of a .npy file, (D,) or (1, D).

    Raises: InputError: there is no such file, or it holds more than one. FormatError: damaged.
    """
    from ..errors import InputError

    vectors = read_vectors(path)
    if len(vectors) != 1:
        raise InputError(f"{path}: expected one vector, got {len(vectors)}")
    vector: np.ndarray = vectors[0]
    return vector


def read_vectors(path: str) -> np.ndarray:
    """The vectors of a .npy file, (n, D) or (D,), as float32.

    Raises: InputError: there is no such file. FormatError: damaged, not numbers.
    """
    import numpy as np

    from ..errors import FormatError, InputError
    from ..formats.npy import map_npy

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file")
    array = np.atleast_2d(map_npy(Path(path)))
    if array.ndim != 2 or array.dtype.kind != "f" or array.size == 0:
        raise FormatError(
            f"{path}: expected floats (D,) or (n, D), got {array.dtype} {array.shape}"
        )
    return np.ascontiguousarray(array, np.float32)
