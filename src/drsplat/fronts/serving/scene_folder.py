"""The scenes of a folder, by name, opened when they are first asked for and again when their files change."""

import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from ...errors import DrSplatError, InputError
from ...field.labels import LabelFile
from ...formats.field_folder import read_manifest
from ...formats.json_files import written_name
from ...formats.scenes import FIELD_SUFFIX
from ...formats.vocabulary import read_vocabulary
from ...photos.models.loading import load_encoder
from ...query import Scene, SceneFiles, find_scene, open_scene
from ...query.catalogue import Catalogue
from ...query.opening import CAMERA_FILES
from ...scene.encoders import Encoder

MAX_NAMES_LISTED = 20
_MAX_GAUSSIANS = (1 << 31) - 1
T = TypeVar("T")
Version = frozenset[tuple[str, int, int, int, int]]


class SceneFaultError(DrSplatError):
    """A scene is there, but its files cannot be opened."""


class UnknownSceneError(InputError):
    """There is no scene of that name; the message has those that there are."""


@dataclass(frozen=True)
class Sources:
    """Encoder of words for all scenes, the threads of one question, and the device that codes are searched on.

    segmenter: of photos that are sent, where it is not built in, or None.
    """

    encoder: str | None = None
    vocabulary: str | None = None
    device: str = "auto"
    threads: int = 0
    search_device: str = "cpu"
    segmenter: str | None = None


@dataclass(frozen=True)
class Summary:
    """Summary of a scene without opening it. fault: why it cannot be opened, else ""."""

    name: str
    num_gaussians: int = 0
    num_registered: int = 0
    encoder: str = ""
    fault: str = ""


