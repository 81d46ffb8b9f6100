"""Views with features become part of a field on disk, with the words that their folder of features has."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ...field import LanguageField
from ...field.codes import Track, untracked
from ...field.growing import Change, add_views, change_field
from ...field.growing.folder import parts_beside, remove_parts
from ...formats.vocabulary import read_vocabulary
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving, canonical_of
from ...scene.views import View
from .embed import WORD_LIST
from .voting import vote_for_objects, votes_beside


def grow_field(
    path: Path,
    scene: Gaussians | Moving,
    views: Sequence[View],
    features: Mapping[str, ViewFeatures],
    folder: Path,
    *,
    renew: bool = False,
    back: Collection[str] = (),
    threads: int = 0,
    track: Track = untracked,
) -> Change:
    """Add views to the field at `path`; a run that is killed goes on with the views that it had finished.

    folder: with the words that queries are contrasted with, as `embed` leaves them. renew, back: as for `add_views`.

    Raises: as `change_field` and `add_views`.
    """
    parts = parts_beside(path)

    def change(field: LanguageField) -> Change:
        done = add_views(
            field, scene, views, features, renew=renew, back=back, parts=parts, threads=threads, track=track
        )
        return done if done.is_empty else replace(done, field=with_words(done.field, folder))

    vote = partial(
        vote_for_objects, gaussians=canonical_of(scene), views=views, kept=votes_beside(path), threads=threads,
        track=track,
    )  # fmt: skip
    done = change_field(path, scene, change, vote=vote, threads=threads)
    remove_parts(parts, [*done.added, *done.replaced, *done.unchanged])
    return done


def with_words(field: LanguageField, features: str | Path) -> LanguageField:
    """Add the words that queries are contrasted with, where `embed` left them in a folder of features."""
    path = Path(features) / WORD_LIST
    words = read_vocabulary(path) if path.is_file() else None
    if words is None or not field.encoder.matches(words.identity):
        return field
    return field.with_contrast(words.embeddings, words.texts)
