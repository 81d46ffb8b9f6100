"""Codes of what is shown and vectors of words, with which a page answers words that nobody asked before.

The rules of an answer are those of `query`; web/src/search follows them and has their numbers from here.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from ...authoring.filming import looking
from ...base.arrays import Array, Embedding, Float32
from ...base.contents import Document
from ...base.working import Here
from ...errors import DrSplatError
from ...field import LanguageField
from ...kernels import boxes, pq_encode
from ...kernels.kmeans import train_centroids
from ...photos.models.mini import MiniEncoder, lexicon
from ...photos.models.word_list import known_words, listed_words, names_under
from ...query import (
    Scene,
    contrast,
    defaults,
    linking,
    measuring,
    search,
    sentences,
    suggesting,
    tasks,
    thresholds,
    wholes,
)
from ...query.encoding import list_doubt
from ...query.naming import ONLY_COLORS_DOUBT, knows_nouns
from ...query.suggesting import words_of, words_to_offer
from ...scene.boxes import HAZE_OPACITY
from . import naming
from .painting import ACCENTS
from .session import Session

STAGES, LEAST_STAGES = 12, 4
"""Bytes per Gaussian, and in small scenes."""
ROWS_PER_STAGE = 2048  # of fewer, a stage's table takes more room than their codes
MAX_DIMS = 160  # along which features differ most; the words of the built-in encoder span 142
CODED_SHARE = 0.9993  # of the features' squares, along the first of these
MAX_TRAINING_ROWS, BLOCK_ROWS, SEED = 4096, 8192, 0
MAX_TEXTS = 5000
_RULES: Mapping[ModuleType, str] = {
    contrast: (
        "WORDS_PER_RIVAL SPARE_WORDS LIST_RELEVANCY CLEAR_MARGIN CLEAR_MARGIN_PER_EFOLD LONG_LIST_CLEAR_MARGIN "
        "KIND_CLEAR_MARGIN KIND_MARGIN_PER_EFOLD CLEAR_MARGIN_ROWS MAYBE_SPREADS OWN_THRESHOLD_SHARE WAY_TO_PEAK_SHARE "
        "PEAK_SHARE MIN_PEAK_ROWS LARGE_SCENE_PEAK_SHARE SAME_MEANING_COSINE"
    ),
    thresholds: "PEAK_ROWS CUT_SHARE",
    defaults: "RELEVANCY_THRESHOLD MIN_GAUSSIANS",
    measuring: "HALF_FIT_SHARE MAYBE_LEAST_SHARE SWAP_TOLERANCE",
    wholes: "SPEAKING_SHARE OBJECT_TRUST",
    tasks: "MASS_POWER SURE_RANK_SHARE PART_SCORE_SHARE",
    linking: "NUM_NEIGHBOURS MIN_NEAR_SHARE LINK_FACTOR TOUCH_FACTOR MIN_TOUCHING_SHARE",
    boxes: "OUTLIER_SHARE MAX_STRAY_SHARE MIN_TAIL_SPARSENESS",
    looking: "DISTANCE_SIZES RISE MARGIN_SHARE MIN_SIZE_SHARE",
    suggesting: "MAX_WORDS_TRIED MAX_WORDS_INSTEAD",
}
_SENTENCES: Mapping[ModuleType, str] = {
    sentences: "RELATED STRANGE ASKING THERE ARTICLE NUMBER NOT POSED HERE",
    search: "BUT_NOT",
    lexicon: "COLORS TONES",
}
_MISSED = {suggesting: "BEST_PLACE BELOW_THRESHOLD"}
_LEXICON = {lexicon: "WORDS NAMES COLORS PAINTS ORANGE TONES STUFFS GROUPS SYNONYMS ANYTHING IGNORED MATERIALS"}


@dataclass(frozen=True, eq=False)
class PageSearch:
    """Content of a page that it searches in. rows: arrays with a number per shown Gaussian. tables: further arrays.

    document: the numbers of the rules, and the words that are known. about: says which these are, for people.
    """

    rows: Mapping[str, Array]
    tables: Mapping[str, Array]
    document: Document
    about: str


def search_of(session: Session, words: Sequence[str] = ()) -> PageSearch | None:
    """Return what a page of a session needs to answer words, None where no word is known or nothing has a feature.

    Args:
        session: the scene, and what of it is shown.
        words: to be answered besides those that the field or the encoder knows.

    Raises:
        InputError: words that the encoder does not know.
    """
    scene = session.scene
    if words:
        scene.encoder.encode_texts(words)  # or the error that says which it does not know
    rows = scene.field.rows_of(session.drawn.ids)
    known = _known(scene, (*words, *(session.words or ()))) if (rows >= 0).any() else None
    if known is None:
        return None
    own, vectors = np.maximum(rows, 0), known.tables["texts"]  # without a feature, any: these rows are marked
    basis, coded = _basis(scene.field, own, vectors)
    blocks = [own[begin : begin + BLOCK_ROWS] for begin in range(0, len(own), BLOCK_ROWS)]
    points = np.concatenate([scene.field.feature(block) @ basis[:coded].T for block in blocks])
    most = min(STAGES, max(LEAST_STAGES, len(points) // ROWS_PER_STAGE))
    codes, centroids, steps = zip(*_coded(points, most, scene.threads), strict=True)
    tables = {
        "centroids": np.stack(centroids), "steps": np.array(steps, np.float32), "usual": basis @ known.tables["usual"],
        "texts": (vectors @ basis.T).astype(np.float16),
    }  # fmt: skip
    document = {**known.document, **_numbers(session), "share": np.count_nonzero(rows >= 0) / len(scene.field)}
    arrays = {"solid": (session.drawn.opacities >= HAZE_OPACITY).astype(np.uint8)}  # a page rounds opacities
    arrays |= _places(scene.field, rows) | {f"code{number}": stage for number, stage in enumerate(codes)}
    return PageSearch(arrays, {**known.tables, **tables, **_cameras(scene)}, document, known.about)


def _numbers(session: Session) -> Document:
    """Return the numbers of the rules and of the scene; lengths are the browser's."""
    scene, frame = session.scene, session.shown.frame
    return {
        "rules": _named(_RULES), "sentences": _named(_SENTENCES), "accents": ACCENTS, "center": frame.center.tolist(),
        "up": None if scene.up is None else scene.up.tolist(),
        "radius": looking.radius_of(scene.gaussians) * frame.scale,
        "vocabulary": naming.known_words(scene, session.words), "weak_doubt": measuring.WEAK_DOUBT,
        "offers": words_to_offer(scene), "missed": _named(_MISSED),
    }  # fmt: skip


