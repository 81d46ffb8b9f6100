"""A scene as one of the verbs takes it, whole or in tiles, and who registers it."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .options import count, words

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...field.registration import Registration
    from ...field.tiles.launching import Launcher
    from ...formats.tiles import Tiles
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving

    Register = Callable[..., Registration]


def add_workers(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--workers", type=count, metavar="N",
        help="processes for a tiled scene, each with --threads threads (default: this process only)",
    )  # fmt: skip
    group.add_argument(
        "--ray", type=words, metavar="ADDRESS",
        help="Ray cluster for a tiled scene, e.g. auto or ray://head:10001; local starts one on this machine. Its "
        "nodes must see the scene, DIR and the folder of --parts under the same names, or --parts is an address",
    )  # fmt: skip
    group.add_argument(
        "--ray-memory", type=count, metavar="MB", help="memory per task, which limits how many Ray runs on a node"
    )


def scene_of(arguments: argparse.Namespace) -> tuple[Gaussians | Moving | Tiles, Register]:
    """Return the scene, whose tiles and frames stay on disk, and the function that registers it.

    Raises: InputError: workers for a scene without tiles, or two kinds of them.
    """
    from ... import register
    from ...field.tiles.registering import register_tiles
    from ...formats.moving_scenes import read_scene

    tiles = tiles_of(arguments)
    if tiles is not None:
        return tiles, partial(register_tiles, launcher=launcher_of(arguments))
    return read_scene(arguments.scene), register


def tiles_of(arguments: argparse.Namespace) -> Tiles | None:
    """Return the scene in tiles, or None where it is none. Raises: InputError: workers for a scene without tiles."""
    from ...errors import InputError
    from ...formats.tiles import TILES, read_tiles

    path = Path(arguments.scene or "")
    folder = path.parent if path.name == TILES else path
    if arguments.scene is not None and (folder / TILES).is_file():
        return read_tiles(folder)
    if "://" in str(arguments.parts or ""):
        raise InputError(
            "--parts: an address is for a scene in tiles: give a folder, or cut the scene with drsplat tile"
        )
    if arguments.workers or arguments.ray:
        given = "--workers" if arguments.workers else "--ray"
        scene = arguments.scene or "SCENE"
        raise InputError(
            f"{given} is for a scene in tiles: drsplat tile {scene} --output NAME.tiles, then register those"
        )
    return None


def in_memory(scene: Gaussians | Moving | Tiles) -> Gaussians | Moving:
    from ...formats.tiles import Tiles

    return scene.gaussians() if isinstance(scene, Tiles) else scene


def launcher_of(arguments: argparse.Namespace) -> Launcher:
    from ...errors import InputError
    from ...field.tiles.launching import OneProcess, Processes, Ray

    if arguments.workers and arguments.ray:
        raise InputError("--workers and --ray are two ways of working: drop one of them")
    if arguments.ray:
        return Ray(arguments.ray, arguments.threads or 1, (arguments.ray_memory or 0) << 20)
    return Processes(arguments.workers) if arguments.workers else OneProcess()
