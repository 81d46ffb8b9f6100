"""Everything that can go wrong, as one tree: catch `DrSplatError` to catch all of it.

A message says what was given, what was expected and what to do; `did_you_mean` finds what was probably meant.
"""

import warnings
from collections.abc import Iterable

_NEAR = 0.7  # share of letters in common: "vaze" is near "vase", "rote" is not near "carrot"


class DrSplatError(Exception):
    """Root of every error that drsplat raises on purpose."""


class InputError(DrSplatError, ValueError):
    """An argument is out of its range or has the wrong shape."""


class MissingFileError(InputError, FileNotFoundError):
    """There is no file of this name."""


class FormatError(DrSplatError, ValueError):
    """A file is damaged, truncated or not what its name says."""


class MismatchError(DrSplatError):
    """Two things that are each fine do not belong together (scene, encoder, codebook)."""


class MissingExtraError(DrSplatError, ImportError):
    """An optional dependency is not installed; the message has the pip line."""


class DrSplatWarning(UserWarning):
    """Something was left out and the caller should know which and how many."""


def warn(message: str, level: int = 2) -> None:
    """Warn of something that was left out. level: how many calls up the line stands that the warning names, from 1."""
    warnings.warn(message, DrSplatWarning, stacklevel=level + 1)


def placed(where: object, error: Exception) -> str:
    """Return the message of an error behind the name of what it is about, unless it begins with that already."""
    text = str(error)
    return text if text.startswith(str(where)) else f"{where}: {text}"


def pip_install(extra: str) -> str:
    """Return the line that installs an extra from where drsplat came from: a folder or file, an address, an index."""
    import json  # only once something is missing
    from importlib.metadata import PackageNotFoundError, distribution
    from pathlib import Path
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        record = json.loads(distribution(__package__).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        record = {}
    url, wanted = record.get("url", ""), f"drsplat[{extra}]"
    if "vcs_info" in record:
        wanted += f" @ {record['vcs_info'].get('vcs', 'git')}+{url}"
    elif url.startswith("file:"):
        place = Path(url2pathname(urlsplit(url).path))
        wanted = f"{'.' if place == Path.cwd() else place}[{extra}]"
    elif url:
        wanted += f" @ {url}"
    editable = "-e " if record.get("dir_info", {}).get("editable") else ""
    return f'pip install {editable}"{wanted}"'


def did_you_mean(given: str, choices: Iterable[str], most: int = 3) -> str:
    """Return " Did you mean 'vase'?" with the nearest choices, or "" where nothing is near: the end of a message.

    Args:
        given: what was typed; case makes no difference.
        choices: what would have been accepted.
        most: choices that are listed at most.
    """
    from difflib import get_close_matches  # only once something went wrong

    by_lower = {choice.lower(): choice for choice in choices}
    near = [f"'{by_lower[word]}'" for word in get_close_matches(given.lower(), by_lower, most, _NEAR)]
    return f" Did you mean {' or '.join(near)}?" if near else ""
