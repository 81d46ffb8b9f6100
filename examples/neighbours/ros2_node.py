"""A ROS 2 node that answers words with places, by a `drsplat serve` that runs anywhere.

/drsplat/query (std_msgs/String) -> /drsplat/matches (geometry_msgs/PoseArray), best first, in the frame `frame`.
Usage: python3 ros2_node.py --ros-args -p address:=http://127.0.0.1:8765 -p scene:=room -p frame:=map
"""

import json
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

import rclpy
from geometry_msgs.msg import Point, Pose, PoseArray
from rclpy.node import Node
from std_msgs.msg import String


class Answers(Node):
    def __init__(self) -> None:
        super().__init__("drsplat")
        for name, usual in (("address", "http://127.0.0.1:8765"), ("scene", "drsplat-demo"), ("frame", "map")):
            self.declare_parameter(name, usual)
        self.matches = self.create_publisher(PoseArray, "drsplat/matches", 10)
        self.create_subscription(String, "drsplat/query", self.answer, 10)

    def answer(self, query: String) -> None:
        try:
            centers = [match["center"] for match in self.located(query.data)["matches"]]
        except (URLError, KeyError) as error:
            self.get_logger().error(f"'{query.data}': {error}")
            return
        found = PoseArray(poses=[Pose(position=Point(x=x, y=y, z=z)) for x, y, z in centers])
        found.header.frame_id = self.get_parameter("frame").value
        found.header.stamp = self.get_clock().now().to_msg()
        self.matches.publish(found)

    def located(self, text: str) -> dict:
        address, scene = (self.get_parameter(name).value for name in ("address", "scene"))
        body, kind = json.dumps({"text": text}).encode(), {"content-type": "application/json"}
        with urlopen(Request(f"{address}/scenes/{quote(scene)}/locate", body, kind), timeout=30) as reply:
            return dict(json.load(reply))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Answers())
