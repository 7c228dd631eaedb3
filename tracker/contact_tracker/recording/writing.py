"""Writing of labelled recordings: profile ros2, CDR, zstd chunks with indexes."""

import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Final

import numpy as np
from mcap.writer import Writer

from contact_tracker.atomic_file import accept_any, whole_file
from contact_tracker.ground_truth import UNSCORED, Truth
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording.annotations import TRUTH_ATTACHMENT, TRUTH_TOPIC, TRUTH_TYPE
from contact_tracker.recording.wrenches import WRENCH_TYPE
from contact_tracker.wrenches.wrenches import Wrenches

POSE_TOPIC: Final = "/object/pose"
POSE_TYPE: Final = "geometry_msgs/msg/PoseStamped"
WRENCH_TOPIC: Final = "/object/wrench"
METADATA_NAME: Final = "recording"
WORLD_FRAME: Final = "world"
_CHUNK_SIZE: Final = 128 * 1024
_LIBRARY: Final = "contact-tracker"

_RULE: Final = "=" * 80
_HEADER_SCHEMA: Final = f"""\
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_POSE_SCHEMA: Final = f"""\
std_msgs/Header header
geometry_msgs/Pose pose
{_RULE}
{_HEADER_SCHEMA}{_RULE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_RULE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_RULE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
_WRENCH_SCHEMA: Final = f"""\
std_msgs/Header header
geometry_msgs/Wrench wrench
{_RULE}
{_HEADER_SCHEMA}{_RULE}
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
{_RULE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
_CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
# CDR aligns to the size of each value, counted from after the 4-byte header: 18 bytes, then 6 of padding.
_POSE_CDR: Final = struct.Struct("<4siII6s6x7d")
_FRAME: Final = WORLD_FRAME.encode() + b"\0"
# An empty frame_id is the object's; 13 bytes, then 3 of padding.
_WRENCH_CDR: Final = struct.Struct("<4siIIs3x6d")


def write_recording(
    path: str,
    poses: Poses,
    truth: Truth | None,
    metadata: Mapping[str, str],
    check: Callable[[], None] = accept_any,
    wrenches: Wrenches | None = None,
) -> None:
    """Write a recording, whole or not at all; the same input gives the same bytes.

    Parameters
    ----------
    path : an existing file is replaced.
    poses : to ``/object/pose``, log time = header stamp; stamps from 0 to 2^31 s.
    truth : to ``/contact/truth`` at each change of contact, and as the attachment ``truth.json``.
    metadata : the metadata record ``recording``.
    check : of what is replaced, as of ``whole_file``.
    wrenches : of the hand on the object, to ``/object/wrench``; stamps as of ``poses``.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If a stamp cannot be represented.
    """
    for stamp_ns in (poses.stamp_ns, wrenches.stamp_ns if wrenches is not None else poses.stamp_ns):
        if len(stamp_ns) and not 0 <= int(stamp_ns.min()) <= int(stamp_ns.max()) < 2**31 * 10**9:
            raise ValueError("stamps of a recording lie between 0 and 2^31 s")
    with whole_file(Path(path), check) as temporary, temporary.open("wb") as file:
        _write(file, poses, truth, metadata, wrenches)


def _write(
    file: IO[bytes],
    poses: Poses,
    truth: Truth | None,
    metadata: Mapping[str, str],
    wrenches: Wrenches | None,
) -> None:
    writer = Writer(file, chunk_size=_CHUNK_SIZE)
    writer.start(profile="ros2", library=_LIBRARY)
    writer.add_metadata(METADATA_NAME, dict(metadata))
    pose_schema = writer.register_schema(POSE_TYPE, "ros2msg", _POSE_SCHEMA.encode())
    pose_channel = writer.register_channel(POSE_TOPIC, "cdr", pose_schema)
    changes: list[tuple[int, str]] = []
    truth_channel = 0
    if truth is not None:
        # Before the messages, so that a truncated or piped recording still has its truth.
        writer.add_attachment(0, 0, TRUTH_ATTACHMENT, "application/json", truth.to_json().encode())
        truth_schema = writer.register_schema(TRUTH_TYPE, "ros2msg", b"string data\n")
        truth_channel = writer.register_channel(TRUTH_TOPIC, "cdr", truth_schema)
        changes = list(_changes(truth))
    messages = [(stamp, truth_channel, _string_cdr(label)) for stamp, label in changes]
    messages += ((pose.stamp_ns, pose_channel, _pose_cdr(pose)) for pose in poses)
    if wrenches is not None:
        wrench_schema = writer.register_schema(WRENCH_TYPE, "ros2msg", _WRENCH_SCHEMA.encode())
        wrench_channel = writer.register_channel(WRENCH_TOPIC, "cdr", wrench_schema)
        messages += ((stamp, wrench_channel, data) for stamp, data in _wrench_cdrs(wrenches))
    messages.sort(key=lambda message: message[0])
    for stamp_ns, channel, data in messages:
        writer.add_message(channel, stamp_ns, data, stamp_ns)
    writer.finish()  # type: ignore[no-untyped-call]


def _changes(truth: Truth) -> Iterator[tuple[int, str]]:
    """Stamp and label wherever the label changes."""
    before = None
    for interval in truth.intervals:
        label = interval.contact.value if interval.contact else UNSCORED
        if label != before:
            yield interval.start_ns, label
        before = label


def _pose_cdr(pose: Pose) -> bytes:
    sec, nanosec = divmod(pose.stamp_ns, 1_000_000_000)
    numbers = (*pose.position_m, *pose.quat_xyzw)
    return _POSE_CDR.pack(_CDR_LITTLE_ENDIAN, sec, nanosec, len(_FRAME), _FRAME, *numbers)


def _wrench_cdrs(wrenches: Wrenches) -> Iterator[tuple[int, bytes]]:
    """Stamps and messages."""
    numbers = np.concatenate([wrenches.force_n, wrenches.moment_nm], axis=1).tolist()
    for stamp_ns, row in zip(wrenches.stamp_ns.tolist(), numbers, strict=True):
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        yield stamp_ns, _WRENCH_CDR.pack(_CDR_LITTLE_ENDIAN, sec, nanosec, 1, b"\0", *row)


def _string_cdr(text: str) -> bytes:
    data = text.encode() + b"\0"
    return _CDR_LITTLE_ENDIAN + struct.pack("<I", len(data)) + data
