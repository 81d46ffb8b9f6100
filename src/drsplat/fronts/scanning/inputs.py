"""Input of a scan: photos, a video, or a capture with poses."""

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...base.arrays import OtherPixels
from ...errors import DrSplatError, InputError
from ...formats.captures import read_views
from ...formats.scenes import Kind, recognised
from ...photos.capture.capturing import sources_key
from ...photos.capture.finding import VIDEO_ENDS, find_photos
from ...photos.capture.videos import some_frames, video_source
from ...scene.photos import decoded_picture

PHOTOS, VIDEO, CAPTURE = "photos", "video", "capture"


@dataclass(frozen=True)
class ScanInput:
    """An input of a scan.

    Attributes:
        path: as it was given.
        kind: "photos", "video" or "capture".
        fingerprint: changes with the photos, by their names, sizes and times.
        photos: files of the photos; none for a video.
    """

    path: Path
    kind: str
    fingerprint: str
    photos: tuple[Path, ...] = ()

    @property
    def num_photos(self) -> int | None:
        """Number of photos, None for a video."""
        return None if self.kind == VIDEO else len(self.photos)

    def pictures(self, count: int) -> Iterator[OtherPixels]:
        """Yield some of its photos or frames, evenly chosen, at most so many; damaged ones are left out.

        Raises: as `some_frames`.
        """
        if self.kind == VIDEO:
            yield from some_frames(self.path, count)
        for path in self.photos[:: -(-len(self.photos) // count)] if self.photos else ():
            with suppress(DrSplatError):
                yield decoded_picture(path)

    def document(self) -> dict[str, Any]:
        """Return the input's entry in the record."""
        return {"path": str(self.path), "kind": self.kind, "fingerprint": self.fingerprint}


def scan_input(path: Path) -> ScanInput:
    """Identify the input at a path, by names and times only; no photo is decoded.

    Raises: InputError: neither photos, nor a video, nor a capture with photos. FormatError: a damaged capture.
    """
    if path.suffix.lower() in VIDEO_ENDS and path.is_file():
        return ScanInput(path, VIDEO, sources_key([video_source(path)]))
    if path.is_dir() and recognised(path) is Kind.CAPTURE:
        photos = [view.image_path for view in read_views(path) if view.image_path is not None]
        if not photos:
            raise InputError(f"{path}: has poses, but none of its photos is there: put them into {path / 'images'}")
        models = [file for name in ("sparse", "colmap") for file in (path / name).rglob("*") if file.is_file()]
        cameras = sorted([*models, *path.glob("*.json")])
        facts = [(str(file.name), file.stat().st_size, file.stat().st_mtime_ns) for file in [*cameras, *photos]]
        return ScanInput(
            path, CAPTURE, hashlib.blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest(), tuple(photos)
        )
    sources = find_photos(path)
    return ScanInput(path, PHOTOS, sources_key(sources), tuple(source.path for source in sources))
