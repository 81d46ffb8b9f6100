"""Pretrained models by id on the Hugging Face hub or by folder: files, hash, errors, advice for pickles."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import DrSplatError, FormatError, InputError, MissingExtraError, pip_install
from ...formats.json_files import excerpt, read_json
from .libraries import model_class, models_library

WEIGHTS, INDEX = "model.safetensors", "model.safetensors.index.json"
OPEN_CLIP, OPEN_CLIP_CONFIG = "open_clip_model.safetensors", "open_clip_config.json"
_SETTINGS = ["*.json", "merges.txt", "vocab.txt", "*.model"]
_DOWNLOADED_FILES = [*_SETTINGS, WEIGHTS, "model-*-of-*.safetensors"]
_VOCABULARIES = ("tokenizer.json", "vocab.json", "vocab.txt", "*.model")
DEFAULT_ENCODER = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""The paper's encoder. Source: Dr. Splat Sec. A."""
OPENCLIP_NAMES = {"ViT-B-16/laion2b_s34b_b88k": DEFAULT_ENCODER}
"""Names of LangSplat and OpenCLIP for the same models."""
_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")
_EXAMPLES = f"{DEFAULT_ENCODER} (CLIP) or facebook/sam2.1-hiera-tiny (SAM)"
BUILT_IN = "built in, without a download: the segmenter graph and the encoder drsplat-mini (coarser, for trials)"


def model_folder(name: str, prefix: str = "") -> tuple[str, Path]:
    """Return what to call a model, and the folder with its files: that named, or else the hub's.

    The hub's is downloaded into the cache of huggingface_hub if it is not there yet.
    prefix: of names that open_clip's own library loads, and no part of a folder or an id.

    Raises: InputError: no such folder and no such id, or a gated one. DrSplatError: no network.
    MissingExtraError: huggingface_hub is not installed.
    """
    place = OPENCLIP_NAMES.get(name, name.removeprefix(prefix))
    folder = Path(place).expanduser()
    if place and folder.is_dir():
        return folder.resolve().name, folder
    if folder.exists() or not _ID.fullmatch(place):
        raise InputError(
            f"{place}: expected a folder with config.json and {WEIGHTS} (or {OPEN_CLIP_CONFIG} and {OPEN_CLIP}), or an "
            f"id of the Hugging Face hub, AUTHOR/NAME, such as {_EXAMPLES}; {BUILT_IN}"
        )
    return name, _downloaded(place, bool(prefix))


def cached_in_full(name: str) -> bool:
    """Return whether config and weights of a hub's model are in the local cache, without using the network."""
    hub = import_module("huggingface_hub")
    here = {
        file for file in ("config.json", OPEN_CLIP_CONFIG, WEIGHTS, INDEX, OPEN_CLIP)
        if isinstance(hub.try_to_load_from_cache(name, file), str)
    }  # fmt: skip
    as_transformers = "config.json" in here and bool({WEIGHTS, INDEX} & here)
    return as_transformers or (OPEN_CLIP in here and bool({"config.json", OPEN_CLIP_CONFIG} & here))


def model_type(folder: Path) -> str:
    """Return the architecture that config.json names; "clip" where only OpenCLIP's settings exist.

    Raises: InputError: there is neither. FormatError: config.json names none.
    """
    if not (folder / "config.json").is_file():
        if (folder / OPEN_CLIP_CONFIG).is_file():
            return "clip"
        raise InputError(
            f"{folder}: has no config.json, so it is not a model's folder as transformers saves it, "
            f"nor {OPEN_CLIP_CONFIG}: give the folder with config.json and {WEIGHTS}"
        )
    config = read_json(folder / "config.json")
    name = config.get("model_type") if isinstance(config, dict) else None
    if not isinstance(name, str):
        raise FormatError(f"{folder / 'config.json'}: expected a model_type, got {excerpt(name)}")
    return name


def weight_files(folder: Path) -> list[Path]:
    """Return the safetensors files of a model's weights, with sound headers; OpenCLIP's only if no others exist.

    Raises: InputError: there are none, or only pickles. FormatError: one is damaged or missing.
    """
    if (folder / WEIGHTS).is_file():
        files = [folder / WEIGHTS]
    elif (folder / INDEX).is_file():
        files = _shards(folder)
    elif (folder / OPEN_CLIP).is_file():
        files = [folder / OPEN_CLIP]
    else:
        raise InputError(no_weights(folder))
    check_headers(files)
    return files


def weights_hash(files: list[Path]) -> str:
    """Return the BLAKE2b hash over the bytes of the files, in their order."""
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def load_model(class_name: str, folder: Path, unused: tuple[str, ...] = (), **overrides: Any) -> Any:
    """Load a model of transformers in float32 and evaluation mode, with every weight from the files.

    unused: ends of names of weights that may be missing because they have no part in the result.
    overrides: config and state_dict, where the folder has them under other names.

    Raises: FormatError: the weights do not fit config.json, or some are missing.
    MissingExtraError: transformers cannot be used.
    """
    kind = model_class(class_name)
    with model_errors(folder, class_name):
        model, report = kind.from_pretrained(
            None if overrides else str(folder),
            use_safetensors=True,
            local_files_only=True,
            output_loading_info=True,
            **overrides,
        )
    missing = sorted(name for name in report["missing_keys"] if not name.endswith(unused))
    if missing:
        raise FormatError(
            f"{folder}: the weights lack {len(missing)} tensors of a {class_name}, first "
            f"'{missing[0]}': they are of another model than config.json says"
        )
    return model.float().eval()


