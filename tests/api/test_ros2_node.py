"""The ROS 2 node of the documentation, against a stand-in of the part of rclpy that it calls."""

import json
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from contact_tracker.states import STATES
from short_recordings import FACE_TO_EDGE, recorded

NODE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "ros2_node.py"


class Node:
    """As ``rclpy.node.Node``, but not run."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.name = name
        self.published: list[tuple[str, Any]] = []
        self.subscribed: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.warned: list[str] = []

    def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters.get(name, value))

    def create_publisher(self, kind: type, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any) -> None:
        self.subscribed[topic] = kind, callback

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.warned.append)

    def destroy_node(self) -> None:
        pass


class PoseStamped(SimpleNamespace):
    pass


class String(SimpleNamespace):
    pass


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": PoseStamped},
        "std_msgs": {},
        "std_msgs.msg": {"String": String},
    }
    for name, contents in modules.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)


def message(stamp_ns: int, position_m: Any, quat_xyzw: Any) -> PoseStamped:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return PoseStamped(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id="world"),
        pose=SimpleNamespace(
            position=SimpleNamespace(**dict(zip("xyz", position_m, strict=True))),
            orientation=SimpleNamespace(**dict(zip("xyzw", quat_xyzw, strict=True))),
        ),
    )


def test_poses_that_come_in_become_beliefs(ros: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Node, "parameters", {"topic": "/mocap/cube"})
    node = runpy.run_path(str(NODE))["ContactNode"]()
    ((topic, (kind, take_in)),) = node.subscribed.items()
    assert (topic, kind) == ("/mocap/cube", PoseStamped)
    poses = list(recorded(FACE_TO_EDGE).poses)
    for pose in poses:
        take_in(message(*pose))
    assert {topic for topic, _ in node.published} == {"~/belief"}
    beliefs = [json.loads(sent.data) for _, sent in node.published]
    assert len(beliefs) > 60
    assert poses[0].stamp_ns < beliefs[0]["stamp_ns"] <= beliefs[-1]["stamp_ns"] <= poses[-1].stamp_ns
    assert set(beliefs[0]["probability"]) == {state.value for state in STATES}
    assert [beliefs[30]["contact"], beliefs[-1]["contact"]] == ["f-f", "e-f"]
    assert len(node.warned) == len(set(node.warned))
