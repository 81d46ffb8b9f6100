"""Options that several verbs share, and what they stand for."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..codes import Track
    from ..encoders import Encoder
    from ..field import LanguageField
    from ..views import View

LEVEL_HELP = (
    "level of the masks: default, small, medium, large or 0-3 (default: large). A trap: level 1 is *small* in "
    "features made by LangSplat, but Dr. Splat's own preprocessing stores its *large* masks in all four levels and "
    "its README trains with level 1. 'large' is right for both"
)


def count(text: str) -> int:
    """An option's positive whole number."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a positive whole number, got '{text}'")
    return int(text)


def finite(text: str) -> float:
    """An option's number; NaN would compare with nothing, and JSON has no word for it."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"expected a finite number, got '{text}'")
    return number


def add_overwrite(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--overwrite", action="store_true", help="replace output that exists (default: refuse)"
    )


def add_capture_options(parser: argparse.ArgumentParser) -> None:
    """--images, --dataparser-transforms, --max-side: how the photos of a capture are read."""
    group = parser.add_argument_group("capture")
    group.add_argument(
        "--images", metavar="DIR",
        help="folder of the photos, e.g. images_4 (default: CAPTURE/images, else CAPTURE)",
    )  # fmt: skip
    group.add_argument(
        "--dataparser-transforms", metavar="FILE",
        help="nerfstudio's dataparser_transforms.json, for scenes that it trained (default: the one in CAPTURE)",
    )  # fmt: skip
    group.add_argument(
        "--max-side", type=int, metavar="PIXELS",
        help="scale photos with a longer side down to this (default: as they are)",
    )  # fmt: skip


def views_of(arguments: argparse.Namespace, capture: str) -> list[View]:
    from .. import read_views

    return read_views(
        capture,
        images=arguments.images,
        dataparser_transforms=arguments.dataparser_transforms,
        max_side=arguments.max_side,
    )


def view_named(views: Sequence[View], name: str) -> View:
    """By file name, with or without suffix.

    Raises: InputError: there is none.
    """
    from ..errors import InputError

    for view in views:
        if name in (
            view.name,
            str(Path(view.name).with_suffix("")),
            Path(view.name).name,
            Path(view.name).stem,
        ):
            return view
    raise InputError(
        f"there is no view '{name}': this capture has {len(views)}, from '{views[0].name}' to '{views[-1].name}'"
    )


def add_query_encoders(parser: argparse.ArgumentParser) -> None:
    """--encoder, --device, --vocabulary: what turns words into vectors."""
    parser.add_argument(
        "--encoder", metavar="NAME",
        help="the model that embedded the masks, for queries in words or by image: a folder or an id such as "
        "laion/CLIP-ViT-B-16-laion2B-s34B-b88K (default: none; fields of the built-in words encoder need none)",
    )  # fmt: skip
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda", "mps"), default="auto",
        help="where --encoder computes (default: auto)",
    )  # fmt: skip
    parser.add_argument(
        "--vocabulary", metavar="FILE",
        help="texts and their vectors from the encoder that embedded the masks, instead of the encoder itself: JSON "
        "{text: [numbers]} or safetensors",
    )  # fmt: skip


def encoder_for(
    field: LanguageField, vocabulary: str | None, encoder: str | None = None, device: str = "auto"
) -> Encoder:
    """What turns words into queries of this field.

    Raises: InputError: a field of another encoder than the built-in one, and neither its name nor a
    vocabulary; or both. MismatchError: another encoder, or one of another dimension where the field
    does not say who made it.
    """
    from .. import WordEncoder, read_vocabulary
    from ..errors import InputError, MismatchError
    from ..mini import MiniEncoder

    if encoder is not None:
        if vocabulary is not None:
            raise InputError("--encoder and --vocabulary both say who embeds the words: drop one")
        return _loaded_encoder(field, encoder, device)
    if vocabulary is not None:
        # JSON does not say who made it, and neither does a field registered without --encoder-name
        anonymous = Path(vocabulary).suffix == ".json" or field.encoder.name == "unknown"
        words = read_vocabulary(vocabulary, name=field.encoder.name if anonymous else None)
        if anonymous and words.identity.dim != field.encoder.dim:
            raise MismatchError(
                f"{vocabulary}: its vectors have {words.identity.dim} numbers, those of this field "
                f"{field.encoder.dim}: embed the texts with the encoder of the masks, '{field.encoder.name}'"
            )
        return words
    if field.encoder.matches(WordEncoder.identity):
        return WordEncoder()
    if field.encoder.name == MiniEncoder.name:
        return _loaded_encoder(field, MiniEncoder.name, device)
    raise InputError(
        f"the masks of this field were embedded by '{field.encoder.name}' ({field.encoder.dim}-d), so words must be "
        "too: pass --encoder NAME (its folder, or its id on the Hugging Face hub), --vocabulary FILE (JSON {text: "
        "[numbers]}) of texts embedded with it, or one query with "
        f"--vector FILE.npy ({field.encoder.dim} numbers)"
    )


def _loaded_encoder(field: LanguageField, name: str, device: str) -> Encoder:
    """Checked against the field; a field that does not know its encoder takes the given one's word."""
    from ..adapters.loading import load_encoder
    from ..encoders import EncoderIdentity

    encoder = load_encoder(name, device)
    if field.encoder.name == "unknown" and encoder.identity.dim == field.encoder.dim:
        encoder.identity = EncoderIdentity("unknown", field.encoder.dim)
    field.check_encoder(encoder.identity)
    return encoder


def tracker(arguments: argparse.Namespace) -> Track:
    from ..progress import track

    return partial(track, quiet=arguments.json)


def new_output(path: str, overwrite: bool, suffix: str = "") -> Path:
    """Refuse early what would be refused late.

    Raises: InputError: it exists and not `overwrite`, or has another suffix.
    """
    from ..errors import InputError

    if Path(path).exists() and not overwrite:
        raise InputError(
            f"{path} exists already: pass --overwrite to replace it, or name another output"
        )
    if suffix and Path(path).suffix.lower() != suffix:
        raise InputError(f"{path}: expected a name that ends in {suffix}")
    return Path(path)
