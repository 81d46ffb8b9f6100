"""Questions to `drsplat serve`, and the rows of its answers in what a program shows. Nothing here knows the program."""

import hashlib
import json
from collections.abc import Sequence
from typing import Any, NamedTuple
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

import numpy as np

TIMEOUT_SECONDS = 40  # the service itself gives up after 30


class AskingError(Exception):
    """There is no answer, with the reason for people."""


class ServedScene(NamedTuple):
    """A scene of the service. fingerprint: of its Gaussians, in their order."""

    name: str
    num_gaussians: int
    fingerprint: str


class Service:
    """A running `drsplat serve`. key: of `--api-key-file`, where the service has one."""

    def __init__(self, address: str, key: str = "") -> None:
        if not address.startswith(("http://", "https://")):
            raise AskingError(f"address: expected http://HOST:PORT, got {address!r}")
        self.address, self.key = address.rstrip("/"), key

    def scenes(self, num_gaussians: int) -> list[ServedScene]:
        """Return the scenes that have so many Gaussians at most: the others cannot be what is shown."""
        listed = self._fetch("/scenes")["scenes"]
        names = [scene["name"] for scene in listed if 0 < scene["num_gaussians"] <= num_gaussians]
        told = [self._fetch(f"/scenes/{quote(name, safe='')}") for name in names]
        return [ServedScene(scene["name"], scene["num_gaussians"], scene.get("scene", "")) for scene in told]

    def rows(self, scene: str, text: str) -> np.ndarray:
        """Return the rows of the scene that a text selects."""
        answer = self._fetch(f"/scenes/{quote(scene, safe='')}/select", text=text, ids=True)
        return np.array(answer["gaussian_ids"], np.int64)

    def _fetch(self, path: str, **query: object) -> dict[str, Any]:
        headers = {"content-type": "application/json"} | ({"x-api-key": self.key} if self.key else {})
        request = Request(self.address + path, json.dumps(query).encode() if query else None, headers)
        try:
            with urlopen(request, timeout=TIMEOUT_SECONDS) as answer:
                return dict(json.load(answer))
        except HTTPError as error:
            raise AskingError(_reason(error)) from None
        except (URLError, TimeoutError, ConnectionError) as error:
            raise AskingError(f"no drsplat serve answers at {self.address}: {error}") from None
        except ValueError:
            raise AskingError(f"what answers at {self.address} is no drsplat serve") from None


def _reason(error: HTTPError) -> str:
    try:
        return str(json.load(error)["error"])
    except (ValueError, KeyError, TypeError):
        return f"the service answers with {error.code}"


def fingerprints(positions: np.ndarray) -> set[str]:
    """Return what drsplat calls Gaussians at these positions (n, 3): drawn plainly, and drawn antialiased."""
    plain = hashlib.blake2b(np.ascontiguousarray(positions, "<f4").tobytes(), digest_size=12)
    marked = plain.copy()
    marked.update(b"antialiased")
    return {f"{len(positions)}-{digest.hexdigest()}" for digest in (plain, marked)}


def place_of(scenes: Sequence[ServedScene], positions: np.ndarray, starts: Sequence[int]) -> tuple[str, int]:
    """Return the served scene that stands among the positions, and the first row of it there.

    starts: rows at which one of the parts begins that the positions are made of.

    Raises: AskingError: none does, with what may be the cause.
    """
    for scene in scenes:
        for start in starts:
            part = positions[start : start + scene.num_gaussians]
            if len(part) == scene.num_gaussians and scene.fingerprint in fingerprints(part):
                return scene.name, start
    served = ", ".join(f"{scene.name} ({scene.num_gaussians:,})" for scene in scenes) or "none that is small enough"
    raise AskingError(
        f"the {len(positions):,} Gaussians shown are no scene that is served: {served}. Open the very file that was "
        "registered, neither moved, edited nor sorted"
    )


def mask_of(rows: np.ndarray, start: int, count: int) -> np.ndarray:
    """Return the mask (count,) of rows of a scene that begins at `start`."""
    mask = np.zeros(count, bool)
    mask[start + rows] = True
    return mask
