"""The names that files of language features have."""

from pathlib import Path
from typing import Literal

MAPS, EMBEDDINGS = "_s.npy", "_f.npy"  # LangSplat's
COMPACT = ".features.safetensors"
Form = Literal["compact", "langsplat"]
"""Forms that features of a photo are stored in; `langsplat.FORMS` says how each is opened."""


def stems(directory: Path, ending: str) -> list[str]:
    """Return the names, without `ending`, of the files in a folder and its subfolders that end so, sorted."""
    names = (path.relative_to(directory).as_posix() for path in directory.rglob(f"*{ending}"))
    return sorted(name.removesuffix(ending) for name in names)
