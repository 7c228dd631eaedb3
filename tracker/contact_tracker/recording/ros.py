"""From ROS 2 messages to observed poses: where each message type keeps stamp, frames and pose."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from io import StringIO
from types import MappingProxyType
from typing import Any, Final

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from contact_tracker.motion.poses import Pose
from contact_tracker.recording.bytestream import ZSTD_MAGIC
from contact_tracker.recording.items import PARSE_ERRORS, Channel, RawMessage, inflate_zstd
from contact_tracker.recording.layouts import Layouts, Observation, ObservedColumns
from contact_tracker.recording.limits import TooMuchWork, WorkBudget

MESSAGE_LIMIT: Final = 2**22
BYTES_PER_RECORD: Final = 128
"""So many bytes of a message are as much work as a record."""


class Undecodable(Exception):
    """A message that is not what its schema promises."""


class RosDecoder:
    """Decodes CDR messages by their ros2msg schema; keeps one decoder per channel.

    Parameters
    ----------
    budget : of the recording; messages that are larger than it explains are not decoded.
    """

    def __init__(self, budget: WorkBudget | None = None) -> None:
        self._budget = budget
        self._decoders: dict[Channel, Callable[[bytes], Any] | None] = {}
        self._layouts: dict[Channel, Layouts] = {}
        self._current: Channel | None = None
        self._known = Layouts("")

    def decode(self, message: RawMessage) -> Any:
        """The message as an object with attributes; raises Undecodable."""
        channel, _, data = message
        try:
            try:
                decoder = self._decoders[channel]
            except KeyError:
                decoder = self._decoders[channel] = _decoder_of(channel)
            if decoder is None:
                raise Undecodable(f"{channel.topic}: the schema of {channel.type} cannot be used")
            if data.startswith(ZSTD_MAGIC):
                data = inflate_zstd(data, MESSAGE_LIMIT)
            self._count_work(message, len(data) // BYTES_PER_RECORD)
            return decoder(data)
        except (*PARSE_ERRORS, TypeError, AttributeError) as error:
            raise Undecodable(f"{channel.topic}: {error}") from error

    def _count_work(self, message: RawMessage, records: int) -> None:
        """Count the work beyond that of one record; raises Undecodable where the file does not explain it."""
        if records and self._budget is not None:
            try:
                self._budget.count_records(records)
            except TooMuchWork as error:
                raise Undecodable(f"{message.channel.topic}: {error}") from error

    def observe(self, message: RawMessage) -> list[Observation]:
        """The poses in a message of one of POSE_TYPES; raises Undecodable."""
        channel = message.channel
        if channel is not self._current:  # hashing one takes longer than reading a pose
            self._current, self._known = channel, self._layouts.setdefault(channel, Layouts(channel.type))
        observations = self._known.read(message.data)
        if observations is not None:
            self._count_work(message, len(observations) - 1)
            return observations
        observations = self._observe(message)
        with suppress(Undecodable):
            self._known.learn(message.data, lambda data: self._observe(message._replace(data=data)))
        return observations

    def observe_all(self, messages: Sequence[RawMessage]) -> ObservedColumns | None:
        """The poses in messages of one channel, if they are of one source and of a layout that is known."""
        known = self._layouts.get(messages[0].channel)
        return None if known is None else known.read_all([message.data for message in messages])

    def _observe(self, message: RawMessage) -> list[Observation]:
        """The same by the library's decoder."""
        decoded = self.decode(message)
        try:
            return POSE_TYPES[message.channel.type](decoded)
        except (AttributeError, TypeError, ValueError) as error:
            raise Undecodable(f"{message.channel.topic}: {error}") from error


def is_ros2(channel: Channel) -> bool:
    return channel.encoding == "cdr" and channel.schema_encoding == "ros2msg"


def _decoder_of(channel: Channel) -> Callable[[bytes], Any] | None:
    """The decoder for a channel; None if its schema is unusable."""
    schema = Schema(id=1, name=channel.type, encoding=channel.schema_encoding, data=channel.schema)
    try:
        with redirect_stderr(StringIO()):  # the parser prints what it then raises
            return DecoderFactory().decoder_for(channel.encoding, schema)
    except Exception:  # it raises whatever the text leads it to
        return None


def _pose(header: Any, position: Any, orientation: Any) -> Pose:
    stamp = header.stamp
    return Pose(
        stamp.sec * 1_000_000_000 + stamp.nanosec,
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
    )


def _pose_stamped(m: Any) -> list[Observation]:
    return [Observation(m.header.frame_id, "", _pose(m.header, m.pose.position, m.pose.orientation))]


def _pose_with_covariance(m: Any) -> list[Observation]:
    pose = m.pose.pose
    return [Observation(m.header.frame_id, "", _pose(m.header, pose.position, pose.orientation))]


def _odometry(m: Any) -> list[Observation]:
    pose = _pose(m.header, m.pose.pose.position, m.pose.pose.orientation)
    return [Observation(m.header.frame_id, m.child_frame_id, pose)]


def _transform(m: Any) -> list[Observation]:
    pose = _pose(m.header, m.transform.translation, m.transform.rotation)
    return [Observation(m.header.frame_id, m.child_frame_id, pose)]


def _transforms(m: Any) -> list[Observation]:
    return [observation for transform in m.transforms for observation in _transform(transform)]


POSE_TYPES: Final[Mapping[str, Callable[[Any], list[Observation]]]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _pose_stamped,
        "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
        "geometry_msgs/msg/TransformStamped": _transform,
        "nav_msgs/msg/Odometry": _odometry,
        "tf2_msgs/msg/TFMessage": _transforms,
    }
)
