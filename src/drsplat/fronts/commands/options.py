"""Options that several verbs share, and what they stand for.

Runs that keep finished parts beside their output until it is there.

Killed when the output had appeared and its parts were not gone, they leave both: the same command then ends the work.

--without: photos that are kept for measuring, and so may not be learnt from; and people, who walk through.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ...errors import FormatError, InputError
from .declaring import add_options, argument, count, declaration, flag, items_of, length, option, whole, words
from .parsing import VerbParser

if TYPE_CHECKING:
    from ...field.codes import Track
    from ...scene.views import View

EVERY_PREFIX = "every:"


def without() -> Any:
    return option(
        "photos to leave out: a file with a name per line, or every Nth by name, starting with the first, as `drsplat "
        "train` holds them out (default: none)", "FILE|every:N", words,
    )  # fmt: skip


def keep_people(title: str = "", what: str = "people, and what moves,") -> Any:
    return flag(f"keep {what} in photos that come without masks (default: they are left out)", title=title)


def people_text(count: int, of: int) -> str:
    return f"people in {count:,} of {of:,} photos are left out"


def transients_text(count: int, of: int) -> str:
    return f"what moves is left out of {count:,} of {of:,} photos"


@contextmanager
def without_people(options: Any, views: list[View], transforms: str | None) -> Iterator[list[View]]:
    """Yield the views, with masks that leave people out while the block runs.

    Nobody is looked for where the user keeps people, the photos have masks, or `drsplat capture` has looked already.
    transforms: the file that says in which frame the views are.
    """
    from ... import read_sparse_points
    from ...photos.capture.work import RECORD
    from ...photos.models.people import without_people as masked

    record = Path(options.capture, RECORD)
    has_looked = record.is_file() and b"num_with_people" in record.read_bytes()
    if options.keep_people or has_looked or any(view.mask_path for view in views):
        yield views
        return
    points = read_sparse_points(options.capture, dataparser_transforms=transforms)
    with TemporaryDirectory(prefix="drsplat-") as folder:
        found = masked(views, points, Path(folder), track=options.track, threads=options.threads)
        count = sum(view.mask_path is not None for view in found)
        if count and not options.json:
            print(f"drsplat: {people_text(count, len(views))}", file=sys.stderr)
        yield found


def left_out(names: Sequence[str], without: str | None) -> set[str]:
    """Return those of the photos' names that --without means.

    Raises: InputError: no such file, names that no photo has, all photos, or none.
    """
    from ...formats.photo_files import listed

    if without is None:
        return set()
    if without.startswith(EVERY_PREFIX):
        try:
            step = whole(without.removeprefix(EVERY_PREFIX), least=2)
        except argparse.ArgumentTypeError as error:
            raise InputError(f"--without {without}: {error}") from None
        chosen = set(sorted(names)[::step])
    else:
        if not Path(without).is_file():
            raise InputError(
                f"--without {without}: there is no such file: expected one with a photo's name on each line, or every:N"
            )
        by_name = {Path(name).with_suffix("").as_posix(): name for name in names} | {name: name for name in names}
        wanted = lines_of(without, "a photo's name")
        unknown = [name for name in wanted if name not in by_name]
        if unknown:
            raise InputError(
                f"--without {without}: no photo has these names: {listed(unknown)}. Photos are named like {min(names)}"
            )
        chosen = {by_name[name] for name in wanted}
    if not chosen or len(chosen) == len(set(names)):
        raise InputError(
            f"--without {without}: leaves out {len(chosen)} of {len(set(names))} photos: name some, not all"
        )
    return chosen


def lines_of(path: str, what: str) -> list[str]:
    """Return the lines of a text file, without empty ones.

    Raises: InputError: there is no such file. FormatError: it is not in UTF-8.
    """
    from ...base.contents import file_text

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file")
    try:
        text = file_text(path)
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected text in UTF-8, {what} on a line: {error}") from None
    return [line.strip() for line in text.splitlines() if line.strip()]


DEVICES = ("cpu", "cuda", "mps")
LEVEL_HELP = (
    "level of the masks: default, small, medium, large or 0-3 (default: large). A trap: level 1 is *small* in "
    "features made by LangSplat, but Dr. Splat's own preprocessing stores its *large* masks in all four levels and "
    "its README trains with level 1. 'large' is right for both"
)


@declaration
class Verb:
    """Options that every verb has."""

    json: bool = flag("print one JSON object to stdout and nothing else there")
    threads: int = option(
        "CPU threads; results are the same for any number (default: 0, all cores)", "N", whole, 0
    )  # fmt: skip
    config: str | None = option("TOML file with options under [VERB]; the command line overrides it", "FILE")
    print_config: bool = flag("print the options of this command as such a file, and exit")
    log: str | None = option("append stderr to a file, with timestamps", "FILE")
    debug: bool = flag("show the traceback of an error")

    @property
    def track(self) -> Track:
        """Progress of long work, on stderr."""
        from ...base.progress import track

        return partial(track, quiet=self.json)

    @property
    def running(self) -> dict[str, Any]:
        """Arguments of functions that take long: their threads and their progress."""
        return {"threads": self.threads, "track": self.track}


@declaration
class Photos:
    """How the photos of a capture are read."""

    TITLE = "capture"
    images: str | None = option("folder of the photos, e.g. images_4 (default: CAPTURE/images, else CAPTURE)", "DIR")
    dataparser_transforms: str | None = option(
        "nerfstudio's dataparser_transforms.json, for scenes that it trained (default: the one in CAPTURE)", "FILE"
    )  # fmt: skip
    max_side: int | None = option(
        "longest side of the photos; larger ones are scaled down (default: no limit)", "PIXELS", count
    )
    times: str | None = option(
        "capture times of the photos of a moving scene: a pattern of their names, e.g. cam*/frame_{time}.png, or a "
        "table with the header name,time (default: time in transforms.json, else unknown)", "PATTERN|FILE.csv", words
    )  # fmt: skip

    def views(self, capture: str, invert_masks: bool = False) -> list[View]:
        """Read the posed photos of a capture. Raises: as `read_views`."""
        from ... import read_views

        return read_views(capture, **vars(self), invert_masks=invert_masks)


@declaration
class Encoders:
    """Models that turn words into vectors."""

    encoder: str | None = option(
        "model that embedded the masks, for queries by words or picture: a folder or an id such as "
        "laion/CLIP-ViT-B-16-laion2B-s34B-b88K (default: none; fields of the built-in words encoder need none)",
        "NAME", words,
    )  # fmt: skip
    device: str = option("device for --encoder (default: auto)", default="auto", choices=("auto", *DEVICES))
    vocabulary: str | None = option(
        "texts with their vectors from the encoder that embedded the masks, instead of the encoder: JSON {text: "
        "[numbers]} or safetensors", "FILE",
    )  # fmt: skip

    @property
    def for_kernels(self) -> str:
        """Device to draw on where --device names that of the models as well: a GPU if CuPy finds it too."""
        return "auto" if self.device in ("auto", "cuda") else "cpu"


def near() -> Any:
    return option(
        "camera z of the near plane, in scene units; nothing nearer is seen (default: 0.2 as published, less for "
        "scenes smaller than four units)", "UNITS", length,
    )  # fmt: skip


def overwrite(title: str = "") -> Any:
    return flag("replace output that exists (default: refuse)", title=title)


def invert_masks(title: str = "") -> Any:
    return flag(
        "use the black pixels of the photos' masks (masks/ beside images/) instead of the white ones (default: white)",
        title=title,
    )  # fmt: skip


def capture() -> Any:
    return argument("posed photos: a folder with a COLMAP model, transforms.json or cameras.json")


def features() -> Any:
    return option(
        "folder that drsplat embed wrote, or LangSplat's <photo>_s.npy and <photo>_f.npy", "DIR", required=True
    )


def kernel_device() -> Any:
    """Declare --device of a verb that computes with kernels of our own and no models."""
    return option(
        "device to compute on; auto is CUDA if CuPy and a GPU are available (default: auto)", default="auto",
        choices=("auto", "cpu", "cuda"),
    )  # fmt: skip


def search_device() -> Any:
    return option(
        "device for searching features (default: cpu)", default="cpu", choices=("auto", "cpu", "cuda")
    )  # fmt: skip


def new_output(path: str, overwrite: bool, suffix: str = "") -> Path:
    """Refuse early what would be refused late.

    Raises: InputError: it exists and not `overwrite`, or has another suffix.
    """
    from ...formats.activation import refuse_packed_name

    refuse_packed_name(path)
    if Path(path).exists() and not overwrite:
        raise exists_already(path)
    if suffix and Path(path).suffix.lower() != suffix:
        raise InputError(f"{path}: expected a name that ends in {suffix}")
    return Path(path)


def exists_already(path: str | Path) -> InputError:
    return InputError(f"{path} exists already: pass --overwrite to replace it, or name another output")


def add_verb(parser: VerbParser, declared: type) -> None:
    """Add the options that a verb declares, and those of every verb; --help shows its own."""
    add_options(parser, items_of(declared))
    parser.daily = {"json", *(option.dest for option in parser.options if not option.dest.startswith("help"))}
    add_options(parser, items_of(Verb, "all verbs"))


def verb_parser(prog: str, declared: type) -> VerbParser:
    """Return the parser of a verb alone."""
    parser = VerbParser(prog=prog)
    add_verb(parser, declared)
    return parser


COMPLETE = " (it was complete already; only its parts were still to be removed)"


def parts_of(output: str | Path) -> Path:
    """Return the folder of an output's parts."""
    return Path(f"{output}.parts")


def new_or_complete(path: str, overwrite: bool, suffix: str = "") -> Path:
    """Check an output as `new_output` does, but accept one with parts beside it, which a killed run left."""
    return new_output(path, overwrite or parts_of(path).is_dir(), suffix)


def was_complete(output: Path, overwrite: bool, is_this: Callable[[], bool]) -> bool:
    """Return True if the output is there already and is what would be written.

    Raises: InputError: another one is there.
    """
    if overwrite or not output.exists():
        return False
    if not is_this():
        raise exists_already(output)
    return True