class SceneFolder:
    """A folder that is a scene itself, or has one in each of some subfolders.

    A name is looked up among those listed and never becomes a path. The `most` scenes used last stay open, each
    until one of its files is another; encoders are shared by all, and by a catalogue. Safe for several threads.

    Raises: InputError: no such folder.
    """

    def __init__(
        self, folder: Path, sources: Sources = Sources(), most: int = 8, catalogue_path: Path | None = None
    ) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder")
        self.folder, self.sources, self.most = folder.resolve(), sources, most
        self.catalogue_path = None if catalogue_path is None else catalogue_path.resolve()
        self._open: OrderedDict[str, tuple[Version, Scene]] = OrderedDict()
        self._encoders: dict[tuple[str, str], Encoder] = {}
        self._lock, self._loading = Lock(), Lock()

    @cached_property
    def roots(self) -> tuple[Path, ...]:
        """Folders that clients are not told: of the scenes, and of the files that embed words."""
        given = [Path(one) for one in (self.sources.vocabulary, self.sources.encoder) if one is not None]
        files = [path for path in given if path.is_absolute() or path.exists()]  # others are models of a hub
        catalogue = () if self.catalogue_path is None else (self.catalogue_path,)
        return (self.folder, *catalogue, *(way.parent for one in files for way in (one, one.resolve())))

    @property
    def _given(self) -> dict[str, Any]:
        """How scenes and catalogues are opened."""
        given = self.sources
        return {
            "encoder": given.encoder, "vocabulary": given.vocabulary, "device": given.device, "threads": given.threads,
            "load": self.load,
        }  # fmt: skip

    @cached_property
    def catalogue(self) -> Catalogue:
        """Raises: InputError: there is none. FormatError: damaged. MissingExtraError."""
        if self.catalogue_path is None:
            raise InputError("there is no catalogue here")
        return Catalogue.open(self.catalogue_path, **self._given)

    def folders(self) -> dict[str, Path]:
        """Name and folder of each scene, as they are now."""
        if _has_field(self.folder):
            return {written_name(self.folder.name) or "scene": self.folder}
        inside = sorted(path for path in self.folder.iterdir() if not path.name.startswith("."))
        return {written_name(path.name): path for path in inside if _has_field(path)}

    def check_sources(self) -> None:
        """Check files for whoever starts a service: clients could not tell what is wrong with them.

        Raises: InputError: no such vocabulary, an encoder beside it, or nothing in the catalogue. FormatError: one of
        them is damaged. MissingExtraError: search device "cuda" without CuPy or a GPU.
        """
        if self.sources.search_device != "cpu":
            from ...kernels.cuda.devices import chosen_device

            chosen_device(self.sources.search_device)
        if self.sources.vocabulary is not None:
            if self.sources.encoder is not None:
                raise InputError("encoder=NAME and vocabulary=FILE both embed the words: drop one")
            read_vocabulary(self.sources.vocabulary)
        if self.catalogue_path is not None:
            _ = self.catalogue.encoder

    def checked(self) -> int:
        """Count the scenes, for whoever starts a service. Raises: InputError: none; as `check_sources`."""
        self.check_sources()
        number = len(self.folders())
        if not number:
            raise InputError(
                f"{self.folder}: no scene is here: expected a folder with NAME{FIELD_SUFFIX}, as `drsplat register` "
                "writes it, and the scene it was registered on, or such folders in it; `drsplat demo` makes one"
            )
        return number

    def summaries(self) -> list[Summary]:
        """Return what the manifest of each field says of its scene."""
        return [self._summary(name, folder) for name, folder in self.folders().items()]

    def _summary(self, name: str, folder: Path) -> Summary:
        try:
            manifest = read_manifest(find_scene(folder).field)
        except (DrSplatError, OSError) as error:
            return Summary(name, fault=_text(without_paths(str(error), (folder.resolve(), *self.roots))))
        encoder = manifest.get("encoder")
        known = encoder.get("name") if isinstance(encoder, dict) else ""
        counts = (manifest.get(key) for key in ("num_gaussians", "num_registered"))
        every, registered = (one if type(one) is int and 0 <= one <= _MAX_GAUSSIANS else 0 for one in counts)
        return Summary(name, every, registered, _text(str(known))[:200])

    def only(self) -> str | None:
        """Return the name of the only scene, None if there are more or none."""
        names = list(self.folders())
        return names[0] if len(names) == 1 else None

    def files(self, name: str) -> SceneFiles:
        """Find the files of a scene. Raises: UnknownSceneError. SceneFaultError: they are not a scene."""
        return self._sound(name, find_scene)

    def scene(self, name: str) -> Scene:
        """Open, or the one that is open. Raises: UnknownSceneError. SceneFaultError: its files cannot be opened."""
        return self._sound(name, lambda folder: self._opened(name, find_scene(folder)))

    def _sound(self, name: str, read: Callable[[Path], T]) -> T:
        """Read something of a scene's folder."""
        folders = self.folders()
        if name not in folders:
            known = ", ".join(map(repr, list(folders)[:MAX_NAMES_LISTED])) or "none"
            raise UnknownSceneError(f"there is no scene {name[:60]!r} here; there are: {known}")
        try:
            return read(folders[name])
        except (DrSplatError, OSError) as error:
            reason = without_paths(str(error), (folders[name].resolve(), *self.roots))
            raise SceneFaultError(f"scene {name!r} cannot be opened: {reason}") from error

    def _opened(self, name: str, files: SceneFiles) -> Scene:
        # a version that changes when a file of a scene is replaced, cut short or written to
        capture = [] if files.capture is None else [files.capture / camera for camera in CAMERA_FILES]
        version = _stats(files.field, *files.scenes, *capture, LabelFile.beside(files.field).path)
        with self._loading:
            known, scene = self._open.pop(name, (None, None))
            if scene is None or known != version:
                scene = None  # before another takes its room
                scene = open_scene(files, search_device=self.sources.search_device, **self._given)
                if scene.tiles is None:
                    scene.field.verify()  # damage is told now, as a fault of the scene, not in mid-answer
            self._open[name] = version, scene
            while len(self._open) > self.most:
                self._open.popitem(last=False)
        return scene

    def load(self, name: str, device: str) -> Encoder:
        """Load an encoder, or return the one that is loaded."""
        with self._lock:
            if (name, device) not in self._encoders:
                self._encoders[name, device] = load_encoder(name, device)
            return self._encoders[name, device]


def without_paths(message: str, roots: Sequence[Path]) -> str:
    """Return a message without this machine's folders, for others than the one who started the service."""
    for root in sorted({str(one) for one in roots}, key=len, reverse=True):
        if root not in (os.sep, "", "."):
            message = message.replace(f"{root}{os.sep}", "")
            message = message.replace(root, Path(root).name)
    return message


def _stats(*paths: Path) -> Version:
    """Return identity, size and times of files, and of those in folders to a depth of three (COLMAP's sparse/0)."""
    found = set()
    for top in paths:
        for path in (top, *(one for deep in ("*", "*/*", "*/*/*") for one in top.glob(deep))):
            with suppress(OSError):
                now = path.stat()
                found.add((str(path), now.st_ino, now.st_size, now.st_mtime_ns, now.st_ctime_ns))
    return frozenset(found)


def _has_field(folder: Path) -> bool:
    try:
        return folder.is_dir() and any(
            path.is_dir() for path in folder.glob(f"*{FIELD_SUFFIX}") if not path.name.startswith(".")
        )
    except OSError:  # a folder that may not be read, or that has just gone
        return False


def _text(text: str) -> str:
    """Return a text that UTF-8 can encode: JSON may hold halves of surrogate pairs."""
    return text.encode("utf-8", "backslashreplace").decode()
