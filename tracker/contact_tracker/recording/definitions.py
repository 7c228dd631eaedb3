"""Definitions of ROS 2 pose messages, for channels that name their type without defining it."""

import re
from typing import Final

_RULE: Final = "=" * 80
_PART: Final = re.compile(r"^MSG:\s*(\S+)", re.MULTILINE)
_USED: Final = re.compile(r"^[ \t]*([A-Za-z][\w/]*)(?:\[[^\]\n]*\])?[ \t]+[A-Za-z]", re.MULTILINE)
_HEADER: Final = "std_msgs/Header header\n"
_POSES: Final = "geometry_msgs/Pose[] poses\n"
_PARTS: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": f"{_HEADER}string child_frame_id\ngeometry_msgs/Transform transform\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "motion_capture_tracking_interfaces/NamedPose": "string name\ngeometry_msgs/Pose pose\n",
}
_TYPES: Final = {
    "geometry_msgs/msg/PoseStamped": f"{_HEADER}geometry_msgs/Pose pose\n",
    "geometry_msgs/msg/PoseWithCovarianceStamped": f"{_HEADER}geometry_msgs/PoseWithCovariance pose\n",
    "geometry_msgs/msg/TransformStamped": _PARTS["geometry_msgs/TransformStamped"],
    "nav_msgs/msg/Odometry": f"{_HEADER}string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "geometry_msgs/msg/Pose": _PARTS["geometry_msgs/Pose"],
    "geometry_msgs/msg/PoseArray": _HEADER + _POSES,
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": f"{_HEADER}"
    "motion_capture_tracking_interfaces/NamedPose[] poses\n",
}


def definition_of(type_name: str) -> str | None:
    """The text of a message definition with all nested types; None for an unknown type."""
    text = _TYPES.get(type_name)
    return None if text is None else completed(text)


def is_complete(text: str) -> bool:
    """Whether a definition contains all nested types that are known here."""
    there = {name.replace("/msg/", "/") for name in _PART.findall(text)} | {"builtin_interfaces/Time"}
    short = {name.rpartition("/")[2] for name in there}
    used = {name.replace("/msg/", "/") for name in _USED.findall(text)}
    missing = _PARTS.keys() - there
    return not any(name in used or (name.rpartition("/")[2] in used - short) for name in missing)


def completed(text: str) -> str:
    """A definition with the known nested types that it lacks."""
    there = set(_PART.findall(text))
    return text + "".join(
        f"\n{_RULE}\nMSG: {part}\n{body}" for part, body in _PARTS.items() if part not in there
    )
