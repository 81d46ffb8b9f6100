"""The layouts of other tools' exports lead to the same answer (docs/neighbours.md)."""

import base64
import json
import runpy
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import drsplat as ds
from drsplat.formats.live_views import LiveView, live_name, posed
from toy_capture import HEIGHT, NEGATIVES, THINGS, WIDTH, write_toy_capture

NEIGHBOURS = Path(__file__).resolve().parents[2] / "examples/neighbours"
TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("xyz", (20, -50, 110), degrees=True).as_matrix()
TURN[:3, 3] = (1.0, -2.0, 0.5)
SCALE = 0.37  # of nerfstudio's frame


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    return write_toy_capture(tmp_path_factory.mktemp("neighbours"))


def colmap_model(views: list[ds.View], folder: Path) -> None:
    """As text: one camera for all, and photos without points."""
    folder.mkdir(parents=True)
    k = views[0].K
    (folder / "cameras.txt").write_text(
        f"# made by another tool\n1 PINHOLE {WIDTH} {HEIGHT} {k[0, 0]} {k[1, 1]} {k[0, 2]} {k[1, 2]}\n"
    )
    lines = []
    for number, view in enumerate(views, 1):
        x, y, z, w = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat()
        pose = " ".join(map(str, (w, x, y, z, *view.cam_from_world[:3, 3])))
        lines += [f"{number} {pose} 1 {view.name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("")


def frames(views: list[ds.View], folder: str, per_frame: bool) -> dict[str, object]:
    """transforms.json: intrinsics with each frame, as of Polycam's poses, or once, as of Record3D's."""
    k = views[0].K
    lens = {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "w": WIDTH, "h": HEIGHT}
    entries = []
    for view in views:
        pose = np.linalg.inv(view.cam_from_world) @ np.diag([1.0, -1, -1, 1])
        entry = {"file_path": f"{folder}/{view.name}", "transform_matrix": pose.tolist()}
        entries.append(entry | (lens if per_frame else {}))
    return {"camera_model": "OPENCV", "frames": entries} | ({} if per_frame else lens)


def postshot(views, folder):
    colmap_model(views, folder / "sparse/0")


def realityscan(views, folder):
    colmap_model(views, folder / "model")
    for file in (folder / "model").iterdir():
        shutil.move(file, folder / file.name)


def metashape(views, folder):
    colmap_model(views, folder / "sparse")


def polycam(views, folder):
    document = frames(views, "images", per_frame=True)
    for number, frame in enumerate(document["frames"]):
        frame |= {"depth_file_path": f"depth/{number}.png"}  # which is not there, and not needed
    (folder / "transforms.json").write_text(json.dumps(document))


def record3d(views, folder):
    (folder / "transforms.json").write_text(json.dumps(frames(views, "./images", per_frame=False)))


def nerfstudio(views, folder):
    record3d(views, folder)
    record = {"transform": TURN[:3].tolist(), "scale": SCALE}
    (folder / "dataparser_transforms.json").write_text(json.dumps(record))


def in_its_frame(gaussians: ds.Gaussians) -> ds.Gaussians:
    means = SCALE * (gaussians.means @ TURN[:3, :3].T + TURN[:3, 3])
    return replace(gaussians, means=means.astype(np.float32), scales=(SCALE * gaussians.scales).astype(np.float32))


@pytest.mark.parametrize("layout", [postshot, realityscan, metashape, polycam, record3d, nerfstudio])
def test_a_layout_leads_to_the_answer(layout, toy, tmp_path):
    shutil.copytree(toy / "capture/images", tmp_path / "images")
    layout(ds.read_views(toy / "capture"), tmp_path)
    gaussians, at = ds.read_gaussians(toy / "scene.ply"), np.array(THINGS["red mug"])
    if layout is nerfstudio:
        gaussians, at = in_its_frame(gaussians), SCALE * (TURN[:3, :3] @ at + TURN[:3, 3])
    encoder = ds.WordEncoder()
    features = ds.read_features(toy / "capture/language_features", encoder=encoder.identity)
    views = ds.read_views(tmp_path)
    assert all(view.image_path is not None for view in views)
    field = ds.register(gaussians, views, features).to_field()
    field = field.with_negatives(encoder.encode_texts(NEGATIVES), tuple(NEGATIVES))
    matches = ds.Scene(field, gaussians, views, encoder).locate("red mug")
    assert len(matches) == 1
    assert np.abs(matches[0].center - at).max() < 0.1


def test_photos_to_an_answer_is_a_script_that_goes_on(tmp_path):
    """Its commands, in their order, by programs that write down that they were called."""
    for name in ("drsplat", "colmap"):
        made = 'mkdir -p "$2/sparse/0"' if name == "colmap" else ":"
        program = tmp_path / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(f'#!/bin/sh\necho {name} "$1" >> {tmp_path}/calls\nset -- "$2" "$3"; {made}\n')
        program.chmod(0o755)
    command = ["bash", NEIGHBOURS / "colmap_to_answer.sh", tmp_path / "room", "red mug"]
    subprocess.run(command, check=True, env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin"})
    calls = (tmp_path / "calls").read_text().split("\n")[:-1]
    verbs = ["train", "embed", "register", "locate"]
    assert calls == ["colmap automatic_reconstructor", *(f"drsplat {verb}" for verb in verbs)]


class Service(BaseHTTPRequestHandler):
    """Answers as `POST /scenes/{scene}/locate` does, and takes views."""

    views: ClassVar[list[dict[str, object]]] = []

    def do_POST(self) -> None:
        query = json.loads(self.rfile.read(int(self.headers["content-length"])))
        known = self.path == "/scenes/my%20room/locate" and query == {"text": "red mug"}
        body = json.dumps({"matches": [{"center": [1.0, 2.0, 3.0]}]} if known else {}).encode()
        status = 200
        if self.path == "/scenes/my%20room/views":
            taken = self.headers["authorization"] == "Bearer secret"
            status, body = (202, b"{}") if taken else (401, b'{"error": "give the key"}')
            self.views.extend([query] if taken else [])
        self.send_response(status)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def ros(monkeypatch):
    """The few names of rclpy and its messages that the node uses; published: what it has sent."""
    published: list[SimpleNamespace] = []

    class Node:
        def __init__(self, name: str) -> None:
            self.parameters, self.errors = {}, []

        def declare_parameter(self, name, usual):
            self.parameters[name] = usual

        def get_parameter(self, name):
            return SimpleNamespace(value=self.parameters[name])

        def create_publisher(self, kind, topic, depth):
            return SimpleNamespace(publish=published.append)

        def create_subscription(self, kind, topic, callback, depth):
            pass

        def get_clock(self):
            return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))

        def get_logger(self):
            return SimpleNamespace(error=self.errors.append)

    class Buffer:
        def lookup_transform(self, target, source, stamp):
            if (target, source) != ("camera_optical", "map"):
                raise TransformException(f"no transform from {source} to {target}")
            return SimpleNamespace(transform=self.placed)

    class TransformException(Exception):
        pass

    def pose_array(poses):
        return SimpleNamespace(poses=poses, header=SimpleNamespace())

    names = {
        "rclpy": {}, "rclpy.node": {"Node": Node}, "std_msgs": {}, "std_msgs.msg": {"String": SimpleNamespace},
        "sensor_msgs": {}, "sensor_msgs.msg": {"CameraInfo": SimpleNamespace, "CompressedImage": SimpleNamespace},
        "tf2_ros": {
            "Buffer": Buffer, "TransformException": TransformException, "TransformListener": lambda *_: None,
        },
        "geometry_msgs": {},
        "geometry_msgs.msg": {"Point": SimpleNamespace, "Pose": SimpleNamespace, "PoseArray": pose_array},
    }  # fmt: skip
    for name, content in names.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return published


