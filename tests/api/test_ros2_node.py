"""The ROS 2 node of the documentation, against a stand-in of the part of rclpy that it calls."""

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from contact_tracker.states import STATES
from short_recordings import FACE_TO_EDGE, recorded

NODE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "ros2_node.py"


class Node:
    """As ``rclpy.node.Node``, but not run."""

    def __init__(self, name):
        self.published, self.subscribed, self.warned = [], {}, []

    def declare_parameter(self, name, value):
        return SimpleNamespace(value={"topic": "/mocap/cube"}.get(name, value))

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def create_subscription(self, kind, topic, callback, qos):
        self.subscribed[topic] = kind, callback

    def get_logger(self):
        return SimpleNamespace(warning=self.warned.append)


MODULES = {
    "rclpy": {},
    "rclpy.node": {"Node": Node},
    "rclpy.qos": {"qos_profile_sensor_data": object()},
    "geometry_msgs": {},
    "geometry_msgs.msg": {"PoseStamped": SimpleNamespace},
    "std_msgs": {},
    "std_msgs.msg": {"String": SimpleNamespace},
}


def message(stamp_ns: int, position_m: Any, quat_xyzw: Any) -> SimpleNamespace:
    stamp = SimpleNamespace(**dict(zip(("sec", "nanosec"), divmod(stamp_ns, 1_000_000_000), strict=True)))
    position = SimpleNamespace(**dict(zip("xyz", position_m, strict=True)))
    orientation = SimpleNamespace(**dict(zip("xyzw", quat_xyzw, strict=True)))
    pose = SimpleNamespace(position=position, orientation=orientation)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id="world"), pose=pose)


def test_poses_that_come_in_become_beliefs(monkeypatch) -> None:
    for name, contents in MODULES.items():
        vars(module := ModuleType(name)).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    node = runpy.run_path(str(NODE))["ContactNode"]()
    ((topic, (kind, take_in)),) = node.subscribed.items()
    assert (topic, kind) == ("/mocap/cube", SimpleNamespace)
    poses = list(recorded(FACE_TO_EDGE).poses[:1200:2])
    for pose in poses:
        take_in(message(*pose))
    assert {topic for topic, _ in node.published} == {"~/belief"}
    beliefs = [json.loads(sent.data) for _, sent in node.published]
    assert len(beliefs) > 50
    assert poses[0].stamp_ns < beliefs[0]["stamp_ns"] <= beliefs[-1]["stamp_ns"] <= poses[-1].stamp_ns
    assert set(beliefs[0]["probability"]) == {state.value for state in STATES}
    assert [beliefs[30]["contact"], beliefs[-1]["contact"]] == ["f-f", "e-f"]
    assert len(node.warned) == len(set(node.warned))
