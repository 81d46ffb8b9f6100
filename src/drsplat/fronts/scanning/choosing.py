"""Choice of the models that cut and embed the photos: SAM and CLIP if available, else the built-in ones."""

import os
import threading
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from ...errors import MissingExtraError, pip_install
from ...photos.embedding.fitting import pixel_fit
from ...photos.models.devices import chosen_device
from ...photos.models.graph import GraphSegmenter
from ...photos.models.libraries import models_library
from ...photos.models.loading import DEFAULT_ENCODER
from ...photos.models.mini import MiniEncoder
from ...photos.models.mini.lexicon import nouns_in
from ...photos.models.pretrained import cached_in_full
from ...photos.models.sam import CPU_SEGMENTER, DEFAULT_SEGMENTER
from ...query.sentences import known_parts
from .inputs import ScanInput

AUTO = "auto"
HUB_PATIENCE_S = 5.0
DOWNLOAD_CURE = "have a network, or name folders that hold them as segmenter and encoder"
LIKE_ROOMS = "they know colours and household words, and these photos look like those that they learnt from"
UNLIKE_ROOMS = (
    "they know colours, but these photos look unlike the made-up rooms that they learnt nouns from, so ask for colours "
    "('something red'): no answer about {} will be reliable"
)
PHOTOS_JUDGED = 8
LIGHT: Mapping[str, str | int] = {"points": AUTO, "crop_layers": 0, "levels": "large"}
"""Options of `drsplat embed` for SAM on a CPU. Fewer photos and crops may cost answers (docs/embedding.md)."""


@dataclass(frozen=True)
class ModelChoice:
    """Models of a scan. reason: why "auto" means a built-in one, "" where it does not; cure: what helps.

    meaning: what the built-in encoder can be asked on these photos, "" until they are judged.
    """

    segmenter: str
    encoder: str
    reason: str = ""
    cure: str = ""
    meaning: str = ""

    @property
    def is_built_in(self) -> bool:
        """True where the built-in encoder understands the words."""
        return self.encoder == MiniEncoder.name

    @property
    def is_known(self) -> bool:
        """True where queries of the scan's folder need not name the encoder."""
        return self.encoder in (MiniEncoder.name, DEFAULT_ENCODER)

    def cutting(self, asked: str) -> Mapping[str, str | int]:
        """Return the options of `drsplat embed` that the segmenter brings along. asked: its name, or "auto"."""
        return LIGHT if asked == AUTO and self.segmenter == CPU_SEGMENTER else {}

    @property
    def doubts_nouns(self) -> bool:
        """True where the photos look unlike what the built-in encoder learnt nouns from."""
        return self.meaning == UNLIKE_ROOMS

    def nouns_of(self, queries: Sequence[str]) -> list[str]:
        """Return the queries that name things. Raises: InputError: one that no scene could answer, as `Scene.ask`."""
        encoder = MiniEncoder() if self.is_built_in else None
        return [text for text in queries if any(map(nouns_in, known_parts(text, encoder)))]

    def judged(self, source: ScanInput, threads: int) -> "ModelChoice":
        """Return the choice with what its words mean on these photos, some of which are cut and embedded for it.

        Raises: MissingExtraError: a video, and nothing that decodes it. InputError: a video that cannot be read.
        """
        if not self.is_built_in or self.meaning:
            return self
        fit = pixel_fit(source.pictures(PHOTOS_JUDGED), threads=threads)
        return replace(self, meaning=LIKE_ROOMS if fit >= MiniEncoder.least_fit else UNLIKE_ROOMS)

    def sentence(self, nouns: Sequence[str] = (), verb: str = "scan") -> str:
        """Say which models work, what that means and what would be better. nouns: queries that name things."""
        meaning = self.meaning or "they know colours and household words"
        meaning = meaning.format(", ".join(map(repr, nouns)) or "things by their names")
        if not self.reason:
            words = meaning if self.is_built_in else "any words can be asked"
            return f"{self.segmenter} cuts the photos into masks and {self.encoder} embeds them: {words}."
        noun = "models" if self.is_built_in and self.segmenter == GraphSegmenter.name else "model"
        names = [name for name in (self.segmenter, self.encoder) if name in (GraphSegmenter.name, MiniEncoder.name)]
        meaning = meaning if self.is_built_in else "its masks are coarser than those of SAM"
        return (
            f"The built-in {noun} ({' and '.join(names)}) work, because {self.reason}; {meaning}. For SAM and CLIP: "
            f"{self.cure}, and run drsplat {verb} with --overwrite."
        )


def choose_models(segmenter: str, encoder: str, device: str = AUTO) -> ModelChoice:
    """Return the models that "auto" stands for on this machine; other names stay.

    A hub that does not answer within `HUB_PATIENCE_S` counts as out of reach.
    """
    if AUTO not in (segmenter, encoder):
        return ModelChoice(segmenter, encoder)
    try:
        models_library()
    except MissingExtraError as error:
        reason, cure = str(error).partition(": ")[0], pip_install("models")
    else:
        sam = DEFAULT_SEGMENTER if chosen_device(device) != "cpu" else CPU_SEGMENTER
        named = [(segmenter, sam), (encoder, DEFAULT_ENCODER)]
        reason = next(filter(None, (_why_not(name) for choice, name in named if choice == AUTO)), "")
        if not reason:
            return ModelChoice(*(name if choice == AUTO else choice for choice, name in named))
        cure = DOWNLOAD_CURE
    segmenter = GraphSegmenter.name if segmenter == AUTO else segmenter
    return ModelChoice(segmenter, MiniEncoder.name if encoder == AUTO else encoder, reason, cure)


def _why_not(name: str) -> str:
    """Return why a model's weights cannot be had, "" where they can."""
    if Path(name).is_dir() or cached_in_full(name):
        return ""
    if os.environ.get("HF_HUB_OFFLINE", "").upper() in ("1", "ON", "YES", "TRUE"):
        return f"the weights of {name} are not on this disk, and HF_HUB_OFFLINE is set"
    endpoint = str(import_module("huggingface_hub.constants").ENDPOINT)
    if _answers(f"{endpoint}/api/models/{name}"):
        return ""
    return f"the weights of {name} are not on this disk, and {endpoint} cannot be reached"


def _answers(address: str) -> bool:
    """Return whether a server answers in time; names are looked up in a thread, because that has no time limit."""
    answered = []

    def ask() -> None:
        try:
            with urllib.request.urlopen(address, timeout=HUB_PATIENCE_S) as reply:
                answered.append(reply.status == 200)
        except (OSError, ValueError, urllib.error.URLError):
            pass

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(HUB_PATIENCE_S)
    return bool(answered and answered[0])
