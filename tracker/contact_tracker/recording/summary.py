"""What a recording holds, as ``contact-tracker info`` shows it."""

from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from math import dist
from statistics import median
from typing import Final

from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose
from contact_tracker.recording.items import Attachment, Channel, Metadata, RawMessage
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.ros import POSE_TYPES, RosDecoder, Undecodable, is_ros2
from contact_tracker.recording.sources import PoseSource
from contact_tracker.recording.stamping import PREFIX_MESSAGES, PREFIX_NS, Logged, Stamping

SOURCES_KEPT: Final = 256
_SAMPLE: Final = 50_000
_MAD_TO_SIGMA: Final = 1.4826


@dataclass(frozen=True)
class SourceSummary:
    """One pose source; everything that needs poses is nan or None where too few of them are valid.

    Parameters
    ----------
    poses, observed : valid poses, and all that were published.
    first_ns, last_ns : stamps of the first and last valid pose.
    median_rate_hz, jitter_s : of the time between poses; jitter is its robust standard deviation.
    counts : what the gate dropped, repaired or noted, by kind (``gap`` and ``held`` among them).
    log_offset_s : median of log time minus header stamp.
    path_m, extent_m : length of the path of the body's origin, and its range along each world axis.
    sigma_position_m, sigma_rotation_rad : estimated sensor noise; for the caller to fill in.
    """

    source: PoseSource
    poses: int
    observed: int
    first_ns: int | None
    last_ns: int | None
    median_rate_hz: float
    jitter_s: float
    counts: Mapping[str, int]
    log_offset_s: float
    path_m: float
    extent_m: tuple[float, float, float]
    sigma_position_m: float | None = None
    sigma_rotation_rad: float | None = None

    @property
    def duration_s(self) -> float:
        if self.first_ns is None or self.last_ns is None:
            return float("nan")
        return (self.last_ns - self.first_ns) * 1e-9


@dataclass(frozen=True)
class RecordingSummary:
    """A whole recording.

    Parameters
    ----------
    sources : the pose sources, at most ``SOURCES_KEPT``, in the order of their names.
    topics : messages by (topic, type, encoding), of all topics.
    metadata : records by name. attachments : their names.
    undecodable : messages of pose topics that are not what their schema promises.
    damage : one line if it is truncated or damaged.
    """

    sources: tuple[SourceSummary, ...]
    topics: Mapping[tuple[str, str, str], int]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[str, ...]
    undecodable: int
    damage: str | None


def summarise(path: str) -> RecordingSummary:
    """Read a whole recording once, in bounded memory.

    Raises
    ------
    UnreadableRecording
        No such file, or not MCAP.
    """
    tallies: dict[PoseSource, _Tally] = {}
    topics: Counter[Channel] = Counter()
    metadata: dict[str, Mapping[str, str]] = {}
    attachments: list[str] = []
    decoder = RosDecoder()
    undecodable = 0
    reading = Reading(path, lambda channel: True)
    for item in reading:
        match item:
            case Metadata(name, values):
                metadata[name] = values
            case Attachment(name, _):
                attachments.append(name)
            case RawMessage(channel, _, _):
                topics[channel] += 1
                try:
                    _tally(tallies, decoder, item)
                except Undecodable:
                    undecodable += 1
    sources = tuple(tallies[source].summary(source) for source in sorted(tallies))
    by_topic: Counter[tuple[str, str, str]] = Counter()
    for channel, count in topics.items():
        by_topic[channel.topic, channel.type, channel.encoding] += count
    return RecordingSummary(sources, by_topic, metadata, tuple(attachments), undecodable, reading.damage)


def _tally(tallies: "dict[PoseSource, _Tally]", decoder: RosDecoder, message: RawMessage) -> None:
    channel = message.channel
    if channel.type not in POSE_TYPES or not is_ros2(channel):
        return
    for frame_id, child_frame_id, pose in decoder.observe(message):
        source = PoseSource(channel.topic, channel.type, frame_id, child_frame_id)
        tally = tallies.get(source)
        if tally is None and len(tallies) < SOURCES_KEPT:
            tally = tallies[source] = _Tally()
        if tally is not None:
            tally.add(pose, message.log_time_ns)


