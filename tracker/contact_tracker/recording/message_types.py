"""Stamps, frames and poses of decoded messages by type, whichever library decoded them.

In messages with several poses without frames of their own, the child frame is the name or index of each:
``0`` is the first pose of a PoseArray. The stamp of a type without one is zero, like an unset stamp.
"""

from collections.abc import Callable, Iterable, Mapping, Sized
from types import MappingProxyType
from typing import Any, Final

from contact_tracker.motion.poses import Pose
from contact_tracker.recording.layouts import Observation

Reader = Callable[[Any], list[Observation]]
_SECOND: Final = 1_000_000_000
_MOST_NS: Final = 2**63 - 1
"""Stands for later stamps; the pose gate rejects it."""
_FRACTIONS: Final = ("nanosec", "nsec", "nanos", "nsecs")
_REPEATED: Final = ("transforms", "poses", "markers", "rigidbodies")
"""Fields with several poses."""
_ADDED: Final = 0
"""The action of a marker that is shown; the others delete it."""


def canonical(type_name: str) -> str:
    """The name of a ROS type with ``/msg/``, which ROS 1 and some writers omit."""
    package, slash, name = type_name.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else type_name


def _pose(header: Any, position: Any, orientation: Any) -> Pose:
    stamp = header.stamp
    return Pose(
        stamp.sec * _SECOND + stamp.nanosec if hasattr(stamp, "nanosec") else _stamp_ns(stamp),
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
    )


def _stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a time of ROS, protobuf or JSON."""
    seconds = next(getattr(stamp, name) for name in ("sec", "seconds", "secs") if hasattr(stamp, name))
    fraction = next(getattr(stamp, name) for name in _FRACTIONS if hasattr(stamp, name))
    stamp_ns = int(seconds) * _SECOND + int(fraction)
    return max(min(stamp_ns, _MOST_NS), -_MOST_NS)


def _at(stamp_ns: int, pose: Any) -> Pose:
    p, q = pose.position, pose.orientation
    return Pose(stamp_ns, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def _pose_stamped(m: Any) -> list[Observation]:
    return [Observation(m.header.frame_id, "", _pose(m.header, m.pose.position, m.pose.orientation))]


def _pose_with_covariance(m: Any) -> list[Observation]:
    pose = m.pose.pose
    return [Observation(m.header.frame_id, "", _pose(m.header, pose.position, pose.orientation))]


def _bare_pose(m: Any) -> list[Observation]:
    return [Observation("", "", _at(0, m))]


def _odometry(m: Any) -> list[Observation]:
    pose = _pose(m.header, m.pose.pose.position, m.pose.pose.orientation)
    return [Observation(m.header.frame_id, m.child_frame_id, pose)]


def _transform(m: Any) -> list[Observation]:
    pose = _pose(m.header, m.transform.translation, m.transform.rotation)
    return [Observation(m.header.frame_id, m.child_frame_id, pose)]


def _transforms(m: Any) -> list[Observation]:
    return [observation for transform in m.transforms for observation in _transform(transform)]


def _named(header: Any, poses: Iterable[tuple[str, Any]]) -> list[Observation]:
    stamp_ns = _stamp_ns(header.stamp)
    return [Observation(header.frame_id, name, _at(stamp_ns, pose)) for name, pose in poses]


def _pose_array(m: Any) -> list[Observation]:
    return _named(m.header, ((str(i), pose) for i, pose in enumerate(m.poses)))


def _named_poses(m: Any) -> list[Observation]:
    return _named(m.header, ((one.name, one.pose) for one in m.poses))


def _rigid_bodies(m: Any) -> list[Observation]:
    return _named(m.header, ((one.rigid_body_name, one.pose) for one in m.rigidbodies))


def _marker(m: Any) -> list[Observation]:
    if m.action != _ADDED:
        return []
    return _named(m.header, [(f"{m.ns}/{m.id}", m.pose)])


def _markers(m: Any) -> list[Observation]:
    return [observation for marker in m.markers for observation in _marker(marker)]


def _pose_in_frame(m: Any) -> list[Observation]:
    return [Observation(m.frame_id, "", _at(_stamp_ns(m.timestamp), m.pose))]


def _poses_in_frame(m: Any) -> list[Observation]:
    stamp_ns = _stamp_ns(m.timestamp)
    return [Observation(m.frame_id, str(i), _at(stamp_ns, pose)) for i, pose in enumerate(m.poses)]


def _frame_transform(m: Any) -> list[Observation]:
    t, q = m.translation, m.rotation
    pose = Pose(_stamp_ns(m.timestamp), (t.x, t.y, t.z), (q.x, q.y, q.z, q.w))
    return [Observation(m.parent_frame_id, m.child_frame_id, pose)]


def _frame_transforms(m: Any) -> list[Observation]:
    return [observation for transform in m.transforms for observation in _frame_transform(transform)]


_FOXGLOVE: Final[Mapping[str, Reader]] = {
    "PoseInFrame": _pose_in_frame,
    "PosesInFrame": _poses_in_frame,
    "FrameTransform": _frame_transform,
    "FrameTransforms": _frame_transforms,
}
POSE_TYPES: Final[Mapping[str, Reader]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _pose_stamped,
        "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
        "geometry_msgs/msg/TransformStamped": _transform,
        "nav_msgs/msg/Odometry": _odometry,
        "tf2_msgs/msg/TFMessage": _transforms,
        "tf/msg/tfMessage": _transforms,
        "geometry_msgs/msg/Pose": _bare_pose,
        "geometry_msgs/msg/PoseArray": _pose_array,
        "visualization_msgs/msg/Marker": _marker,
        "visualization_msgs/msg/MarkerArray": _markers,
        "motion_capture_tracking_interfaces/msg/NamedPoseArray": _named_poses,
        "mocap4r2_msgs/msg/RigidBodies": _rigid_bodies,
        **{f"foxglove.{name}": reader for name, reader in _FOXGLOVE.items()},
        **{f"foxglove_msgs/msg/{name}": reader for name, reader in _FOXGLOVE.items()},
    }
)
USUAL: Final = (
    "PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry, TFMessage, PoseArray, "
    "foxglove.PoseInFrame and foxglove.FrameTransform"
)


def is_pose_type(type_name: str) -> bool:
    """Whether messages of this type have poses."""
    return canonical(type_name) in POSE_TYPES


def observations(type_name: str, decoded: Any) -> list[Observation]:
    """The poses in a decoded message of a pose type; unexpected attributes can raise any error."""
    return POSE_TYPES[canonical(type_name)](decoded)


def number_of_poses(decoded: Any) -> int:
    """The number of poses in a decoded message of several, whose elements can be as small as two bytes."""
    values = (getattr(decoded, name, None) for name in _REPEATED)
    return sum(len(value) for value in values if isinstance(value, Sized))


def typed(found: list[Observation]) -> list[Observation]:
    """Check the types of poses from JSON, whose values can be of any type; raises TypeError."""
    for frame_id, child_frame_id, _ in found:
        if not (isinstance(frame_id, str) and isinstance(child_frame_id, str)):
            raise TypeError("a name of a frame is no text")
    return [
        Observation(
            frame_id,
            child_frame_id,
            Pose(
                max(min(int(pose.stamp_ns), _MOST_NS), -_MOST_NS),
                _three(*map(float, pose.position_m)),
                _four(*map(float, pose.quat_xyzw)),
            ),
        )
        for frame_id, child_frame_id, pose in found
    ]


def _three(x: float, y: float, z: float) -> tuple[float, float, float]:
    return x, y, z


def _four(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    return x, y, z, w
