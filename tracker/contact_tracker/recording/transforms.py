"""Poses in another frame (``--frame PARENT->CHILD``, ``--relative-to``) composed along a chain of transforms.

A pose is composed once each moving transform has samples before and after it. Positions are interpolated
linearly, rotations along the shortest arc. Only samples that pending poses need are kept.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import compress, takewhile
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.errors import AmbiguousSource
from contact_tracker.motion.poses import Pose, Poses, ReadAs
from contact_tracker.recording.decoding import LoggedPose
from contact_tracker.recording.definitions import canonical
from contact_tracker.recording.items import PoseSource
from contact_tracker.recording.sources import TRANSFORM_TYPES, Logged, Stamping, only_one


class Step(NamedTuple):
    """One transform of a chain; ``inverted`` if it is published in the opposite direction."""

    source: PoseSource
    inverted: bool


def frame_name(name: str) -> str:
    """A frame name without the leading slash of ROS 1."""
    return name.lstrip("/")


def is_transform(source: PoseSource) -> bool:
    """Whether a source is a transform between frames instead of a measured pose."""
    return canonical(source.type) in TRANSFORM_TYPES and bool(source.child_frame_id)


def is_static(source: PoseSource) -> bool:
    """Whether a source is published as static."""
    return source.topic.endswith("tf_static")


class TransformTree:
    """The frames and the first transform between each pair of them; ``named`` are further sources, by their
    names in the tree."""

    def __init__(
        self, sources: Iterable[PoseSource], named: Mapping[PoseSource, PoseSource] | None = None
    ) -> None:
        self._steps: dict[str, dict[str, Step]] = {}
        for called, source in sorted(({source: source for source in sources} | dict(named or {})).items()):
            if called.child_frame_id:
                parent, child = frame_name(called.frame_id), frame_name(called.child_frame_id)
                self._steps.setdefault(parent, {}).setdefault(child, Step(source, False))
                self._steps.setdefault(child, {}).setdefault(parent, Step(source, True))

    def __contains__(self, frame: str) -> bool:
        return frame_name(frame) in self._steps

    def chain(self, start: str, end: str) -> "Chain | None":
        """The shortest chain of transforms from one frame to another; None if there is none."""
        start, end = frame_name(start), frame_name(end)
        reached: dict[str, tuple[str, Step] | None] = {start: None}
        waiting = [start]
        for frame in waiting:  # which grows
            for neighbour, step in self._steps.get(frame, {}).items():
                if neighbour not in reached:
                    reached[neighbour] = frame, step
                    waiting.append(neighbour)
        if end not in reached:
            return None
        steps, at = list[Step](), reached[end]
        while at is not None:
            steps.append(at[1])
            at = reached[at[0]]
        return tuple(steps[::-1])

    def moving_root(self, frame: str) -> str | None:
        """The root of the tree, if a transform from there to ``frame`` may move; else None."""
        at, moves, seen = frame_name(frame), False, set[str]()
        while at not in seen:
            seen.add(at)
            above = next((name for name, step in self._steps.get(at, {}).items() if step.inverted), None)
            if above is None:
                break
            moves = moves or not is_static(self._steps[at][above].source)
            at = above
        return at if moves else None


ARROW: Final = "->"
_BODY: Final = "the body "
REFERENCE: Final = "the reference "
"""Frame names that do not occur in logs."""
Chain = tuple[Step, ...]
"""Transforms from a frame to a body."""


def last_moving(chain: Sequence[Step]) -> int:
    """Index of the last moving transform, which gives the stamps; -1 if none moves."""
    return max((i for i, step in enumerate(chain) if not is_static(step.source)), default=-1)


def find_chain(
    path: str,
    sources: Iterable[PoseSource],
    bodies: Sequence[PoseSource],
    frame: str | None,
    relative_to: str | None,
) -> tuple[Chain, PoseSource] | None:
    """The transforms from parent to child of ``PARENT->CHILD``, or from ``relative_to`` to the only one of
    ``bodies``, and the source of the composed poses; None if they are not known yet, or none of them
    moves."""
    if relative_to is None:
        parent, arrow, child = (frame or "").partition(ARROW)
        steps = TransformTree(filter(is_transform, sources)).chain(parent, child) if arrow else None
        if steps is None or last_moving(steps) < 0:
            return None
    else:
        bodies = [s for s in bodies if s.topic != relative_to or s.is_named(frame or "")]
        if frame is None:
            bodies = [s for s in bodies if not is_beside(s, s, relative_to)] or bodies
        if not bodies:
            return None
        body = only_one(path, bodies)
        parent, child = relative_to, body.child_frame_id
        if (steps := chain_relative(path, sources, body, relative_to)) is None:
            return None
    last = steps[last_moving(steps)].source
    frame_moves = any(step.inverted and not is_static(step.source) for step in steps)
    assumed = next(filter(None, (step.source.assumed for step in steps)), "")
    return steps, PoseSource(last.topic, last.type, parent, child, None, ReadAs(frame_moves), assumed)


def chain_relative(
    path: str, available: Iterable[PoseSource], source: PoseSource, relative_to: str
) -> Chain | None:
    """The transforms from a frame, or from another body (by its topic, or its name in the same table), to
    the body of ``source``."""
    sources = set(available)
    references = [s for s in sources if s.topic == relative_to and s != source]
    references = references or [s for s in sources if s != source and is_beside(s, source, relative_to)]
    tree = {s for s in sources if is_transform(s) and s != source}
    # Bodies in the same frame are found without a tree; a body has no children.
    named, start = {replace(source, child_frame_id=_BODY): source}, relative_to
    if references and not any(map(is_transform, references)):
        reference, start = only_one(path, references), REFERENCE
        named[replace(reference, child_frame_id=REFERENCE)] = reference
    elif source.child_frame_id and relative_to == source.child_frame_id:
        raise AmbiguousSource(f"{path}: {relative_to} is the body itself: name another frame")
    return TransformTree(tree, named).chain(start, _BODY)


def is_beside(candidate: PoseSource, source: PoseSource, name: str) -> bool:
    """Whether ``candidate`` has the poses of the body ``name`` in the frame of the poses of ``source``."""
    is_same_frame = frame_name(candidate.frame_id) == frame_name(source.frame_id)
    is_known_to_be = candidate.topic == source.topic and not source.frame_id  # of one file of motion capture
    is_named = bool(name) and frame_name(candidate.child_frame_id) == frame_name(name)
    return is_named and is_same_frame and is_known_to_be and not is_transform(candidate)


def composition_hint(sources: Iterable[PoseSource]) -> str:
    """A hint for a choice among transforms that connect one frame to one body."""
    steps = [source for source in sources if is_transform(source)]
    parents = {frame_name(source.frame_id) for source in steps}
    children = {frame_name(source.child_frame_id) for source in steps}
    roots, bodies = parents - children, children - parents
    if len(steps) < 2 or len(roots) != 1 or len(bodies) != 1:
        return ""
    return f", or compose them by --frame '{min(roots)}->{min(bodies)}'"


def relative_hint(path: str, sources: Iterable[PoseSource], frame: str) -> str:
    """A hint for ``PARENT->CHILD`` if ``--relative-to`` would give these poses, else empty."""
    ordered = sorted(sources)
    parent, arrow, child = frame.partition(ARROW)
    for source in ordered if arrow else ():
        with suppress(AmbiguousSource):
            if source.child_frame_id == child and chain_relative(path, ordered, source, parent):
                return f"; compose it by --frame {child} --relative-to {parent}"
    return ""


def moving_parent_note(sources: Iterable[PoseSource], source: PoseSource) -> str | None:
    """One line if the parent frame of the poses may itself move, else None."""
    tree = TransformTree(s for s in sources if s != source)
    root = tree.moving_root(source.frame_id) if source.frame_id else None
    if root is None:
        return None
    advice = f"--frame '{root}->{source.child_frame_id}'" if is_transform(source) else f"--relative-to {root}"
    return (
        f"poses are in {source.frame_id}, which may move in {root}: contacts are with {source.frame_id}; for "
        f"those with {root}: {advice}"
    )


GAP_NS: Final = 1_000_000_000
"""Longest gap (ns) over which moving transforms are interpolated."""
_MOST_WAITING: Final = 20_000
_MOST_KEPT: Final = 200_000
_PATIENCE_NS: Final = 5_000_000_000
"""Log time (ns) for which a pose waits for moving transforms, as its stamp may lead."""
_KEPT_NS: Final = 10_000_000_000
"""Time (ns) for which samples of a transform are kept, as stamps of poses may lag."""
_BACK_NS: Final = 10_000_000_000
_FORWARD_NS: Final = 3_600_000_000_000
"""Largest jumps of the stamps of a transform (ns); after larger ones its samples start anew."""
_FARTHEST_NS: Final = 2**61
_ZERO_IS_UNSET: Final = Stamping(offset_ns=0, near_zero_ns=-1)
"""The stamping of sources with too few poses to decide whether zero is unset."""


class Composer:
    """Converts poses of the sources of a chain to poses of one body in the first frame of the chain.

    Parameters
    ----------
    steps : the chain, from the wanted frame to the body; the last one that moves gives the stamps.
    source : name of the composed poses.
    at_once : number of poses composed together; 1 for a live stream.
    read_ahead : first poses by source, which decide the stamping and have the static transforms.

    Attributes
    ----------
    counts : ``no_parent``, ``parent_gap`` and ``bad_parent`` (docs/conventions.md), and
        ``log_time_as_stamp`` as in ``PoseLog``.
    """

    def __init__(
        self,
        steps: Sequence[Step],
        source: PoseSource,
        at_once: int,
        read_ahead: Mapping[PoseSource, list[Logged]],
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._steps, self._body, self._source = steps, last_moving(steps), source
        self._at_once = at_once
        self._tracks = {step.source: _Track(self.counts, is_static(step.source)) for step in steps}
        self._parents = [self._tracks[s.source] for i, s in enumerate(steps) if i != self._body]
        self._waiting: deque[Logged] = deque()
        self._stampings = dict[PoseSource, Stamping]()
        for of, logged in read_ahead.items():
            if of in self._tracks and is_static(of):
                for pose, _ in logged[:1]:
                    self._tracks[of].add(pose)
            elif of in self._tracks and len(logged) > 1:
                self._stampings[of] = Stamping.by(logged)

    def compose(self, logged: Iterable[LoggedPose]) -> Iterator[LoggedPose]:
        """The composed poses; other poses are dropped."""
        body = self._steps[self._body].source
        for source, pose, log_time_ns in logged:
            if source in self._tracks:
                counts = self.counts if source == body else Counter[str]()
                pose = self._stampings.get(source, _ZERO_IS_UNSET).stamped(pose, log_time_ns, counts)
                if source == body:
                    self._waiting.append((pose, log_time_ns))
                else:
                    self._tracks[source].add(pose)
            yield from self._ready(log_time_ns)
        yield from self._emit(len(self._waiting))

    def _ready(self, now_ns: int) -> Iterator[LoggedPose]:
        """Pending poses that can be composed, once there are enough, and poses that have waited too long."""
        if self._waiting and now_ns - self._waiting[0][1] > _PATIENCE_NS:
            late = takewhile(lambda logged: now_ns - logged[1] > _PATIENCE_NS, self._waiting)
            yield from self._emit(sum(1 for _ in late))
        if len(self._waiting) < self._at_once:
            return
        until_ns = min((track.until_ns for track in self._parents), default=2**63)
        if self._waiting[self._at_once - 1][0].stamp_ns <= until_ns:
            ready = takewhile(lambda logged: logged[0].stamp_ns <= until_ns, self._waiting)
            yield from self._emit(sum(1 for _ in ready))
        elif len(self._waiting) > _MOST_WAITING:
            yield from self._emit(_MOST_WAITING // 2)

    def _emit(self, count: int) -> Iterator[LoggedPose]:
        logged = [self._waiting.popleft() for _ in range(count)]
        if not logged:
            return
        poses = Poses.collect(pose for pose, _ in logged)
        good = np.ones(len(poses), bool)
        norms = np.linalg.norm(poses.quat_xyzw, axis=1)
        usable = np.isfinite(norms) & (norms > 0)
        quats = np.where(usable[:, None], poses.quat_xyzw, [0.0, 0.0, 0.0, 1.0])
        parts = list[tuple[NDArray[np.float64], Rotation]]()
        for i, (source, inverted) in enumerate(self._steps):
            place, turn = poses.position_m, Rotation.from_quat(quats)
            if i != self._body:
                place, turn, is_known = self._tracks[source].at(poses.stamp_ns)
                good &= is_known
            if inverted:
                turn = turn.inv()
                place = -turn.apply(place)
            parts.append((place, turn))
        positions, rotations = reduce(lambda a, b: (a[0] + a[1].apply(b[0]), a[1] * b[1]), parts)
        for stamp_ns in poses.stamp_ns[~good].tolist():
            is_gap = all(track.spans(stamp_ns) for track in self._parents)
            self.counts["parent_gap" if is_gap else "no_parent"] += 1
        ends_ns = [track.until_ns for track in self._parents] + [pose.stamp_ns for pose, _ in self._waiting]
        for track in self._parents:
            track.forget(min(ends_ns) - _KEPT_NS)
        # A quaternion keeps its norm, so that the pose gate validates it as published.
        quats = rotations.as_quat() * np.where(usable, norms, np.nan)[:, None]
        composed = Poses(poses.stamp_ns, positions, quats)[good]
        times_ns = compress((log_time_ns for _, log_time_ns in logged), good)
        for pose, log_time_ns in zip(composed, times_ns, strict=True):
            yield self._source, pose, log_time_ns


class _Track:
    """Samples of one transform of a chain, as long as pending poses need them."""

    def __init__(self, counts: Counter[str], static: bool) -> None:
        self._counts = counts
        self._static = static
        self._samples: deque[Pose] = deque()

    @property
    def until_ns(self) -> int:
        """Stamp of the last sample."""
        if self._static and self._samples:
            return 2**63
        return self._samples[-1].stamp_ns if self._samples else -(2**63)

    def spans(self, stamp_ns: int) -> bool:
        """Whether there are samples before and after a stamp."""
        has_begun = bool(self._samples) and (self._static or self._samples[0].stamp_ns <= stamp_ns)
        return has_begun and stamp_ns <= self.until_ns

    def add(self, pose: Pose) -> None:
        norm = float(np.linalg.norm(pose.quat_xyzw))
        is_pose = abs(norm - 1) < 0.05 and all(map(math.isfinite, pose.position_m))
        if not is_pose or abs(pose.stamp_ns) > _FARTHEST_NS:
            self._counts["bad_parent"] += 1
            return
        if self._static:
            self._samples.clear()
        elif self._samples:
            step_ns = pose.stamp_ns - self._samples[-1].stamp_ns
            if -_BACK_NS < step_ns <= 0:
                self._counts["bad_parent"] += step_ns < 0
                return
            if not 0 < step_ns <= _FORWARD_NS:
                self._samples.clear()
        self._samples.append(pose)
        if len(self._samples) > _MOST_KEPT:
            self._samples.popleft()

    def forget(self, stamp_ns: int) -> None:
        """Drop the samples before the last one up to a stamp."""
        while len(self._samples) > 1 and self._samples[1].stamp_ns <= stamp_ns:
            self._samples.popleft()

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], Rotation, NDArray[np.bool_]]:
        """Interpolated positions (N, 3) (m) and rotations at stamps (N,), and whether they are known there
        (N,)."""
        about = deque[Pose]()  # from the last sample before the first stamp onwards
        for sample in reversed(self._samples):
            about.appendleft(sample)
            if sample.stamp_ns <= stamps_ns.min():
                break
        if not about:
            unknown = np.zeros(len(stamps_ns), bool)
            return np.zeros((len(stamps_ns), 3)), Rotation.identity(len(stamps_ns)), unknown
        times_ns, positions, quats = Poses.collect(about).columns
        end = times_ns.searchsorted(stamps_ns).clip(max=len(times_ns) - 1)
        begin = np.where(times_ns[end] > stamps_ns, end - 1, end).clip(min=0)
        step_ns = times_ns[end] - times_ns[begin]
        rests = (positions[begin] == positions[end]).all(axis=1) & (quats[begin] == quats[end]).all(axis=1)
        is_between = (times_ns[begin] <= stamps_ns) & (stamps_ns <= times_ns[end])
        share = ((stamps_ns - times_ns[begin]) / np.maximum(step_ns, 1)).clip(0.0, 1.0)[:, None]
        rotations = Rotation.from_quat(quats)
        turn = (rotations[begin].inv() * rotations[end]).as_rotvec()
        rotation = rotations[begin] * Rotation.from_rotvec(share * turn)
        position = positions[begin] + share * (positions[end] - positions[begin])
        return position, rotation, (is_between & ((step_ns <= GAP_NS) | rests)) | self._static
