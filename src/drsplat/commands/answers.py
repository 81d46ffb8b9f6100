"""From a field and a query on the command line to scores and a threshold; for all verbs that search."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from .query_inputs import Click, read_picture, read_vector, read_vectors

if TYPE_CHECKING:
    from ..asking import Asked, Asking, Question
    from ..field import LanguageField


@dataclass(frozen=True)
class Ask:
    """The query as given: a text, an image, a file with a vector or a click; who embeds it; how to measure.

    unwanted: what the text does not mean. threshold: a number, AUTO or None, the default; top_share
    takes its place. Defaults are those of the options.
    """

    text: str | None = None
    vector: str | None = None
    image: str | None = None
    click: Click | None = None
    unwanted: tuple[str, ...] = ()
    vocabulary: str | None = None
    encoder: str | None = None
    device: str = "auto"
    relevancy: bool = False
    negatives: str | None = None
    threshold: float | str | None = None
    top_share: float | None = None


def asked(field: LanguageField, ask: Ask, threads: int = 0) -> Asked:
    """Scores of the field for a query, and the threshold.

    Raises: InputError: not one of text, image, vector and click; no encoder for it; options that
    exclude each other. MismatchError: another encoder.
    """
    return AskedOf(field, ask, threads).answer()


@dataclass(frozen=True, eq=False)
class AskedOf:
    """The options of the command line, as `drsplat.asking` takes them."""

    field: LanguageField
    ask: Ask
    threads: int = 0

    def __post_init__(self) -> None:
        from ..defaults import AUTO
        from ..errors import InputError

        if self.ask.threshold == AUTO and (self.ask.relevancy or self.ask.negatives):
            raise InputError(
                "--threshold auto cuts cosines: drop --relevancy and --negatives, or give a number"
            )

    def answer(self) -> Asked:
        """To the one thing asked."""
        from ..errors import InputError
        from ..search import feature_at

        ask = self.ask
        if sum(given is not None for given in (ask.text, ask.image, ask.vector, ask.click)) != 1:
            raise InputError(
                "give one of these: a text, --image PICTURE, --vector FILE.npy or --click VIEW:X,Y"
            )
        if ask.text is not None:
            return self._asking(text=ask.text).about(ask.text)
        if ask.unwanted:
            raise InputError("--not goes with a query in words")
        if ask.image is not None:
            picture = read_picture(ask.image)
            return self._asking(image=picture).like_image(picture)
        if ask.vector is not None:
            vector = read_vector(ask.vector)
            return self._asking(vector=vector).like(vector)
        click = ask.click
        assert click is not None
        feature = feature_at(self.field, click.gaussians, click.view, click.xy)
        return self._asking(vector=feature).like(feature)

    def about_each(self, texts: Sequence[str]) -> Iterator[Asked]:
        """To each of several texts."""
        return self._asking(text=texts[0]).about_each(texts)

    def _asking(self, **what: Any) -> Asking:
        from ..asking import Asking

        return Asking(self._background, self._question(what))

    def _question(self, what: dict[str, Any]) -> Question:
        from ..asking import Question

        ask = self.ask
        return Question(
            **what,
            unwanted=ask.unwanted,
            threshold=ask.threshold,
            top_share=ask.top_share,
            relevancy=ask.relevancy,
            negatives=self._negatives(),
        )

    def _negatives(self) -> Any:
        from ..errors import InputError

        given = self.ask.negatives
        if given is not None and given.endswith(".npy"):
            return read_vectors(given)
        needed = self.ask.relevancy and given is None and self.field.negatives is None
        if needed and (self.ask.vector or self.ask.click):
            raise InputError(
                "relevancy compares the query with negatives and this field has none stored: pass --negatives FILE.npy"
            )
        return None if given is None else tuple(word.strip() for word in given.split(","))

    @cached_property
    def _background(self) -> Any:
        from ..asking import Background, encoder_for

        ask, field = self.ask, self.field
        return Background(
            field,
            lambda: encoder_for(field, ask.vocabulary, ask.encoder, ask.device),
            self.threads,
        )