@contextmanager
def model_errors(folder: Path, class_name: str) -> Iterator[None]:
    """Turn any exception that transformers raises for an unsound model into a FormatError."""
    strict = import_module("huggingface_hub.errors").StrictDataclassError
    unsound = (OSError, RuntimeError, ValueError, KeyError, TypeError, AttributeError)
    try:
        with _quiet():
            yield
    except (*unsound, ArithmeticError, strict) as error:
        raise FormatError(
            f"{folder}: its settings and weights do not make a {class_name}: {_first_line(error)}. "
            "Download or convert the model anew"
        ) from error


def load_tokenizer(folder: Path) -> Any:
    """Load the folder's tokenizer. Raises: InputError: transformers can load none from it."""
    if not any(next(folder.glob(pattern), None) for pattern in _VOCABULARIES):
        # transformers would make one without a vocabulary, which maps all texts to the same tokens
        raise InputError(
            f"{folder}: has no tokenizer, which a query in words needs: copy tokenizer.json (or "
            "vocab.json and merges.txt) of the model into it"
        )
    # AutoTokenizer reads the class from one of these; OpenCLIP's folders may have neither
    names_class = any((folder / name).is_file() for name in ("config.json", "tokenizer_config.json"))
    kind = model_class("AutoTokenizer" if names_class else "CLIPTokenizer")
    try:
        with _quiet():
            return kind.from_pretrained(str(folder), local_files_only=True)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, ImportError) as error:
        raise InputError(
            f"{folder}: its tokenizer cannot be loaded: {_first_line(error)}. Copy it anew; that of "
            "SigLIP 1 (spiece.model) needs: pip install sentencepiece"
        ) from error


def _downloaded(name: str, by_open_clip: bool) -> Path:
    try:
        hub = import_module("huggingface_hub")
        errors = import_module("huggingface_hub.errors")
    except ImportError:
        raise MissingExtraError(f"'{name}' is an id of the Hugging Face hub: {pip_install('models')}") from None
    try:
        wanted = [*_SETTINGS, OPEN_CLIP] if by_open_clip else _DOWNLOADED_FILES
        folder = Path(hub.snapshot_download(name, allow_patterns=wanted))
        if not (by_open_clip or any((folder / file).is_file() for file in (WEIGHTS, INDEX))):
            # second, so that of a repository with both only one is downloaded
            folder = Path(hub.snapshot_download(name, allow_patterns=[*wanted, OPEN_CLIP]))
        return folder
    except errors.GatedRepoError as error:
        raise InputError(
            f"{name}: gated. Accept its licence at https://huggingface.co/{name}, wait for access where its authors "
            "grant it by hand, and log in with `hf auth login`; or choose a model that is free to download"
        ) from error
    except errors.RepositoryNotFoundError as error:
        raise InputError(
            f"{name}: there is no such folder here and no such model on the Hugging Face hub (or it "
            f"is private: `hf auth login`). Check the spelling; {BUILT_IN}"
        ) from error
    except (OSError, errors.LocalEntryNotFoundError) as error:  # all else of the network is OSError
        raise DrSplatError(
            f"{name}: not in the local cache in full, and the hub cannot be reached ({_first_line(error)}). Run once "
            f"with a network and without HF_HUB_OFFLINE, or copy the model's folder here and give its path; {BUILT_IN}"
        ) from error


def _shards(folder: Path) -> list[Path]:
    index = read_json(folder / INDEX)
    places = index.get("weight_map") if isinstance(index, dict) else None
    if not isinstance(places, dict) or not places:
        raise FormatError(f"{folder / INDEX}: expected a weight_map, got {excerpt(places)}")
    names = sorted({str(name) for name in places.values()})
    strange = [name for name in names if Path(name).name != name]
    missing = [name for name in names if not (folder / name).is_file()]
    if strange or missing:
        raise FormatError(
            f"{folder / INDEX}: names {excerpt((strange or missing)[0])}, which is not there: download the model again"
        )
    return [folder / name for name in names]


def check_headers(files: Sequence[Path]) -> None:
    """Check the lengths of safetensors files against their headers, which broken downloads do not pass.

    Raises: FormatError: one is damaged.
    """
    safetensors = import_module("safetensors")
    for path in files:
        try:
            with safetensors.safe_open(str(path), framework="numpy"):
                pass
        except (safetensors.SafetensorError, OSError, ValueError) as error:
            raise FormatError(f"{path}: damaged or incomplete ({_first_line(error)}): download it again") from error


def no_weights(folder: Path) -> str:
    """Return the error text for a folder without safetensors, with the command that converts a pickle."""
    others = sorted(path.name for path in folder.glob("*") if path.suffix in (".bin", ".pt", ".pth"))
    if not others:
        return (
            f"{folder}: has no {WEIGHTS} and no {OPEN_CLIP}: download the model's weights into it. Where they are "
            "published as a pickle only, put that there and run this again for the command that converts it"
        )
    if others[0].startswith("open_clip"):
        source, target = (str(folder / name) for name in ("open_clip_pytorch_model.bin", OPEN_CLIP))
        cure = (
            'python -c "import torch; from safetensors.torch import save_file; '
            f'save_file(torch.load({source!r}, weights_only=True), {target!r})"'
        )
    else:
        cure = (
            'python -c "from transformers import AutoModel; '
            f"AutoModel.from_pretrained({str(folder)!r}).save_pretrained('converted')\", copy the "
            "tokenizer's files beside it, and give that folder"
        )
    return (
        f"{folder}: its weights are a pickle ({others[0]}), which can run code when it is loaded. "
        f"Convert it once, where you trust it: {cure}"
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence progress bars and reports of transformers; errors in the weights still raise."""
    log = models_library().utils.logging
    level, bars = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        yield
    finally:
        log.set_verbosity(level)
        if bars:
            log.enable_progress_bar()


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:300]
