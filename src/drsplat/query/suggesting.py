"""Words that find something in a scene: to begin with, and in place of a query that has no match."""

from collections.abc import Sequence

import numpy as np

from ..base.arrays import Embedding
from ..errors import DrSplatError
from ..photos.models.mini.lexicon import NAMES, STRUCTURES, nouns_in
from .answer import Answer
from .naming import own_vocabulary
from .scene import Scene

SAMPLED_GAUSSIANS = 4096
LARGE_SHARE = 0.05  # of the sample: walls and tables, which nobody asks for first
MAX_WORDS_TRIED = 24
MAX_WORDS_INSTEAD = 3
BEST_PLACE = "The best place has a {measure} of {best}{below}."
BELOW_THRESHOLD = ", below the threshold of {threshold}"


def words_of(scene: Scene) -> tuple[str, ...]:
    """Return the encoder's own words, or those of a household for one that takes any."""
    return own_vocabulary(scene.encoder, scene.field) or (*NAMES, *STRUCTURES)


def suggestions(
    scene: Scene, words: Sequence[str] | None = None, most: int = 4, near: Embedding | None = None
) -> list[str]:
    """Return up to `most` words that find something, in the order of `offers`; nothing where no encoder is known.

    words: to choose from; None takes the encoder's own. near: the vector of a query whose nearest words come first.
    """
    try:
        likely = offers(scene, words)
        if near is not None:
            vectors = np.asarray(scene.encoder.encode_texts(likely), np.float32).reshape(len(likely), -1)
            likely = [likely[at] for at in np.argsort(-vectors @ near, kind="stable")] if likely else []
        found = (word for word in likely[:MAX_WORDS_TRIED] if any(match.sure for match in scene.locate(word, top=1)))
        return [word for word, _ in zip(found, range(most), strict=False)]
    except DrSplatError:
        return []


def words_instead(scene: Scene, answer: Answer, words: Sequence[str] | None = None) -> list[str]:
    """Return the words nearest to a query that has no match which do have one.

    words: to choose from; None takes those of the field's list, else the encoder's own.
    """
    if answer.vector is None:
        return []
    return suggestions(scene, words or _listed(scene), MAX_WORDS_INSTEAD, answer.vector)


def words_to_offer(scene: Scene) -> list[str]:
    """Return the words among which `words_instead` looks for the nearest ones; none where no encoder is known."""
    try:
        return offers(scene, _listed(scene))
    except DrSplatError:
        return []


def missed_text(answer: Answer, words: Sequence[str] = ()) -> str:
    """Say how near a query without a match came to one; "" where nothing was measured. words: that match here."""
    best, threshold = float(answer.values.max(initial=answer.lowest)), f"{answer.threshold:.2f}"
    below = BELOW_THRESHOLD.format(threshold=threshold) if round(best, 2) < round(answer.threshold, 2) else ""
    near = BEST_PLACE.format(measure=answer.measure, best=f"{best:.2f}", below=below) if best > answer.lowest else ""
    return f"{near} Words that match here: {', '.join(words)}.".strip() if words else near


def offers(scene: Scene, words: Sequence[str] | None) -> list[str]:
    """Return words for what is in a scene, those of most Gaussians first, large things last.

    They are the names of its objects where the encoder has names, else those that fit some of a sample best: beside
    what it stands on, that may be another word ("orange book", on an orange sofa).

    words: to choose from; None takes the encoder's own. Raises: DrSplatError: no encoder is known.
    """
    rows, names = len(scene.field), [] if words else _names_of_objects(scene)
    if names or not rows:
        return names
    words = words or words_of(scene)
    chosen = np.sort(np.random.default_rng(0).permutation(rows)[:SAMPLED_GAUSSIANS])
    vectors = np.asarray(scene.encoder.encode_texts(words), np.float32)
    best = (scene.field.feature(chosen) @ vectors.T).argmax(1)
    share = np.bincount(best, minlength=len(words)) / len(chosen)
    return [words[at] for at in np.lexsort((-share, share > LARGE_SHARE)) if share[at]]


def _listed(scene: Scene) -> Sequence[str] | None:
    kept = scene.field.contrast
    return None if kept is None else kept.texts


def _names_of_objects(scene: Scene) -> list[str]:
    """Return the words that the encoder is sure of for the objects that photos agree on; mere colours are last."""
    if scene.field.objects is None:
        return []
    things = zip(scene.objects, scene.object_names(), scene.agreed.tolist(), strict=True)
    sizes = [(len(one) / len(scene.field), name) for one, name, is_agreed in things if is_agreed and name]
    ordered = sorted(sizes, key=lambda one: (not nouns_in(one[1]), one[0] > LARGE_SHARE, -one[0]))
    return list(dict.fromkeys(name for _, name in ordered))
