"""A session in a browser, by viser: the scene, its boxes and cameras. What people press is in `panel`."""

import io
import secrets
import socket
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Float64
from ..errors import MissingExtraError
from ..filming.looking import FOV_DEGREES, looking_at
from ..filming.paths import KeyFrame
from ..query import Match
from ..scene.views import View
from ..serving.access import EVERYWHERE, is_loopback
from . import painting
from .cameras import first_look
from .finds import MOST_FIRST, MOST_LISTED, finds_of
from .listening import listening_socket
from .packages import INSTALL, viser_module
from .playing import placed_now
from .session import Session
from .shown import Shown
from .texts import printable

DARK, LIGHT = "dark", "light"
FLIGHT_STEPS, FLIGHT_SECONDS = 20, 0.5
NOTE = (255, 224, 130)
MOST_CAMERAS, CAMERA_SIZE = 200, 0.35
CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - 0.5
EDGES = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])
Vector = Float64[np.ndarray, " 3"]


def guarded_server(host: str, port: int, token: str | None) -> Any:
    """viser's server behind a `Gate`. Raises: MissingExtraError: a viser that goes round it; it is stopped."""
    from .gate import Gate

    viser, gate = viser_module(), Gate(host, token)
    listening = listening_socket(host, port)
    with gate.before(listening), redirect_stdout(io.StringIO()):  # it draws a box, wanted or not
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not gate.stands:
        server.stop()
        listening.close()
        raise MissingExtraError(
            f"viser {viser.__version__} lets every page in, so the viewer does not start: {INSTALL}"
        )
    gate.controls = server.gui._gui_input_handle_from_uuid
    return server


class Served(NamedTuple):
    """viser's server, its address for a browser, and the token in that, None where only this machine reaches it."""

    server: Any
    address: str
    token: str | None


def served(host: str, port: int) -> Served:
    """A server that looks as ours do, behind a gate.

    Raises: MissingExtraError: viser is not installed. InputError: nothing can listen there.
    """
    token = None if is_loopback(host) else secrets.token_urlsafe(24)
    server = guarded_server(host, port, token)
    themed(server.gui, is_dark=True)
    server.gui.main_panel.dock_right()
    name = socket.gethostname() if host in EVERYWHERE else host
    name = f"[{name}]" if ":" in name and not name.startswith("[") else name
    address = f"http://{name}:{server.get_port()}" + ("" if token is None else f"/?token={token}")
    return Served(server, address, token)


def themed(gui: Any, is_dark: bool) -> None:
    """How controls look, for who is here and who comes; viser cannot ask a browser which it is set to."""
    gui.configure_theme(
        dark_mode=is_dark, control_width="large", show_logo=False, show_share_button=False,
        brand_color=painting.accent(0),
    )  # fmt: skip


