"""Summary of a recording for ``contact-tracker info``."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.motion.pose_validation import PoseGate, remark_on_loss
from contact_tracker.motion.poses import BATCH, NO_POSES, Pose, Poses
from contact_tracker.recording.decoding import LoggedPose, assumption_text
from contact_tracker.recording.items import ROWS, Attachment, Item, Metadata, PoseSource, RawMessage, Rows
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.reading import Reading
from contact_tracker.recording.sources import Logged, Stamping, is_prefix

SOURCES_KEPT: Final = 256
BEGINNING_S: Final = 30.0
BEGINNING_NS: Final = round(BEGINNING_S * 1e9)
BEGINNING_POSES: Final = 20_000
KEPT_POSES: Final = 200_000
"""Limit for all sources together."""
_SAMPLE: Final = 50_000
_MAD_TO_SIGMA: Final = 1.4826


@dataclass(frozen=True)
class SourceSummary:
    """Summary of one pose source; figures are nan or None where too few poses are valid.

    Parameters
    ----------
    poses, observed : numbers of valid and of published poses.
    first_ns, last_ns : stamps of the first and last valid pose.
    median_rate_hz, jitter_s : of the time between poses; jitter is its robust standard deviation.
    counts : what the gate dropped, repaired or noted, by kind (including ``gap`` and ``held``).
    log_offset_s : median of log time minus header stamp.
    path_m, extent_m : length of the path of the body's origin, and its range along each world axis.
    loss : one line if most poses were dropped.
    beginning : the first valid poses, ``BEGINNING_S`` at most.
    sigma_position_m, sigma_rotation_rad : estimated sensor noise; filled in by the caller.
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
    loss: str | None = None
    beginning: Poses = field(default=NO_POSES, compare=False, repr=False)
    sigma_position_m: float | None = None
    sigma_rotation_rad: float | None = None

    @property
    def duration_s(self) -> float:
        if self.first_ns is None or self.last_ns is None:
            return float("nan")
        return (self.last_ns - self.first_ns) * 1e-9


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording.

    Parameters
    ----------
    sources : the pose sources, at most ``SOURCES_KEPT``, in the order of their names.
    more_sources : whether there are more.
    topics : messages by (topic, type, encoding), of all topics.
    metadata : records by name. attachments : their names.
    undecodable : number of messages of pose topics that do not match their schema.
    damage : one line if it is truncated or damaged.
    assumptions : one line for each source whose type the file does not define usably, and for a guessed time
        unit.
    """

    sources: tuple[SourceSummary, ...]
    topics: Mapping[tuple[str, str, str], int]
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[str, ...]
    undecodable: int
    damage: str | None
    more_sources: bool = False
    assumptions: tuple[str, ...] = ()


def summarise(path: str, table: TableReading = AS_NAMED) -> RecordingSummary:
    """Read a whole recording once, in bounded memory; ``table`` is that of ``open_log``.

    Raises
    ------
    UnreadableRecording
        No such file, or not MCAP.
    """
    topics, attachments = Counter[tuple[str, str, str]](), list[str]()
    metadata: dict[str, Mapping[str, str]] = {}

    def noted(items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            match item:
                case Metadata(name, values):
                    metadata[name] = values
                case Attachment(name, _):
                    attachments.append(name)
                case RawMessage(channel, _, _):
                    topics[channel.topic, channel.type, channel.encoding] += 1
                case Rows(rows_of, poses):
                    for source, some in zip(rows_of, poses, strict=True):
                        topics[source.topic, source.type, ROWS] += len(some)
            yield item

    reading = Reading(path, lambda channel: True, table=table)
    logged, assumed = reading.decoder.poses(noted(reading)), reading.decoder.assumed
    sources, undecodable, more_sources = _summaries(logged, assumed, reading.is_table)
    assumptions = [
        f"{one.source.topic}: {assumption_text(one.observed, one.source.type, why)}"
        for one in sources
        if (why := assumed.get((one.source.topic, one.source.type))) is not None
    ]
    assumptions += filter(None, [reading.assumption])
    noted_names, damage = tuple(attachments), reading.damage
    return RecordingSummary(
        sources, topics, metadata, noted_names, undecodable, damage, more_sources, tuple(assumptions)
    )


def summarise_log(log: PoseLog) -> SourceSummary:
    """Summary of the poses that a log selects, which may be composed; reads it to its end."""
    sources, _, _ = _summaries(log.published(), log.assumed, log.is_stamped)
    (found,) = (one for one in sources if one.source == log.source)
    return replace(found, source=log.source, counts=Counter(found.counts) + Counter(log.counts))


def _summaries(
    logged: Iterable[LoggedPose | None], assumed: Mapping[tuple[str, str], str], is_stamped: bool
) -> tuple[tuple[SourceSummary, ...], int, bool]:
    """The summary of each source, the number of undecodable messages, and whether there are more sources."""
    tallies, undecodable, more_sources, kept = dict[PoseSource, _Tally](), 0, False, 0
    for one in logged:
        if one is None:
            undecodable += 1
            continue
        source, pose, log_time_ns = one
        tally = tallies.get(source)
        if tally is None:
            if len(tallies) >= SOURCES_KEPT:
                more_sources = True
                continue
            tally = tallies[source] = _Tally(is_stamped)
        kept += tally.add(pose, log_time_ns, keep=kept < KEPT_POSES)
    for source, tally in tallies.items():
        if (source.topic, source.type) in assumed:
            tally.counts["known_definition"] += tally.observed
    return tuple(tallies[source].summary(source) for source in sorted(tallies)), undecodable, more_sources


class _Sample:
    """A regular sample of a stream of integers; when full, every second one is dropped and the stride
    doubles."""

    def __init__(self) -> None:
        self.values, self._stride, self._seen = np.zeros(0, np.int64), 1, 0

    def add(self, values: NDArray[np.int64]) -> None:
        """Add at most ``_SAMPLE`` values."""
        self.values = np.append(self.values, values[-self._seen % self._stride :: self._stride])
        self._seen += len(values)
        while len(self.values) > _SAMPLE:
            self.values, self._stride = self.values[::2], 2 * self._stride


class _Tally:
    """Running figures of one source, of which ``observed`` poses were published."""

    def __init__(self, is_stamped: bool) -> None:
        self.counts: Counter[str] = Counter()
        self.observed = self._poses = self._kept = self._first_ns = 0
        self._gate = PoseGate(self.counts)
        self._stamping = Stamping() if is_stamped else None
        self._waiting, self._beginning = list[Logged](), list[Poses]()
        self._last = NO_POSES
        self._steps_ns, self._offsets_ns = _Sample(), _Sample()
        self._path_m = 0.0
        self._low_m, self._high_m = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, pose: Pose, log_time_ns: int, keep: bool) -> int:
        """Add a pose; the first are buffered until their stamping is determined. Returns how many poses were
        kept as its beginning."""
        self.observed += 1
        self._waiting.append((pose, log_time_ns))
        is_enough = is_prefix(self._waiting) if self._stamping is None else len(self._waiting) == BATCH
        return self._admit(keep) if is_enough else 0

    def _admit(self, keep: bool) -> int:
        waiting, self._waiting = self._waiting, []
        self._stamping = self._stamping or Stamping.by(waiting)
        times_ns = np.array(
            [[max(min(t, RANGE_NS), -RANGE_NS) for t in (log_ns, pose.stamp_ns)] for pose, log_ns in waiting]
        )
        self._offsets_ns.add(times_ns[:, 0] - times_ns[:, 1])
        return self._note(self._stamping.admitted(self._gate, waiting), keep)

    def _note(self, poses: Poses, keep: bool) -> int:
        """Add valid poses; returns how many were kept."""
        if not len(poses):
            return 0
        if not self._poses:
            self._first_ns = int(poses.stamp_ns[0])
        self._poses += len(poses)
        joined = Poses.join([self._last, poses])
        self._steps_ns.add(np.diff(joined.stamp_ns))
        self._path_m += float(np.linalg.norm(np.diff(joined.position_m, axis=0), axis=1).sum())
        self._low_m = np.minimum(self._low_m, poses.position_m.min(axis=0))
        self._high_m = np.maximum(self._high_m, poses.position_m.max(axis=0))
        self._last = joined[-1:]
        early = poses[: np.searchsorted(poses.stamp_ns, self._first_ns + BEGINNING_NS)] if keep else NO_POSES
        if not len(early) or self._kept >= BEGINNING_POSES:
            return 0
        self._beginning.append(early)
        self._kept += len(early)
        return len(early)

    def summary(self, source: PoseSource) -> SourceSummary:
        if self._waiting:
            self._admit(keep=True)
        self._note(Poses.collect(self._gate.finish()), keep=True)
        nan = float("nan")
        steps = self._steps_ns.values
        period_ns = float(np.median(steps)) if len(steps) else nan
        jitter_ns = _MAD_TO_SIGMA * float(np.median(np.abs(steps - period_ns))) if len(steps) else nan
        x, y, z = (self._high_m - self._low_m).tolist() if self._poses else (nan, nan, nan)
        return SourceSummary(
            source=source,
            poses=self._poses,
            observed=self.observed,
            first_ns=self._first_ns if self._poses else None,
            last_ns=int(self._last.stamp_ns[0]) if self._poses else None,
            median_rate_hz=1e9 / period_ns,
            jitter_s=jitter_ns * 1e-9,
            counts=dict(self.counts),
            log_offset_s=float(np.median(self._offsets_ns.values)) * 1e-9,
            path_m=self._path_m,
            extent_m=(x, y, z),
            loss=remark_on_loss(self.counts, self.observed, self._gate.refused_xyzw),
            beginning=Poses.join(self._beginning),
        )
