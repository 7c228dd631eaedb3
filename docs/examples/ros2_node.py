"""A ROS 2 node: poses in, beliefs out as JSON text.

Run it with ``python3 ros2_node.py --ros-args -p topic:=/object/pose``.
"""

import json

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String

import contact_tracker


class ContactNode(Node):
    """Follows the poses of ``topic`` and publishes on ``~/belief`` whenever a tick is complete."""

    def __init__(self) -> None:
        super().__init__("contact_tracker")
        topic = self.declare_parameter("topic", "/object/pose").value
        model = self.declare_parameter("model", "default").value
        lag_s = self.declare_parameter("lag_s", 0.0).value
        known = self.declare_parameter("known", "").value
        self._tracker = contact_tracker.Tracker(model=model, lag_s=lag_s, known=known or None)
        self._said: set[str] = set()
        self._beliefs = self.create_publisher(String, "~/belief", 10)
        self.create_subscription(PoseStamped, topic, self._take_in, qos_profile_sensor_data)

    def _take_in(self, message: PoseStamped) -> None:
        stamp, place, turn = message.header.stamp, message.pose.position, message.pose.orientation
        belief = self._tracker.update(
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            (place.x, place.y, place.z),
            (turn.x, turn.y, turn.z, turn.w),
        )
        if belief is None:
            return
        self._beliefs.publish(String(data=json.dumps(belief.to_json())))
        for warning in set(self._tracker.warnings) - self._said:
            self._said.add(warning)
            self.get_logger().warning(warning)


def main() -> None:
    """Spin until the node is stopped."""
    rclpy.init()
    node = ContactNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