class Window:
    """What a browser shows of a session. All who open the page see, and change, the same one.

    up: of the scene, in the world. Where other machines reach `host`, the address has a token. server: one that is
    there already; what it showed before has been removed.

    Raises: MissingExtraError: viser is not installed. InputError: nothing can listen there.
    """

    def __init__(
        self, session: Session, up: Vector, *, host: str = "127.0.0.1", port: int = 8080, server: "Served | None" = None
    ) -> None:
        self.session, self.up = session, up
        self.served = served(host, port) if server is None else server
        self.server: Any = self.served.server
        self._marks: list[Any] = []
        self._cameras: list[Any] = []
        self.boxes = self.notes = True
        self._open()

    def _open(self) -> None:
        scene, shown = self.server.scene, self.session.shown
        scene.set_up_direction(tuple(float(x) for x in self.up))
        eye, target = first_look(self.session.scene.views, shown.frame, self.up)
        camera = self.server.initial_camera
        camera.position, camera.look_at = shown.frame.shown(eye), shown.frame.shown(target)
        camera.up, camera.fov = self.up, float(np.radians(FOV_DEGREES))
        self._draw(self.session.drawn)

    def _draw(self, drawn: Shown) -> None:
        """Other Gaussians, or others places for them."""
        full = drawn.covariances[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        self._drawn = drawn
        self._splats = self.server.scene.add_gaussian_splats(
            "/scene", drawn.centers, full, drawn.rgb, drawn.opacities[:, None]
        )

    # --- from the session to the browser ---

    def repaint(self) -> None:
        """Show the session's colours, and boxes and names of what was found."""
        session, drawn = self.session, self.session.drawn
        if drawn.ids is not self._drawn.ids:
            self._draw(drawn)
        colors, opacities = session.drawn_colors[drawn.ids], session.edits.opacities[drawn.ids]
        buffer = self._splats.buffer.copy()
        rgba = np.concatenate([colors, opacities[:, None]], axis=1)
        packed = np.round(np.clip(rgba, 0, 1) * 255).astype(np.uint8)
        buffer[:, 7:8] = packed.view(np.uint32)
        if drawn is not self._drawn:  # the same ones, elsewhere
            buffer[:, :3] = drawn.centers.view(np.uint32)
            buffer[:, 4:7] = np.ascontiguousarray(drawn.covariances, np.float16).view(np.uint32)
            self._drawn = drawn
        with self.server.atomic():
            self._splats.buffer = buffer  # one message for colours and opacities together
            self._mark()

    def _mark(self) -> None:
        for mark in self._marks:
            mark.remove()
        self._marks.clear()
        if self.notes:
            self._mark_annotations()
        if not self.boxes:
            return
        for number, find in enumerate(finds_of(self.session.marked)[:MOST_LISTED]):
            label = find.name if number < MOST_FIRST else str(number + 1)
            self._mark_match(str(number), placed_now(self.session, find.match), label, painting.accent(find.query))

    def _mark_match(self, name: str, match: Match, label: str, color: tuple[int, int, int]) -> None:
        frame, scene = self.session.shown.frame, self.server.scene
        corners = frame.shown(match.center + (CORNERS * match.extent) @ match.axes)
        box = scene.add_line_segments(
            f"/found/{name}/box", corners[EDGES].astype(np.float32), color, thickness=2.0, thickness_units="screen"
        )
        top = corners[(corners @ self.up).argmax()]
        middle = frame.shown(match.center)
        above = middle + ((top - middle) @ self.up) * self.up
        text = scene.add_label(
            f"/found/{name}/name", printable(label, 60), position=tuple(above), anchor="bottom-center"
        )
        self._marks += [box, text]

    def _mark_annotations(self) -> None:
        for number, one in enumerate(self.session.edits.annotations[:MOST_LISTED]):
            if one.outline is not None:
                box = Match(one.center, one.outline.axes, one.outline.extent, 1.0, np.empty(0, np.int64))
                self._mark_match(f"note-{number}", box, one.text, NOTE)
                continue
            at = self.session.shown.frame.shown(one.center)
            spot = self.server.scene.add_icosphere(f"/found/note-{number}/spot", 0.06, NOTE, position=tuple(at))
            text = self.server.scene.add_label(
                f"/found/note-{number}/name", printable(one.text, 60), position=tuple(at), anchor="bottom-center"
            )
            self._marks += [spot, text]

    # --- cameras ---

    def show_cameras(self, visible: bool) -> None:
        """The places of the photos; made when first asked for. A click flies there."""
        if visible and not self._cameras:
            views = self.session.scene.views
            step = -(-len(views) // MOST_CAMERAS) or 1
            self._cameras = [self._camera(*one) for one in enumerate(views[::step])]
        for camera in self._cameras:
            camera.visible = visible

    def _camera(self, number: int, view: View) -> Any:
        pose = np.linalg.inv(view.cam_from_world)
        frustum = self.server.scene.add_camera_frustum(
            f"/photos/{number}",
            fov=float(2 * np.arctan(view.height / (2 * view.K[1, 1]))),
            aspect=view.width / view.height, scale=CAMERA_SIZE, color=(200, 205, 215),
            thickness=1.5, thickness_units="screen",
            wxyz=_quaternion(pose[:3, :3]), position=self.session.shown.frame.shown(pose[:3, 3]),
        )  # fmt: skip
        frustum.on_click(lambda event: self.fly(event.client, view.center, view.center + view.cam_from_world[2, :3]))
        return frustum

    def fly(self, client: Any, eye: Vector, target: Vector) -> None:
        """Move the camera of one browser; places in the world."""
        frame, camera = self.session.shown.frame, client.camera
        from_eye, from_target = np.array(camera.position), np.array(camera.look_at)
        to_eye, to_target = frame.shown(eye), frame.shown(target)
        for step in range(1, FLIGHT_STEPS + 1):
            share = step / FLIGHT_STEPS
            share = share * share * (3 - 2 * share)
            with client.atomic():
                camera.up_direction = self.up
                camera.position = from_eye + share * (to_eye - from_eye)
                camera.look_at = from_target + share * (to_target - from_target)
            client.flush()
            time.sleep(FLIGHT_SECONDS / FLIGHT_STEPS)

    def stand(self, client: Any, key: KeyFrame) -> None:
        """Put the camera of one browser where a key frame is, as far from what it turns about as it was."""
        frame, camera = self.session.shown.frame, client.camera
        reach = float(np.linalg.norm(np.array(camera.look_at) - np.array(camera.position)))
        eye = frame.shown(key.eye)
        with client.atomic():
            camera.up_direction, camera.fov = -key.rotation[1], float(np.radians(key.fov_degrees))
            camera.position, camera.look_at = eye, eye + max(reach, 1e-3) * key.rotation[2]
        client.flush()

    def is_sending(self, client: Any) -> bool:
        """Whether a browser has not yet taken the last file: who never takes any fills no memory."""
        return bool(client._websock_connection.get_message_buffer().message_from_id)

    def seen_by(self, client: Any, size: tuple[int, int]) -> View:
        """The camera of one browser, in the world."""
        frame, camera = self.session.shown.frame, client.camera
        eye = frame.world(np.array(camera.position, np.float64))
        target = frame.world(np.array(camera.look_at, np.float64))
        return looking_at(eye, target, self.up, size, float(np.degrees(camera.fov)))

    def stop(self) -> None:
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def _quaternion(rotation: Float64[np.ndarray, "3 3"]) -> Sequence[float]:
    """(w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)
