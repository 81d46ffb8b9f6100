"""The language field: what every Gaussian means, as codes that an embedding can search."""

import hashlib
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..base.arrays import (
    ArraysByName,
    Doubles,
    Embedding,
    Embeddings,
    Float32,
    Indices,
    Numbers,
    OtherEmbeddings,
    UnsignedIds,
    Vector3,
    WholeNumbers,
)
from ..base.terminal import counted, facts_html
from ..errors import InputError, MismatchError
from ..formats.field_folder import TensorFile, write_folder
from ..formats.tiles import Tiles
from ..scene.encoders import EncoderIdentity, identity_json, identity_text
from ..scene.parted import AnyGaussians
from ..scene.views import pictures_kind, scenes_rendered
from .codes import Best, Code, Codebook, Hits, PQCode
from .evidence.aggregation import MEAN_RECORD, AggregatorRecord
from .evidence.evidence import Evidence, Explanation
from .forest import Objects
from .growth import Growth

FORMAT, VERSION = "drsplat field", 3
CODES, EVIDENCE, NEGATIVES = "codes.safetensors", "evidence.safetensors", "negatives.safetensors"
CONTRAST, OBJECTS, GROWTH = "contrast.safetensors", "objects.safetensors", "growth.safetensors"
TEMPERATURE = 10.0
RUN_ROWS = 1 << 18  # a multiple of any code's groups
BATCH_NEGATIVES = 16  # scored at once, exactly


def relevancy_from_scores(scores: Numbers, negative_maxima: Numbers) -> Numbers:
    """Return sigmoid(10 (s - max_n s_n)): equal to LERF's minimum over negatives of a two-way softmax."""
    return 1 / (1 + np.exp(np.float32(-TEMPERATURE) * (scores - negative_maxima)))


@dataclass(frozen=True, eq=False)
class Negatives:
    """Negatives that a query is compared with. maxima: each row's best score among the unit `embeddings`.

    texts: the words they came from, () where there were none.
    """

    texts: tuple[str, ...]
    embeddings: OtherEmbeddings
    maxima: Numbers


@dataclass(frozen=True, eq=False)
class WordList:
    """Texts that queries are contrasted with, and their unit embeddings."""

    texts: tuple[str, ...]
    embeddings: Embeddings


_OTHER_FILE = (
    "give the file that was registered (of a scene that was edited, the one that the edits lie beside), or register "
    "this one; where it is the same scene compressed, carry the field over: "
    "drsplat field carry FIELD NEW_SCENE --scene OLD_SCENE --output NEW_FIELD"
)


