"""A ROS 2 node that sends what a robot sees to a `drsplat serve`, and answers words with places.

Of image (sensor_msgs/CompressedImage) one in `every` seconds is sent, with the lens of camera_info (sensor_msgs/
CameraInfo) and the camera's pose in `frame`, the world of the scene, as tf2 knows it.
/drsplat/query (std_msgs/String) -> /drsplat/matches (geometry_msgs/PoseArray), best first, in `frame`.
Usage: python3 ros2_node.py --ros-args -p address:=http://10.0.0.5:8765 -p key:=KEY -p scene:=room -p frame:=map
"""

import base64
import json
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

import rclpy
from geometry_msgs.msg import Point, Pose, PoseArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_msgs.msg import String
from tf2_ros import Buffer, TransformException, TransformListener

DEFAULTS = {"address": "http://127.0.0.1:8765", "key": "", "scene": "drsplat-demo", "frame": "map", "every": 1.0}


class Robot(Node):
    def __init__(self) -> None:
        super().__init__("drsplat")
        for name, value in DEFAULTS.items():
            self.declare_parameter(name, value)
        self.lens, self.last = None, 0.0
        self.transforms = Buffer()
        self.listener = TransformListener(self.transforms, self)
        self.matches = self.create_publisher(PoseArray, "drsplat/matches", 10)
        self.create_subscription(CameraInfo, "camera_info", self.use_lens, 1)
        self.create_subscription(CompressedImage, "image", self.send, 1)
        self.create_subscription(String, "drsplat/query", self.answer, 10)

    def use_lens(self, camera: CameraInfo) -> None:
        k1, k2, p1, p2, *more = [*camera.d, 0.0, 0.0, 0.0, 0.0][: max(4, len(camera.d))]
        if camera.distortion_model not in ("", "plumb_bob") or any(more):
            self.get_logger().error("this lens has terms beyond k1, k2, p1, p2: send rectified images")
            return
        cx, cy = camera.k[2] + 0.5, camera.k[5] + 0.5  # ROS counts from the middle of the first pixel
        self.lens = {"fx": camera.k[0], "fy": camera.k[4], "cx": cx, "cy": cy}
        self.lens |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2, "width": camera.width, "height": camera.height}

    def send(self, image: CompressedImage) -> None:
        stamp = image.header.stamp
        now = stamp.sec + stamp.nanosec / 1e9
        if self.lens is None or now < self.last + self.value("every"):
            return
        try:
            placed = self.transforms.lookup_transform(image.header.frame_id, self.value("frame"), stamp).transform
            self.post("views", self.view_of(image, placed))
            self.last = now
        except (TransformException, HTTPError, URLError) as error:
            self.get_logger().error(f"photo not sent: {reason(error)}")  # the next one may be

    def view_of(self, image: CompressedImage, placed) -> dict:
        """Describe a photo. placed: the transform from the scene's world to the camera's optical frame."""
        stamp, turn, shift = image.header.stamp, placed.rotation, placed.translation
        return {
            "name": f"robot/{stamp.sec}_{stamp.nanosec:09d}.{'png' if 'png' in image.format else 'jpg'}",
            "picture": base64.b64encode(bytes(image.data)).decode(),
            "pose": {"quaternion": [turn.w, turn.x, turn.y, turn.z], "translation": [shift.x, shift.y, shift.z]},
            "lens": self.lens,
        }

    def answer(self, query: String) -> None:
        try:
            centers = [match["center"] for match in self.post("locate", {"text": query.data})["matches"]]
        except (URLError, KeyError) as error:
            self.get_logger().error(f"'{query.data}': {reason(error)}")
            return
        found = PoseArray(poses=[Pose(position=Point(x=x, y=y, z=z)) for x, y, z in centers])
        found.header.frame_id = self.value("frame")
        found.header.stamp = self.get_clock().now().to_msg()
        self.matches.publish(found)

    def post(self, route: str, body: dict) -> dict:
        address = f"{self.value('address')}/scenes/{quote(self.value('scene'))}/{route}"
        headers = {"content-type": "application/json"}
        if self.value("key"):
            headers["authorization"] = f"Bearer {self.value('key')}"
        with urlopen(Request(address, json.dumps(body).encode(), headers), timeout=30) as reply:
            return dict(json.load(reply))

    def value(self, name: str):
        return self.get_parameter(name).value


def reason(error: Exception) -> str:
    """Return what the service said of a refusal, or the error."""
    return json.load(error)["error"] if isinstance(error, HTTPError) else repr(error)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Robot())
