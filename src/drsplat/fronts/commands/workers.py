"""A scene as one of the verbs takes it, whole or in tiles, and who registers it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from .declaring import count, declaration, option, words

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...field.registration import Registration
    from ...field.tiles.launching import Launcher
    from ...formats.tiles import Tiles
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving

    Register = Callable[..., Registration]


@declaration
class Workers:
    """Workers on the tiles of a scene."""

    TITLE = "tiles"
    workers: int | None = option(
        "processes for a tiled scene, each with --threads threads (default: this process only)", "N", count
    )
    ray: str | None = option(
        "Ray cluster for a tiled scene, e.g. auto or ray://head:10001; local starts one on this machine. Its nodes "
        "must see the scene, DIR and the folder of --parts under the same names, or --parts is an address", "ADDRESS",
        words,
    )  # fmt: skip
    ray_memory: int | None = option("memory per task, which limits how many Ray runs on a node", "MB", count)

    def launcher(self, threads: int) -> Launcher:
        """Return what runs tasks. Raises: InputError: two ways of working."""
        from ...field.tiles.launching import OneProcess, Processes, Ray

        if self.workers and self.ray:
            raise InputError("--workers and --ray are two ways of working: drop one of them")
        if self.ray:
            return Ray(self.ray, threads or 1, (self.ray_memory or 0) << 20)
        return Processes(self.workers) if self.workers else OneProcess()


def scene_of(
    scene: str, workers: Workers, parts: str | None, threads: int
) -> tuple[Gaussians | Moving | Tiles, Register]:
    """Return the scene, whose tiles and frames stay on disk, and the function that registers it.

    Raises: InputError: workers for a scene without tiles, or two kinds of them.
    """
    from ... import register
    from ...field.tiles.registering import register_tiles
    from ...formats.moving_scenes import read_scene

    tiles = tiles_of(scene, workers, parts)
    if tiles is not None:
        return tiles, partial(register_tiles, launcher=workers.launcher(threads))
    return read_scene(scene), register


def tiles_of(scene: str | None, workers: Workers, parts: str | None) -> Tiles | None:
    """Return the scene in tiles, or None where it is none. Raises: InputError: workers for a scene without tiles."""
    from ...formats.tiles import TILES, read_tiles

    path = Path(scene or "")
    folder = path.parent if path.name == TILES else path
    if scene is not None and (folder / TILES).is_file():
        return read_tiles(folder)
    if "://" in (parts or ""):
        raise InputError(
            "--parts: an address is for a scene in tiles: give a folder, or cut the scene with drsplat tile"
        )
    if workers.workers or workers.ray:
        given = "--workers" if workers.workers else "--ray"
        raise InputError(
            f"{given} is for a scene in tiles: drsplat tile {scene or 'SCENE'} --output NAME.tiles, then register those"
        )
    return None


def in_memory(scene: Gaussians | Moving | Tiles) -> Gaussians | Moving:
    from ...formats.tiles import Tiles

    return scene.gaussians() if isinstance(scene, Tiles) else scene