@dataclass(frozen=True, eq=False)
class LanguageField:
    """Features of the R Gaussians of a scene that have one; the others are absent, not zero.

    gaussian_ids: rows of the scene, ascending. code: their features, as they are kept and searched. scene: fingerprint
    of the N Gaussians. evidence: rows aligned with gaussian_ids, or None where it was not kept: all that the photos
    said, also what the aggregator left out. aggregator: how a row of it became a feature. contrast: the words that
    queries are contrasted with, None where whoever embeds queries embeds them. up: the unit direction that is up in
    the photos, in the world; None where they do not tell. left_out: photos that were kept from it on purpose.
    objects: what belongs together, None where nobody has looked. growth: what adding views needs, None if unknown.

    Raises: InputError: arrays that do not fit each other. MismatchError: a codebook of another
    encoder.
    """

    gaussian_ids: UnsignedIds
    code: Code
    encoder: EncoderIdentity
    scene: str
    num_gaussians: int
    evidence: Evidence | None = None
    negatives: Negatives | None = None
    aggregator: AggregatorRecord = MEAN_RECORD
    contrast: WordList | None = None
    up: Vector3 | None = None
    left_out: tuple[str, ...] = ()
    objects: Objects | None = None
    growth: Growth | None = None

    def __repr__(self) -> str:
        rows = f"{len(self):,} of {counted(self.num_gaussians, 'Gaussian')}"
        return f"LanguageField({rows}, {self.encoder.dim}-d by {self.encoder.name}, code {self.code.kind})"

    def _repr_html_(self) -> str:
        facts = {
            "Gaussians": f"{len(self):,} of {self.num_gaussians:,}",
            "encoder": f"{self.encoder.name}, {self.encoder.dim} numbers",
            "code": self.code.kind,
            "evidence": "kept" if self.evidence is not None else "none",
            "negatives": "none" if self.negatives is None else ", ".join(self.negatives.texts),
            "objects": "none" if self.objects is None else f"{len(self.objects):,}",
        }
        return facts_html("LanguageField", facts)

    def __post_init__(self) -> None:
        ids, rows = self.gaussian_ids, len(self.gaussian_ids)
        if ids.ndim != 1 or ids.dtype != np.uint32 or not (ids[1:] > ids[:-1]).all():
            raise InputError("gaussian_ids: expected ascending uint32 (R,)")
        if rows and ids[-1] >= self.num_gaussians:
            raise InputError(f"gaussian_ids: {ids[-1]} in a scene of {self.num_gaussians} Gaussians")
        if len(self.code) != rows:
            raise InputError(f"code: expected {rows} rows, one per gaussian_id, got {len(self.code)}")
        if self.code.dim != self.encoder.dim:
            raise MismatchError(
                f"features of {self.code.dim} numbers for the encoder {self.encoder.name} of {self.encoder.dim}"
            )
        if isinstance(self.code, PQCode) and not self.encoder.matches(self.codebook.encoder):
            raise MismatchError(
                f"the embeddings are of {identity_text(self.encoder)}, the codebook is of "
                f"{identity_text(self.codebook.encoder)}: use a codebook of the same encoder"
            )
        if self.up is not None and not (self.up.shape == (3,) and abs(np.linalg.norm(self.up) - 1) < 1e-6):
            raise InputError(f"up: expected a unit vector of three numbers, got {self.up}")
        if self.evidence is not None and (len(self.evidence), self.evidence.dim) != (rows, self.encoder.dim):
            raise InputError(
                f"evidence: expected {rows} rows of {self.encoder.dim}-d embeddings, got "
                f"{len(self.evidence)} of {self.evidence.dim}"
            )
        if self.negatives is not None and self.negatives.maxima.shape != (rows,):
            raise InputError(f"negatives: expected {rows} maxima, got {self.negatives.maxima.shape}")
        if self.objects is not None:
            masks = None if self.evidence is None else len(self.evidence.masks)
            self.objects.check_field(rows, self.encoder.dim, masks)
        if self.growth is not None and self.evidence is not None:
            known = self.evidence.masks
            self.growth.check_field(rows, self.num_gaussians, len(known), len(known.view_names))

    def __len__(self) -> int:
        return len(self.gaussian_ids)

    def rows_of(self, gaussian_ids: WholeNumbers) -> Indices:
        """Return the row of each Gaussian of the scene, -1 where it has no feature, or there is no such Gaussian."""
        if not len(self):
            return np.full(len(gaussian_ids), -1)
        ids = np.clip(gaussian_ids, 0, self.gaussian_ids[-1]).astype(np.uint32)  # else all rows are cast
        rows = np.searchsorted(self.gaussian_ids, ids)
        return np.where(self.gaussian_ids[rows] == gaussian_ids, rows, -1)

    @property
    def codebook(self) -> Codebook:
        """The codebook of product-quantised features. Raises: InputError: they are kept in another way."""
        if not isinstance(self.code, PQCode):
            raise InputError(f"this field's features are of the code '{self.code.kind}': no codebook")
        return self.code.codebook

    @cached_property
    def fingerprint(self) -> str:
        """The hash of the scene's fingerprint, the encoder and every number of the features: ties files together.

        Photos that were left out or removed are no part of it, so that a field which views were taken out of has the
        files of one that was registered without them. A field on disk has the one that its files carry.
        """
        identity = f"{self.scene} {self.code.kind} {identity_text(self.encoder)}"
        digest = hashlib.blake2b(identity.encode(), digest_size=16)
        arrays = {"gaussian_ids": self.gaussian_ids} | self.code.tensors()
        for name in sorted(arrays):
            digest.update(f"{name} {arrays[name].shape}".encode())
            digest.update(np.ascontiguousarray(arrays[name]).data)
        return digest.hexdigest()

    def runs(self, most: int = RUN_ROWS) -> Iterator[tuple[slice, Code]]:
        """Yield the code in runs of at most so many rows, for scores in bounded memory; one run on a GPU."""
        rows = len(self)
        step = max(rows, 1) if hasattr(self.code, "engine") else most
        for begin in range(0, max(rows, 1), step):
            end = min(begin + step, rows)
            yield slice(begin, end), self.code.run(begin, end)

    def scores(
        self, query: Float32[np.ndarray, "*c D"], *, threads: int = 0, code: Code | None = None
    ) -> Float32[np.ndarray, "*c r"]:
        """Return the cosine of a query, of any length, with each feature; of several queries, a row for each.

        The query is never quantised. Several at once take less time than one by one, and give the same
        bits. code: of one of the `runs`; None: of all rows.

        Raises: MismatchError: a query of another dimension. InputError: one without direction.
        Source: Dr. Splat Eq. 5-6, asymmetric: see docs/method.md.
        """
        unit = self._unit(query)
        scores = (code or self.code).scores(np.atleast_2d(unit), threads=threads)
        return scores if query.ndim == 2 else scores[0]

    def select(self, query: Embedding, threshold: float, *, threads: int = 0) -> Hits:
        """Return the rows whose cosine with the query exceeds the threshold, ascending: one scan, and no other array.

        Raises: as `scores`.
        Source: Dr. Splat Sec. B "3D object selection".
        """
        return self.code.select(self._unit(query), threshold, threads=threads)

    def select_relevant(self, query: Embedding, threshold: float = 0.5, *, threads: int = 0) -> Hits:
        """Return the rows whose relevancy exceeds the threshold, ascending, with their cosines; one scan.

        relevancy > t where score - max_n <n, f> > log(t / (1 - t)) / 10.

        Raises: as `scores`; InputError: no negatives are cached, or a threshold outside of (0, 1).
        Source: Kerr et al. 2023 (LERF) Sec. 3.3.
        """
        if self.negatives is None:
            raise InputError("relevancy needs negatives: call with_negatives first")
        if not 0 < threshold < 1:
            raise InputError(f"expected a relevancy between 0 and 1, got {threshold}")
        margin = float(np.log(threshold / (1 - threshold)) / TEMPERATURE)
        return self.code.select(self._unit(query), margin, self.negatives.maxima, threads=threads)

    def top(self, query: Embedding, count: int, *, threads: int = 0) -> Hits:
        """Return the `count` rows of the highest cosine, best first. Raises: as `scores`; InputError: count < 1."""
        return self.code.top(self._unit(query), count, threads=threads)

    def best(self, queries: Embeddings, *, threads: int = 0) -> Best:
        """Return which of several queries fits each row best, and how well; one scan for all of them.

        Raises: as `scores`; InputError: no queries.
        Source: Dr. Splat Sec. B "Open-vocabulary 3D semantic segmentation".
        """
        return self.code.best(self._unit(queries), threads=threads)

    def relevancy(self, query: Embedding, negatives: OtherEmbeddings | None = None, *, threads: int = 0) -> Numbers:
        """Return how much better the query fits than any negative, in (0, 1); one scan if they are cached.

        min over n of softmax(10 [<q, f>, <n, f>])_0, which is sigmoid(10 (<q, f> - max_n <n, f>)).
        negatives None: those of `with_negatives`.

        Raises: InputError: no negatives given and none cached.
        Source: Kerr et al. 2023 (LERF) Sec. 3.3.
        """
        known = self.negatives
        if negatives is not None and not (known and np.array_equal(known.embeddings, _unit(negatives))):
            known = self.score_negatives(negatives, threads=threads)
        if known is None:
            raise InputError("relevancy needs negatives: pass their embeddings, or call with_negatives first")
        return relevancy_from_scores(self.scores(query, threads=threads), known.maxima)

    def score_negatives(self, embeddings: Embeddings, texts: tuple[str, ...] = (), *, threads: int = 0) -> Negatives:
        """Return each row's best score among some negatives. Raises: InputError: no embeddings, or not one per text."""
        if not len(embeddings) or (texts and len(texts) != len(embeddings)):
            raise InputError(
                f"expected one or more negatives, one per text; got {len(embeddings)} and {len(texts)} texts"
            )
        unit = _unit(embeddings)
        return Negatives(texts, unit, self._maxima(unit, threads))

    def _maxima(self, unit: OtherEmbeddings, threads: int) -> Numbers:
        maxima = self.code.best(unit[:BATCH_NEGATIVES], threads=threads).scores
        for begin in range(BATCH_NEGATIVES, len(unit), BATCH_NEGATIVES):
            more = self.code.best(unit[begin : begin + BATCH_NEGATIVES], threads=threads).scores
            maxima = np.maximum(maxima, more)
        return maxima

    def with_negatives(
        self, embeddings: Embeddings, texts: tuple[str, ...] = (), *, threads: int = 0
    ) -> "LanguageField":
        """Return the field with its negatives scored once and for all; `save` keeps them."""
        return replace(self, negatives=self.score_negatives(embeddings, texts, threads=threads))

    def with_words_of(self, other: "LanguageField", *, threads: int = 0) -> "LanguageField":
        """Take the negatives of another field of the same encoder, scored anew, and the words of its contrast."""
        old = other.negatives
        negatives = old and replace(old, maxima=self._maxima(old.embeddings, threads))
        return replace(self, negatives=negatives, contrast=other.contrast)

    def with_contrast(self, embeddings: Embeddings, texts: tuple[str, ...]) -> "LanguageField":
        """Return the field with the words that queries are contrasted with; `save` keeps them.

        Raises: InputError: not one embedding of the encoder's dimension for each text.
        """
        if embeddings.shape != (len(texts), self.encoder.dim) or not len(texts):
            raise InputError(
                f"contrast: expected ({len(texts)}, {self.encoder.dim}), one row per text, got {embeddings.shape}"
            )
        return replace(self, contrast=WordList(texts, _unit(embeddings)))

    def with_objects(self, objects: Objects | None) -> "LanguageField":
        """Return the field with objects; `save` keeps them. Raises: InputError: objects of another field."""
        return replace(self, objects=objects)

    def dense(self, scores: Numbers, fill: float | int = -1.0) -> Float32[np.ndarray, " N"]:
        """Return per-row values as one per Gaussian of the scene; `fill` where it has no feature."""
        values = np.full(self.num_gaussians, fill, np.float32)
        values[self.gaussian_ids] = scores
        return values

    def feature(self, rows: WholeNumbers | slice) -> Embeddings:
        """Return decoded unit features of some rows."""
        return self.code.decode(np.arange(len(self))[rows])

    def explain(self, gaussian_id: int, query: Embedding, top: int = 5) -> list[Explanation]:
        """Return the photos and masks that speak most for `query` at a Gaussian; none without a feature.

        Raises: InputError: no such Gaussian, or the field was made without evidence.
        """
        if not 0 <= gaussian_id < self.num_gaussians:
            raise InputError(f"Gaussian {gaussian_id} of a scene of {self.num_gaussians}")
        if self.evidence is None:
            raise InputError("this field holds no evidence: register again and keep it")
        row = int(self.rows_of(np.array([gaussian_id]))[0])
        return [] if row < 0 else self.evidence.explain(row, _unit(query), top)

    def check_scene(self, gaussians: AnyGaussians | Tiles) -> None:
        """Refuse another scene than the one registered, whole or in tiles. Raises: MismatchError."""
        if len(gaussians) != self.num_gaussians:
            raise MismatchError(
                f"this field belongs to a scene of {self.num_gaussians} Gaussians, the given one "
                f"has {len(gaussians)}: {_OTHER_FILE}"
            )
        if gaussians.fingerprint != self.scene:
            raise MismatchError(
                f"this field belongs to scene {self.scene}, given was {gaussians.fingerprint}: as many Gaussians, but "
                f"at other places or in another order, as compressing and editing leave them: {_OTHER_FILE}"
            )

    @property
    def times(self) -> Doubles | None:
        """Capture times of the views, or None for a still scene or a field without evidence."""
        return None if self.evidence is None else self.evidence.masks.times

    @property
    def rendered_from(self) -> tuple[str, ...]:
        """Scene that each view's picture is a rendering of, "" for photos; () where all are photos or unknown."""
        return () if self.evidence is None else self.evidence.masks.rendered_from

    def check_motion(self, moves: bool) -> None:
        """Refuse more views of a still scene for a field of a moving one, and the reverse. Raises: MismatchError."""
        if self.evidence is not None and moves != (self.times is not None):
            was, given = ("moves", "stands still") if self.times is not None else ("stands still", "moves")
            raise MismatchError(
                f"this field was registered with a scene that {was}, the given one {given}: give the scene that was "
                "registered"
            )

    def check_encoder(self, identity: EncoderIdentity) -> None:
        """Refuse an encoder whose embeddings mean something else. Raises: MismatchError."""
        if not self.encoder.matches(identity):
            raise MismatchError(
                f"this field was written with {identity_text(self.encoder)}; the given encoder is "
                f"{identity_text(identity)}: use {self.encoder.name} with the same weights, or "
                f"register again with {identity.name}"
            )

    def verify(self) -> None:
        """Compare all that is on disk with its checksums; a field that is in memory has nothing to compare.

        Raises: FormatError: a file is damaged.
        """

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the field to a folder (by custom NAME.field); see `load_field`.

        A killed process leaves the old field or the new one.

        Raises: InputError: `path` exists and `overwrite` is false, or cannot be written.
        """
        files = self._files()
        write_folder(Path(path), self._manifest(list(files)), files, overwrite)

    def equals(self, other: "LanguageField") -> bool:
        """Return True if both are saved as the same content."""
        mine, theirs = self._files(), other._files()
        return self._manifest(list(mine)) == other._manifest(list(theirs)) and all(
            file.equals(theirs[name]) for name, file in mine.items()
        )

    def _files(self) -> dict[str, TensorFile]:
        arrays = {"gaussian_ids": self.gaussian_ids} | self.code.tensors()
        parts: dict[str, tuple[ArraysByName, dict[str, str]]] = {CODES: (arrays, {})}
        if self.evidence is not None:
            parts[EVIDENCE] = self.evidence.tensors(), self.evidence.metadata()
        if self.negatives is not None:
            parts[NEGATIVES] = {"embeddings": self.negatives.embeddings, "maxima": self.negatives.maxima}, {}
        if self.contrast is not None:
            parts[CONTRAST] = {"embeddings": self.contrast.embeddings}, {}
        if self.objects is not None:
            parts[OBJECTS] = self.objects.tensors(), {"votes": self.objects.votes} if self.objects.votes else {}
        if self.growth is not None:
            parts[GROWTH] = self.growth.tensors(), self.growth.metadata()
        tie = {"field": self.fingerprint}
        return {name: TensorFile(arrays, about | tie) for name, (arrays, about) in parts.items()}

    def _manifest(self, files: list[str]) -> dict[str, object]:
        from importlib.metadata import version

        code: dict[str, object] = {"kind": self.code.kind}  # its arrays say the rest
        if isinstance(self.code, PQCode):
            code |= {"codebook": self.codebook.hash, "encoder": identity_json(self.codebook.encoder)}
        return {
            "format": FORMAT,
            "version": VERSION,
            "drsplat": version("drsplat"),
            "field": self.fingerprint,
            "files": files,
            "scene": self.scene,
            "num_gaussians": self.num_gaussians,
            "num_registered": len(self),
            "encoder": identity_json(self.encoder),
            "code": code,
            "aggregator": asdict(self.aggregator),
            "up": None if self.up is None else self.up.tolist(),
            "left_out": list(self.left_out),
            "pictures": pictures_kind(self.rendered_from),
            "rendered_from": scenes_rendered(self.rendered_from),
            "negatives": list(self.negatives.texts) if self.negatives else [],
            "contrast": list(self.contrast.texts) if self.contrast else [],
            "objects": None if self.objects is None else len(self.objects),
            "growth": None if self.growth is None else self.growth.json(),
        }

    def _unit(self, query: Float32[np.ndarray, "*c D"]) -> Float32[np.ndarray, "*c D"]:
        if query.shape[-1:] != (self.encoder.dim,):
            raise MismatchError(
                f"the query has {query.shape[-1] if query.ndim else 0} numbers; this field was written with "
                f"{identity_text(self.encoder)}: embed the query with that encoder"
            )
        return _unit(query)


def _unit(vectors: Float32[np.ndarray, "*n D"]) -> Float32[np.ndarray, "*n D"]:
    with np.errstate(invalid="ignore"):  # NaN of any kind: refused below
        norms = np.linalg.norm(vectors.astype(np.float64), axis=-1, keepdims=True)
    if not (np.isfinite(norms) & (norms > 0)).all():
        raise InputError("embeddings to compare with must be finite and not zero")
    return np.asarray(vectors / norms, np.float32)