class _Sample:
    """An even sample of a stream of integers: when full, every second one goes, then every second comes."""

    def __init__(self) -> None:
        self.values = array("q")
        self._stride = 1
        self._seen = 0

    def add(self, value: int) -> None:
        if self._seen % self._stride == 0:
            if len(self.values) == _SAMPLE:
                self.values = self.values[::2]
                self._stride *= 2
            self.values.append(max(min(value, 2**63 - 1), -(2**63)))
        self._seen += 1


class _Tally:
    """Running figures of one source."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._gate = PoseGate(self.counts)
        self._observed = 0
        self._prefix: list[Logged] = []
        self._stamping: Stamping | None = None
        self._poses = 0
        self._first: Pose | None = None
        self._last: Pose | None = None
        self._steps_ns = _Sample()
        self._offsets_ns = _Sample()
        self._path_m = 0.0
        self._low_m = [float("inf")] * 3
        self._high_m = [float("-inf")] * 3

    def add(self, observed: Pose, log_time_ns: int) -> None:
        """Take in a pose; the first wait until there are enough to say which stamps they get."""
        self._observed += 1
        self._offsets_ns.add(log_time_ns - observed.stamp_ns)
        if self._stamping is not None:
            self._admit(self._stamping, observed, log_time_ns)
            return
        self._prefix.append((observed, log_time_ns))
        if len(self._prefix) == PREFIX_MESSAGES or log_time_ns - self._prefix[0][1] >= PREFIX_NS:
            self._admit_prefix()

    def _admit_prefix(self) -> None:
        self._stamping = Stamping(self._prefix)
        for observed, log_time_ns in self._prefix:
            self._admit(self._stamping, observed, log_time_ns)
        self._prefix = []

    def _admit(self, stamping: Stamping, observed: Pose, log_time_ns: int) -> None:
        if stamping.lacks_stamp(observed.stamp_ns, log_time_ns):
            self.counts["log_time_as_stamp"] += 1
            observed = observed._replace(stamp_ns=stamping.from_log_time(log_time_ns))
        for pose in self._gate.admit(observed):
            self._note(pose)

    def _note(self, pose: Pose) -> None:
        self._poses += 1
        if self._last is not None:
            self._steps_ns.add(pose.stamp_ns - self._last.stamp_ns)
            self._path_m += dist(pose.position_m, self._last.position_m)
        self._first = self._first or pose
        self._last = pose
        self._low_m = [min(pair) for pair in zip(self._low_m, pose.position_m, strict=True)]
        self._high_m = [max(pair) for pair in zip(self._high_m, pose.position_m, strict=True)]

    def summary(self, source: PoseSource) -> SourceSummary:
        if self._stamping is None:
            self._admit_prefix()
        for pose in self._gate.finish():
            self._note(pose)
        nan = float("nan")
        steps = self._steps_ns.values
        period_ns = median(steps) if steps else nan
        jitter_ns = _MAD_TO_SIGMA * median(abs(step - period_ns) for step in steps) if steps else nan
        x, y, z = map(float.__sub__, self._high_m, self._low_m) if self._poses else (nan, nan, nan)
        return SourceSummary(
            source=source,
            poses=self._poses,
            observed=self._observed,
            first_ns=self._first.stamp_ns if self._first else None,
            last_ns=self._last.stamp_ns if self._last else None,
            median_rate_hz=1e9 / period_ns,
            jitter_s=jitter_ns * 1e-9,
            counts=dict(self.counts),
            log_offset_s=median(self._offsets_ns.values) * 1e-9,
            path_m=self._path_m,
            extent_m=(x, y, z),
        )