def _cameras(scene: Scene) -> dict[str, Array]:
    """Return the photos' cameras, from which matches are looked at."""
    stands = looking.Standpoints.of(scene.views)._asdict()
    return {f"camera_{name}": numbers.astype(np.float32) for name, numbers in stands.items()}


def _named(constants: Mapping[ModuleType, str]) -> Document:
    """Return constants by their names in small letters; of patterns their texts."""
    pairs = [(name, getattr(module, name)) for module, names in constants.items() for name in names.split()]
    return {name.lower(): getattr(value, "pattern", value) for name, value in pairs}


def _known(scene: Scene, words: Sequence[str]) -> PageSearch | None:
    """Return the texts that a page knows, of which its tables have the vectors, and the mean picture of the scene.

    They are those that the field keeps, and, where somebody embeds words, others.
    """
    field, background = scene.field, scene.background
    try:
        field.check_encoder(scene.encoder.identity)
        encoder = scene.encoder
    except DrSplatError:
        encoder = None
    kept = field.contrast
    if isinstance(encoder, MiniEncoder) and kept is None:
        return _sums_of_words(encoder, background)
    pairs = {} if kept is None else dict(zip(kept.texts, kept.embeddings, strict=True))
    if encoder is not None:
        pairs |= {} if kept else zip(*listed_words(encoder), strict=True)
        more = [text for text in dict.fromkeys((*words, *words_of(scene))) if text not in pairs]
        pairs |= zip(*known_words(encoder, more[:MAX_TEXTS]), strict=True)
    return _texts(background, pairs, None if kept or encoder is None else background.own_threshold) if pairs else None


