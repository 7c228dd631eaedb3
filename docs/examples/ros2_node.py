"""A ROS 2 node: poses in, beliefs out as JSON text on ``~/belief`` whenever a tick is complete.

Run it with ``python3 ros2_node.py --ros-args -p topic:=/object/pose -p model:=default``.
"""

import json

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String

import contact_tracker


class ContactNode(Node):
    """Follows the poses of ``topic``; what has to be known is logged once."""

    def __init__(self) -> None:
        super().__init__("contact_tracker")
        topic, model = (self.declare_parameter(*p).value for p in (("topic", "/pose"), ("model", "default")))
        self._tracker, self._said = contact_tracker.Tracker(model), set[str]()
        self._beliefs = self.create_publisher(String, "~/belief", 10)
        self.create_subscription(PoseStamped, topic, self._take_in, qos_profile_sensor_data)

    def _take_in(self, message: PoseStamped) -> None:
        stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
        belief = self._tracker.update(
            stamp.sec * 10**9 + stamp.nanosec, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
        )
        if belief is None:
            return
        self._beliefs.publish(String(data=json.dumps(belief.to_json())))
        for warning in set(self._tracker.warnings) - self._said:
            self._said.add(warning)
            self.get_logger().warning(warning)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(ContactNode())
