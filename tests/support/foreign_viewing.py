"""A scene drawn by a viewer of somebody else in a real browser, and what our picture has to be like it."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

import drsplat as ds
from browsing import a_page, eventually, pixels_of
from drsplat.base.arrays import Matrix3, Matrix4
from drsplat.kernels import sh_colors
from drsplat.scene.gaussians import SH_C0
from foreign_programs import NPM_FOLDER

WIDTH, HEIGHT, ZOOM = 480, 360, 1.8
WORLD = np.eye(4)
SECONDS = 300  # until a picture stands still, where a processor draws it
STILL = 1e-5  # mean difference of two shots, of 0 to 1: on a globe some pixel always changes


@contextmanager
def serving(scene: Path) -> Iterator[str]:
    """Serve `tests/foreign`, and the scene as /scene with its suffix; a folder with what is in it."""

    class Handler(SimpleHTTPRequestHandler):
        def translate_path(self, path: str) -> str:
            begin, _, inner = path.split("?")[0].removeprefix("/").partition("/")
            return str(scene / inner) if begin == f"scene{scene.suffix}" else super().translate_path(path)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(NPM_FOLDER)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def colourful(scene: ds.Gaussians) -> ds.Gaussians:
    """Return a scene with shapes of all kinds, and colours that depend on the direction."""
    rng = np.random.default_rng(0)
    harmonics = rng.uniform(-0.5, 0.5, (len(scene), 9, 3)).astype(np.float32)
    harmonics[:, 0] = 1.6 * scene.sh[:, 0]
    quats = scene.quats + rng.normal(size=scene.quats.shape).astype(np.float32)
    return replace(
        scene,
        sh=harmonics,
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True),
        scales=scene.scales * rng.uniform(0.3, 1.2, scene.scales.shape).astype(np.float32),
        opacities=rng.uniform(0.1, 1, len(scene)).astype(np.float32),
    )


def zoomed(photo: ds.View) -> ds.View:
    """Return a view of the size that is compared, with the scene larger in it."""
    photo = photo.resized(WIDTH, HEIGHT)
    return replace(photo, K=photo.K * [[ZOOM, 1, 1], [1, ZOOM, 1], [1, 1, 1]])


def pictured(
    browser: Any,
    viewer: str,
    scene: Path,
    view: ds.View,
    viewer_from_world: Matrix4 = WORLD,
    antialiased: bool = False,
    globe: bool = False,
    level: int | None = None,
) -> np.ndarray:
    """Return what the viewer shows from the place of a view, once it has stopped changing.

    viewer_from_world: where the viewer has the world of the view. antialiased: how it draws, where its page knows both.
    globe: whether the Earth is shown, where the scene is on it. level: of a streamed SOG, whose folder `scene` is.
    """
    look = {
        "scene": f"/scene{scene.suffix}",
        "width": view.width,
        "height": view.height,
        "fov": float(np.degrees(2 * np.arctan(view.height / 2 / view.K[1, 1]))),
        "world_from_cam": (viewer_from_world @ np.linalg.inv(view.cam_from_world) @ np.diag([1.0, -1, -1, 1]))
        .ravel()
        .tolist(),
        "antialiased": antialiased,
        "level": level,
        "globe": globe,
    }
    shots = [np.zeros((view.height, view.width, 3))]

    def settled() -> bool:
        shots.append(pixels_of(page, view.width))
        return bool(shots[-1].any()) and float(np.abs(shots[-1] - shots[-2]).mean()) < STILL

    with serving(scene) as address, a_page(browser, view.width, view.height) as page:
        page.goto(f"{address}/{viewer}.html?look={quote(json.dumps(look))}")
        page.wait_for_function("window.loaded")
        eventually(settled, SECONDS)
    return shots[-1]


def turned(rotation: Matrix3) -> Matrix4:
    """Return the matrix of a rotation about zero."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def with_colors_in_bytes(scene: ds.Gaussians, view: ds.View) -> ds.Gaussians:
    """Return the scene as seen from a view, with each constant colour, and each colour there, in [0, 1]."""
    harmonics = scene.sh.copy()
    harmonics[:, 0] = (np.clip(0.5 + SH_C0 * scene.sh[:, 0], 0, 1) - 0.5) / SH_C0
    colors = np.minimum(sh_colors(harmonics, scene.means, view.center), 1)
    return replace(scene, sh=((colors - 0.5) / SH_C0)[:, None].astype(np.float32))


def psnr(shown: np.ndarray, expected: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((shown - np.clip(expected, 0, 1))[where] ** 2)))