def _texts(background: measuring.Background, pairs: Mapping[str, Embedding], least: float | None) -> PageSearch:
    """Return texts that are each asked as they are; those of the scene's list come first."""
    texts, vectors = list(pairs), np.array(list(pairs.values()), np.float32)
    document: Document = {"texts": texts, "lists": {}, "doubt": "", "threshold": least}
    tables = {"texts": vectors, "usual": np.zeros(vectors.shape[1], np.float32)}
    listed = background.contrast_for(None) if least is None else None
    if listed is not None:
        rivals = texts[: len(listed.vectors)]
        near = contrast.near_each(listed.vectors, vectors).T
        tables |= {"usual": listed.usual, "near": near.nonzero()[1].astype(np.uint16)}
        tables["near_ends"] = near.sum(axis=1).cumsum().astype(np.uint32)
        kinds = {text: names for text in texts if (names := names_under(text))}
        document["kinds"] = {text: [at for at, one in enumerate(rivals) if one in kinds[text]] for text in kinds}
        document["lists"] = {"all": {"texts": rivals, "spread": listed.spread, "least": None}}
    about = f"This page knows {len(texts):,} words and phrases, each as it is listed, and no others."
    if listed is not None and (doubt := list_doubt(document["lists"]["all"]["texts"], background.field)):
        about += f" {doubt[0].upper()}{doubt[1:]}."
    return PageSearch({}, tables, document, about)


def _sums_of_words(encoder: MiniEncoder, background: measuring.Background) -> PageSearch:
    """Return the words of the encoder whose texts are sums of them, those of colours on photos last."""
    lists, nouns, colors = {}, background.contrast, background.contrast_of_kind(encoder.photo_colors)
    assert nouns is not None
    for name, texts, listed in (("all", encoder.nouns, nouns), ("colors", lexicon.COLORS, colors)):
        lists[name] = {"texts": texts, "spread": listed.spread, "least": background.least_peak_of(listed)}
    doubt = "" if knows_nouns(encoder, background.field) else ONLY_COLORS_DOUBT
    about = (
        f"This page knows {len(lexicon.WORDS) + len(lexicon.SYNONYMS):,} English words, alone and together as in "
        "“red mug”: things of a household, colours and materials, and no others."
    )
    document = {"lists": lists, "threshold": None, "lexicon": _named(_LEXICON), "doubt": doubt}
    tables = {"texts": np.concatenate([encoder.weights["words"], encoder.photo_colors]), "usual": nouns.usual}
    return PageSearch({}, tables, document, about)


def _basis(field: LanguageField, rows: Array, vectors: Array) -> tuple[Float32[Array, "d D"], int]:
    """Return unit directions along which features differ, most first, and how many of them are worth a code.

    They are of the space that the words span, where these are few.
    """
    is_few = len(vectors) < vectors.shape[1]
    span = np.linalg.qr(vectors.T.astype(np.float64))[0].T if is_few else np.eye(vectors.shape[1])
    sample = field.feature(_spread(rows)) @ span.T
    squares, axes = np.linalg.eigh(sample.T @ sample)
    shares = squares[::-1].cumsum() / squares.sum()
    basis = axes[:, : -MAX_DIMS - 1 : -1].T @ span
    return np.ascontiguousarray(basis, np.float32), min(len(basis), int(shares.searchsorted(CODED_SHARE)) + 1)


def _spread(rows: Array) -> Array:
    """Return some of many rows, evenly spread over them."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_TRAINING_ROWS)).astype(np.intp)]


def _coded(points: Float32[Array, "r d"], stages: int, threads: int) -> Iterator[tuple[Array, Array, float]]:
    """Yield stages of residual quantisation: a code per row, 256 centroids in steps from 128 on, and the step.

    Source: Chen, Guan & Wang 2010 (residual vector quantisation).
    """
    left = points.copy()
    for _ in range(stages):
        centroids = train_centroids(np.ascontiguousarray(_spread(left)), 1, SEED, Here(threads))
        step = max(float(np.abs(centroids).max()) / 127, 1e-12)
        steps = np.round(centroids / step)
        coded = np.ascontiguousarray(steps * step, np.float32)
        codes = pq_encode(left, coded, threads=threads)[:, 0]
        left -= coded[0][codes]
        yield codes, (steps[0] + 128).astype(np.uint8), step


def _places(field: LanguageField, rows: Array) -> dict[str, Array]:
    """Return per shown Gaussian 0 without a feature, 1 if it is loose, n + 2 of thing n; and 0 or its piece."""
    things, pieces = np.ones(len(rows), np.uint32), np.zeros(len(rows), np.uint32)
    if field.objects is not None:
        things[:], pieces[:] = field.objects.thing_of(rows) + 2, field.objects.piece_of()[rows] + 1
    things[rows < 0] = 0
    return {"things": things, "pieces": pieces}
