"""The scenes of a folder, by name, opened when they are first asked for."""

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

from ..adapters.loading import load_encoder
from ..asking import AskableScene, find_scene, open_scene
from ..asking.opening import FIELD_SUFFIX
from ..encoders import Encoder
from ..errors import DrSplatError, InputError
from ..formats.field_folder import read_manifest

LISTED = 20


class SceneFaultError(DrSplatError):
    """A scene is there, but its files cannot be opened."""


class UnknownSceneError(InputError):
    """There is no scene of that name; the message has those that there are."""


@dataclass(frozen=True)
class Sources:
    """Who embeds words in all scenes, and the threads of one question."""

    encoder: str | None = None
    vocabulary: str | None = None
    device: str = "auto"
    threads: int = 0


@dataclass(frozen=True)
class Summary:
    """What can be said of a scene without opening it. fault: why it cannot be opened, else ""."""

    name: str
    num_gaussians: int = 0
    num_registered: int = 0
    encoder: str = ""
    fault: str = ""


@dataclass(eq=False)
class Catalog:
    """A folder that is a scene itself, or has one in each of some subfolders.

    A name is looked up among those listed and never becomes a path. The `most` scenes used last stay open;
    encoders are shared by all. Safe for several threads.

    Raises: InputError: no such folder.
    """

    folder: Path
    sources: Sources = Sources()
    most: int = 8
    _open: "OrderedDict[str, AskableScene]" = field(default_factory=OrderedDict)
    _encoders: dict[tuple[str, str], Encoder] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)
    _loading: Lock = field(default_factory=Lock)

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: there is no such folder")

    def folders(self) -> dict[str, Path]:
        """Name and folder of each scene, as they are now."""
        root = self.folder.resolve()
        if _has_field(root):
            return {root.name or "scene": root}
        inside = sorted(path for path in root.iterdir() if not path.name.startswith("."))
        return {path.name: path for path in inside if _has_field(path)}

    def summaries(self) -> list[Summary]:
        return [_summary(name, folder) for name, folder in self.folders().items()]

    def scene(self, name: str) -> AskableScene:
        """Open, or the one that is open.

        Raises: UnknownSceneError. SceneFaultError: its files cannot be opened.
        """
        folders = self.folders()
        if name not in folders:
            known = ", ".join(map(repr, list(folders)[:LISTED])) or "none"
            raise UnknownSceneError(f"there is no scene {name[:60]!r} here; there are: {known}")
        with self._lock:
            if name in self._open:
                self._open.move_to_end(name)
                return self._open[name]
        with self._loading:
            try:
                return self._opened(name, folders[name])
            except (DrSplatError, OSError) as error:
                reason = without_paths(str(error), self.folder)
                raise SceneFaultError(f"scene {name!r} cannot be opened: {reason}") from error

    def only(self) -> str | None:
        """The name of the only scene, None if there are more or none."""
        names = list(self.folders())
        return names[0] if len(names) == 1 else None

    def _opened(self, name: str, folder: Path) -> AskableScene:
        with self._lock:
            if name in self._open:  # by another thread, meanwhile
                return self._open[name]
        given = self.sources
        scene = open_scene(
            find_scene(folder),
            encoder=given.encoder,
            vocabulary=given.vocabulary,
            device=given.device,
            threads=given.threads,
            load=self._load,
        )
        scene.field.verify()  # damage is told now, as a fault of the scene, not in mid-answer
        with self._lock:
            self._open[name] = scene
            while len(self._open) > self.most:
                self._open.popitem(last=False)
        return scene

    def _load(self, name: str, device: str) -> Encoder:
        with self._lock:
            known = self._encoders.get((name, device))
        if known is None:
            loaded = load_encoder(name, device)
            with self._lock:
                known = self._encoders.setdefault((name, device), loaded)
        return known


def _has_field(folder: Path) -> bool:
    return folder.is_dir() and any(
        path.is_dir() for path in folder.glob(f"*{FIELD_SUFFIX}") if not path.name.startswith(".")
    )


def _summary(name: str, folder: Path) -> Summary:
    try:
        manifest = read_manifest(find_scene(folder).field)
    except DrSplatError as error:
        return Summary(name, fault=without_paths(str(error), folder))
    encoder = manifest.get("encoder")
    known = encoder.get("name") if isinstance(encoder, dict) else ""
    every, registered = (manifest.get(key) for key in ("num_gaussians", "num_registered"))
    return Summary(
        name,
        every if isinstance(every, int) else 0,
        registered if isinstance(registered, int) else 0,
        str(known),
    )


def without_paths(message: str, folder: Path) -> str:
    """A message for others than the one who started the service: no folders of this machine."""
    for root in (folder, folder.resolve(), folder.parent, folder.resolve().parent):
        message = message.replace(f"{root}/", "").replace(str(root), folder.name)
    return message
