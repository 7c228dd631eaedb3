"""Where poses are in messages: paths of fields, of known types and as users name them (``--field``).

A path is names of fields with dots between, ``detections.results[0]``; all elements of a list are meant where
none is. It leads to a position and rotation, or to what holds these in a field ``pose`` or ``transform``. The
stamp, the frame and the name of the body are those of the message or the part of it next to the pose that has
one. Where there are several without a name, their number is the child frame: ``0`` is the first pose of a
PoseArray. The stamp of a type without one is zero, like an unset stamp.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import islice
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final

from contact_tracker.motion.poses import Pose
from contact_tracker.recording.definitions import canonical, parse_definition
from contact_tracker.recording.items import Channel

SECOND_NS: Final = 1_000_000_000
_MOST_NS: Final = 2**63 - 1
"""Stands for later stamps; the pose gate rejects it."""
_SECONDS: Final = ("sec", "seconds", "secs")
_FRACTIONS: Final = ("nanosec", "nsec", "nanos", "nsecs")
_ADDED: Final = 0
"""The action of a marker that is shown; the others delete it."""
_STAMPS: Final = ("header.stamp", "timestamp", "stamp")
_FRAMES: Final = ("header.frame_id", "frame_id", "parent_frame_id")
_NAMES: Final = ("child_frame_id", "rigid_body_name", "name")
_NAMES_IN_LISTS: Final = (*_NAMES, "hypothesis.class_id", "id")
_PARTS: Final = {"position": "orientation", "translation": "rotation"}
_HOLDERS: Final = ("pose", "transform")
_DEEPEST: Final = 3
"""Most such fields in each other."""
_FOXGLOVE: Final = {
    "PoseInFrame": "",
    "PosesInFrame": "poses",
    "FrameTransform": "",
    "FrameTransforms": "transforms",
}
POSE_TYPES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": "",
        "geometry_msgs/msg/PoseWithCovarianceStamped": "",
        "geometry_msgs/msg/TransformStamped": "",
        "nav_msgs/msg/Odometry": "",
        "tf2_msgs/msg/TFMessage": "transforms",
        "tf/msg/tfMessage": "transforms",
        "geometry_msgs/msg/Pose": "",
        "geometry_msgs/msg/PoseArray": "poses",
        "visualization_msgs/msg/Marker": "",
        "visualization_msgs/msg/MarkerArray": "markers",
        "vision_msgs/msg/Detection3DArray": "detections.results[0]",
        "gazebo_msgs/msg/ModelStates": "pose",
        "motion_capture_tracking_interfaces/msg/NamedPoseArray": "poses",
        "mocap4r2_msgs/msg/RigidBodies": "rigidbodies",
        **{f"foxglove.{name}": path for name, path in _FOXGLOVE.items()},
        **{f"foxglove_msgs/msg/{name}": path for name, path in _FOXGLOVE.items()},
    }
)
"""The path to the poses in each known type."""
_MOST_FIELDS: Final = 500
"""Fields of a definition that are looked at for poses."""


def pose_field(channel: Channel, field: str | None = None) -> str | None:
    """The path to the poses in a channel's messages, None if these have none; ``field`` is that of the user,
    whose names are looked up in the text of the definition."""
    if field is None:
        return POSE_TYPES.get(canonical(channel.type))
    names = [*re.findall(r"[A-Za-z_]\w*", field), "(position|translation)"]
    has_names = all(re.search(rf"\b{name}\b".encode(), channel.schema) for name in names)
    return field if has_names or channel.encoding == "json" else None


def fields_with_poses(channel: Channel) -> list[str]:
    """Paths of poses in the messages of a channel of ROS, by their definition."""
    try:
        definition = parse_definition(channel.schema.decode(errors="replace"), channel.type)
    except (ValueError, KeyError):
        return []
    found, waiting = list[str](), [("", definition.type)]
    for path, kind in waiting:  # which grows
        fields = definition.fields.get(kind, ())
        names = {field.name for field in fields}
        if any(names.issuperset(parts) for parts in _PARTS.items()):
            found.append(path or ".")
        elif len(waiting) < _MOST_FIELDS:
            waiting += [(f"{path}.{field.name}".lstrip("."), field.type) for field in fields]
    return found


def poses_at(path: str, message: Any) -> Iterator[tuple[str, str, Pose] | None]:
    """Frame, child frame and pose of each pose at a path in a decoded message, whichever library decoded it;
    None for an element without one. Unexpected attributes and values can raise any error."""
    seen = set[tuple[str, str, int]]()
    for inside, number in _reached((message,), re.findall(r"(\w+)(?:\[(\d+)\])?", path), ""):
        is_deleted = any(hasattr(part, "ns") and getattr(part, "action", _ADDED) != _ADDED for part in inside)
        if not inside or is_deleted:
            yield None
            continue
        for _ in range(_DEEPEST):
            holder = next((name for name in _HOLDERS if hasattr(inside[-1], name)), None)
            inside = inside if holder is None else (*inside, getattr(inside[-1], holder))
        pose = inside[-1]
        place = next((name for name in _PARTS if hasattr(pose, name)), "position")
        px, py, pz = map(float, _xyz(getattr(pose, place)))
        turn = getattr(pose, _PARTS[place])
        x, y, z, w = map(float, (*_xyz(turn), turn.w))
        stamps = (one for one in _nearest(inside, _STAMPS) if not isinstance(one, int | float | str))
        stamp_ns = next(filter(None, map(_stamp_ns, stamps)), 0)
        frame = next(filter(None, _nearest(inside, _FRAMES)), "")
        if not isinstance(frame, str):
            raise TypeError("the name of a frame is no text")
        child = _child(inside, number)
        child = f"{child}#{number}" if (frame, child, stamp_ns) in seen else child  # a second cup
        seen.add((frame, child, stamp_ns))
        yield frame, child, Pose(stamp_ns, (px, py, pz), (x, y, z, w))


def _reached(
    inside: tuple[Any, ...], steps: list[tuple[str, str]], number: str
) -> Iterator[tuple[tuple[Any, ...], str]]:
    """What is at the end of a path, after all that it is part of; and its name or number, if there are
    several. Nothing if a list has no such element."""
    if not steps:
        yield inside, number
        return
    (name, index), *rest = steps
    value = getattr(inside[-1], name)
    if not hasattr(value, "__len__"):
        yield from _reached((*inside, value), rest, number)
    elif not index:
        names: Any = getattr(inside[-1], "name", None)
        has_names = hasattr(names, "__len__") and not isinstance(names, str) and len(names) == len(value)
        for i, one in enumerate(value):
            yield from _reached((*inside, one), rest, str(names[i] if has_names else i))
    elif int(index) < len(value):
        yield from _reached((*inside, value[int(index)]), rest, number)
    else:
        yield (), ""


def _nearest(inside: tuple[Any, ...], names: tuple[str, ...]) -> Iterator[Any]:
    """The fields of any of these names, that of the innermost part first."""
    for part in reversed(inside):
        for name in names:
            with suppress(AttributeError):
                yield attrgetter(name)(part)


def _child(inside: tuple[Any, ...], number: str) -> str:
    """The name of the body, of a marker ``ns/id``; its number where it has no name."""
    found = list[str]()
    for part in reversed(inside):
        if hasattr(part, "ns") and hasattr(part, "id"):
            found.append(f"{part.ns}/{part.id}")
            continue
        names = _NAMES_IN_LISTS if number and part is not inside[0] else _NAMES
        texts = (one for one in _nearest((part,), names) if isinstance(one, str | int) and one != "")
        found += [str(one) for one in islice(texts, 1)]
    return "/".join(found) or number


def _xyz(vector: Any) -> tuple[Any, Any, Any]:
    return vector.x, vector.y, vector.z


def _stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a time of ROS, protobuf or JSON."""
    seconds, fraction = (
        [getattr(stamp, name) for name in names if hasattr(stamp, name)] for names in (_SECONDS, _FRACTIONS)
    )
    return max(min(int(seconds[0]) * SECOND_NS + int(fraction[0]), _MOST_NS), -_MOST_NS)
