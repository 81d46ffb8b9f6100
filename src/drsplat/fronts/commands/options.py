"""Options that several verbs share, and what they stand for."""

from __future__ import annotations

import argparse
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.terminal import quoted

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...errors import InputError
    from ...field.codes import Track
    from ...scene.views import View

MAX_COUNT = 2**31 - 1  # the kernels count with 32 bits
MAX_NUMBER = 3.4e38  # the kernels measure with float32
MIN_POSITIVE = 1e-30

CAPTURE_OPTIONS = ("images", "dataparser_transforms", "max_side", "times")
LEVEL_HELP = (
    "level of the masks: default, small, medium, large or 0-3 (default: large). A trap: level 1 is *small* in "
    "features made by LangSplat, but Dr. Splat's own preprocessing stores its *large* masks in all four levels and "
    "its README trains with level 1. 'large' is right for both"
)


def whole(text: str, least: int = 0, most: int = MAX_COUNT) -> int:
    """Return an option's whole number."""
    digits = text.lstrip("0") or text[:1]
    readable = digits.isascii() and digits.isdecimal() and len(digits) <= len(str(most))
    if not readable or not least <= int(digits) <= most:
        raise argparse.ArgumentTypeError(f"expected a whole number from {least} to {most}, got {quoted(text)}")
    return int(digits)


def count(text: str) -> int:
    """Return an option's positive whole number."""
    return whole(text, least=1)


def count_or_all(text: str) -> int | None:
    return None if text == "all" else count(text)


def up_to(most: int) -> Callable[[str], int]:
    """Return the parser of an option's positive whole number that is no larger."""
    return partial(whole, least=1, most=most)


PORT = up_to(65535)


def finite(text: str) -> float:
    """Return an option's finite number: NaN compares with nothing, and JSON cannot hold it."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise argparse.ArgumentTypeError(f"expected a finite number, got {quoted(text)}")
    return number


def length(text: str) -> float:
    """Return an option's positive number, as scenes are measured."""
    number = finite(text)
    if not number >= MIN_POSITIVE:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {quoted(text)}")
    return number


def words(text: str) -> str:
    """Return an option's text, or a name; a path may be any bytes, but these are compared and kept."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(f"expected text in UTF-8, got {quoted(text)}") from None
    return text


def add_near(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--near", type=length, metavar="UNITS",
        help="camera z of the near plane, in scene units; nothing nearer is seen (default: 0.2 as published, less for "
        "scenes smaller than four units)",
    )  # fmt: skip


def add_overwrite(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--overwrite", action="store_true", help="replace output that exists (default: refuse)")


def add_capture_options(parser: argparse.ArgumentParser) -> None:
    """Add --images, --dataparser-transforms, --max-side, --times: how the photos of a capture are read."""
    group = parser.add_argument_group("capture")
    group.add_argument(
        "--images", metavar="DIR", help="folder of the photos, e.g. images_4 (default: CAPTURE/images, else CAPTURE)"
    )
    group.add_argument(
        "--dataparser-transforms", metavar="FILE",
        help="nerfstudio's dataparser_transforms.json, for scenes that it trained (default: the one in CAPTURE)",
    )  # fmt: skip
    group.add_argument(
        "--max-side", type=count, metavar="PIXELS",
        help="longest side of the photos; larger ones are scaled down (default: no limit)",
    )  # fmt: skip
    group.add_argument(
        "--times", type=words, metavar="PATTERN|FILE.csv",
        help="capture times of the photos of a moving scene: a pattern of their names, e.g. cam*/frame_{time}.png, or "
        "a table with the header name,time (default: time in transforms.json, else unknown)",
    )  # fmt: skip


def add_invert_masks(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--invert-masks", action="store_true",
        help="use the black pixels of the photos' masks (masks/ beside images/) instead of the white ones (default: "
        "white)",
    )  # fmt: skip


def add_features(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", help="posed photos: a folder with a COLMAP model, transforms.json or cameras.json")
    parser.add_argument(
        "--features", required=True, metavar="DIR",
        help="folder that drsplat embed wrote, or LangSplat's <photo>_s.npy and <photo>_f.npy",
    )  # fmt: skip


def views_of(arguments: argparse.Namespace, capture: str) -> list[View]:
    from ... import read_views

    given = {name: getattr(arguments, name) for name in CAPTURE_OPTIONS}
    return read_views(capture, **given, invert_masks=getattr(arguments, "invert_masks", False))


def add_query_encoders(parser: argparse.ArgumentParser) -> None:
    """Add --encoder, --device and --vocabulary, which turn words into vectors."""
    parser.add_argument(
        "--encoder", type=words, metavar="NAME",
        help="model that embedded the masks, for queries by words or picture: a folder or an id such as "
        "laion/CLIP-ViT-B-16-laion2B-s34B-b88K (default: none; fields of the built-in words encoder need none)",
    )  # fmt: skip
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda", "mps"), default="auto", help="device for --encoder (default: auto)"
    )
    parser.add_argument(
        "--vocabulary", metavar="FILE",
        help="texts with their vectors from the encoder that embedded the masks, instead of the encoder: JSON {text: "
        "[numbers]} or safetensors",
    )  # fmt: skip


def add_kernel_device(parser: argparse._ActionsContainer) -> None:
    """Add --device of a verb that computes with kernels of our own and no models."""
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto",
        help="device to compute on; auto is CUDA if CuPy and a GPU are available (default: auto)",
    )  # fmt: skip


def device_for_kernels(arguments: argparse.Namespace) -> str:
    """Return the device to draw on where --device names that of the models as well: a GPU if CuPy finds it too."""
    return "auto" if arguments.device in ("auto", "cuda") else "cpu"


def add_search_device(parser: argparse.ArgumentParser) -> None:
    """Add --search-device."""
    parser.add_argument(
        "--search-device", choices=("auto", "cpu", "cuda"), default="cpu",
        help="device for searching features (default: cpu)",
    )  # fmt: skip


def tracker(arguments: argparse.Namespace) -> Track:
    from ...base.progress import track

    return partial(track, quiet=arguments.json)


def new_output(path: str, overwrite: bool, suffix: str = "") -> Path:
    """Refuse early what would be refused late.

    Raises: InputError: it exists and not `overwrite`, or has another suffix.
    """
    from ...errors import InputError
    from ...formats.writable import refuse_packed_name

    refuse_packed_name(path)
    if Path(path).exists() and not overwrite:
        raise exists_already(path)
    if suffix and Path(path).suffix.lower() != suffix:
        raise InputError(f"{path}: expected a name that ends in {suffix}")
    return Path(path)


def exists_already(path: str | Path) -> InputError:
    from ...errors import InputError

    return InputError(f"{path} exists already: pass --overwrite to replace it, or name another output")