@contextmanager
def robot() -> Iterator[Any]:
    """The node, at a service that is there."""
    service = HTTPServer(("127.0.0.1", 0), Service)
    threading.Thread(target=service.serve_forever, daemon=True).start()
    try:
        node = runpy.run_path(str(NEIGHBOURS / "ros2_node.py"))["Robot"]()
        node.parameters |= {"address": f"http://127.0.0.1:{service.server_port}", "scene": "my room"}
        yield node
    finally:
        service.shutdown()
        service.server_close()


def test_a_robot_is_told_places_over_http(ros):
    with robot() as node:
        node.answer(SimpleNamespace(data="red mug"))
        node.answer(SimpleNamespace(data="something else"))
    assert [vars(pose.position) for pose in ros[0].poses] == [{"x": 1.0, "y": 2.0, "z": 3.0}]
    assert (ros[0].header.frame_id, ros[0].header.stamp) == ("map", "now")
    assert len(ros) == len(node.errors) == 1


def photo_of(view: ds.View, seconds: int, frame: str = "camera_optical", form: str = "jpeg") -> SimpleNamespace:
    stamp = SimpleNamespace(sec=seconds, nanosec=5)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=frame), data=view.image_path.read_bytes(), format=form
    )


def test_a_robot_sends_what_it_sees(ros, toy):
    """What it sends is what `POST /scenes/{scene}/views` takes, with the pose and lens of the camera."""
    view = ds.read_views(toy / "capture")[0]
    x, y, z, w = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat()
    shift = view.cam_from_world[:3, 3]
    Service.views.clear()
    with robot() as node:
        node.send(photo_of(view, 1))  # without a lens
        node.use_lens(SimpleNamespace(distortion_model="plumb_bob", d=[0, 0, 0, 0, 0.1]))
        node.use_lens(SimpleNamespace(distortion_model="equidistant", d=[]))
        K = np.diag([2.0, 2.0, 1.0]) @ view.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]  # counted from the middle
        camera = {"k": K.ravel().tolist(), "d": [0.1, 0.0, 0.0, 0.02, 0.0], "width": 2 * WIDTH, "height": 2 * HEIGHT}
        node.use_lens(SimpleNamespace(distortion_model="plumb_bob", **camera))
        node.transforms.placed = SimpleNamespace(
            rotation=SimpleNamespace(x=x, y=y, z=z, w=w),
            translation=SimpleNamespace(x=shift[0], y=shift[1], z=shift[2]),
        )
        node.send(photo_of(view, 2))  # without a key
        node.parameters["key"] = "secret"
        node.send(photo_of(view, 3, frame="elsewhere"))
        node.send(photo_of(view, 4, form="rgb8; png compressed"))
        node.parameters["every"] = 10.0
        node.send(photo_of(view, 5))
    assert [text.partition(":")[2] or text for text in node.errors] == [
        " send rectified images", " send rectified images", " give the key",
        " TransformException('no transform from map to elsewhere')",
    ]  # fmt: skip
    pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
    from drsplat.fronts.serving.live import NewView

    (body,) = Service.views
    taken = NewView(**body)
    pose, lens = (one.model_dump(exclude_none=True) for one in (taken.pose, taken.lens))
    found = posed(LiveView(taken.name, pose, lens, None, False, "", 1.0), (WIDTH, HEIGHT))
    assert (live_name(taken.name), base64.b64decode(taken.picture)) == (
        "robot/4_000000005.png", view.image_path.read_bytes(),
    )  # fmt: skip
    np.testing.assert_allclose(found.cam_from_world, view.cam_from_world, atol=1e-12)
    np.testing.assert_allclose(found.K, view.K, atol=1e-12)
    assert found.distortion == (0.1, 0.0, 0.0, 0.02)
