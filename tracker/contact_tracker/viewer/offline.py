"""View of a whole recording with its segmentation, drawn while it is segmented."""

from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr

from contact_tracker.atomic_file import accept_any, whole_file
from contact_tracker.errors import NoPoses
from contact_tracker.geometry.elements import Array
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.paper.window_curves import Curves
from contact_tracker.tracking.belief import FurtherContact, Segment, SegmentPart
from contact_tracker.tracking.pose_buffer import Pieces, PoseBuffer, with_pose_callback
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.viewer import canvas, layout
from contact_tracker.viewer.camera import Upward
from contact_tracker.viewer.canvas import Canvas, caption, event, further_caption, further_event
from contact_tracker.viewer.parts import KnownParts, Part
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Drawing, Extent, draw, poses_within
from contact_tracker.viewer.sinks import Sink, close, to_file


class Shown(NamedTuple):
    """A recording to show.

    Parameters
    ----------
    poses : at least one.
    pieces : the function that segments them.
    truth : ground truth, if known; shown for the time of the poses.
    vertices_m : (V, 3) of the object in the body frame, if known, for its hull.
    paper : whether to draw the paper's objective functions as well.
    name : shown in the viewer.
    origin_ns : returns the stamp from which times count, after the first pose; by default the first pose's.
    known_map : what is known of the object and its surroundings.
    world : returns the map of what contacts have touched, after the last piece; None without one.
    parts : all that is known, instead of ``known_map`` and ``world``.
    """

    poses: Iterable[Pose]
    pieces: Pieces
    truth: Truth | None = None
    vertices_m: Array | None = None
    paper: bool = False
    name: str | None = None
    origin_ns: Callable[[], int] | None = None
    known_map: Map = EMPTY_MAP
    world: Callable[[], GrowingMap | None] = lambda: None
    parts: tuple[Part, ...] = ()


def write_rrd(path: Path, shown: Shown, check: Callable[[], None] = accept_any) -> None:
    """Write a rerun file with its layout, atomically; ``check`` as of ``whole_file``.

    Memory grows during one contact, with ``paper`` (70 bytes per ten poses), by ten poses per second, and by
    rerun's index of chunks.

    Raises
    ------
    OSError : the file cannot be written.
    """
    with whole_file(path, check) as temporary:
        show(shown, to_file(temporary))


def show(shown: Shown, sink: Sink, is_one_of_several: bool = False) -> None:
    """Draw a recording while it is segmented; a viewer opened by ``sink`` stays open.

    Raises
    ------
    NoPoses : there is no pose.
    ViewerError : the viewer does not start or does not take the data.
    """
    rest = iter(shown.poses)
    first = next(rest, None)
    if first is None:
        raise NoPoses("there is no pose to show")
    origin_ns = first.stamp_ns if shown.origin_ns is None else shown.origin_ns()
    recording = canvas.new_recording(shown.name)
    known = KnownParts(shown.known_map, shown.vertices_m)
    extent = known.object_extent or UNKNOWN_EXTENT
    upward = Upward(extent)
    sink(recording, layout.offline(upward.eye(extent.radius_m), shown.paper, is_one_of_several))
    painter = Painter(recording, origin_ns, known, upward, shown.paper)
    for piece in with_pose_callback(chain([first], rest), shown.pieces, painter.poses):
        painter.piece(piece)
    world = shown.world()
    painter.finish(shown.truth, shown.parts or known.parts(world), known.extent(world))
    radius_m = max(extent.radius_m, known.extent(world).radius_m)
    recording.send_blueprint(layout.offline(upward.eye(radius_m), shown.paper, is_one_of_several))
    close(recording)


class Painter:
    """Draws into ``recording``; times count from ``origin_ns``, the first pose of the recording.

    ``known`` collects what is known, ``upward`` estimates the upward direction. ``paper``: with the paper's
    objective functions.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        origin_ns: int,
        known: KnownParts,
        upward: Upward,
        paper: bool,
    ) -> None:
        self._extent = known.object_extent or UNKNOWN_EXTENT
        self._sheet = Canvas(recording, origin_ns, self._extent.radius_m)
        self._known = known
        if known.bodies:
            self._sheet.known(known.bodies)
        self._origin_ns = origin_ns
        self._curves = Curves() if paper else None
        self._pose_buffer = PoseBuffer()
        self._upward = upward
        self._first_ns, self._last_ns = 2**63 - 1, -(2**63)

    def poses(self, poses: Poses) -> None:
        """Draw the next poses, before the segmentation of them."""
        self._sheet.poses(poses)
        self._pose_buffer.extend(poses)
        self._known.add_poses(poses)
        if len(poses):
            self._first_ns = min(self._first_ns, int(poses.stamp_ns[0]))
            self._last_ns = int(poses.stamp_ns[-1])
        if self._curves is not None:
            self._curves.extend(poses)

    def piece(self, found: Segmentation) -> None:
        """Draw the next piece of the segmentation."""
        filtered, beliefs = found.filtered, found.beliefs
        self._sheet.scalars(canvas.P_FILTERED, filtered.stamp_ns, filtered.probability)
        self._sheet.scalars(canvas.RESIDUAL, filtered.stamp_ns, filtered.residual)
        self._sheet.states(canvas.FILTERED, filtered.stamp_ns, filtered.contacts)
        if not len(beliefs):
            return
        self._sheet.scalars(canvas.P_SMOOTHED, beliefs.stamp_ns, beliefs.probability)
        self._segments(found)
        self._trail(beliefs)

    def finish(self, truth: Truth | None, parts: Sequence[Part], extent: Extent) -> None:
        """Draw what needs the whole recording; ``parts`` are all that is known, at all times, and ``extent``
        is that of the object by these."""
        if parts:
            self._sheet.known(parts)
        self._sheet.centre(extent.centre_m)
        if truth is not None:
            changes = truth.between(self._first_ns, self._last_ns).changes()
            starts = np.array([start_ns for start_ns, _ in changes], np.int64)
            self._sheet.states(canvas.TRUTH, starts, [contact for _, contact in changes])
        if self._curves is not None:
            curves = self._curves.finish()
            self._sheet.scalars(canvas.PAPER, curves.stamp_ns, curves.normalised)

    def _trail(self, beliefs: Beliefs) -> None:
        """Draw a strip per tick, joined to the previous one: the last pose is kept for the next strip."""
        poses = self._pose_buffer.poses
        ends = np.searchsorted(poses.stamp_ns, beliefs.stamp_ns, side="right")
        starts = np.maximum(np.concatenate([[0], ends[:-1]]) - 1, 0)
        strips = [poses.position_m[a:b] for a, b in zip(starts, ends, strict=True)]
        long = [i for i, strip in enumerate(strips) if len(strip) > 1]
        contacts = beliefs.contacts
        self._sheet.trail(beliefs.stamp_ns[long], [strips[i] for i in long], [contacts[i] for i in long])
        self._pose_buffer.drop(max(int(ends[-1]) - 1, 0))

    def _segments(self, found: Segmentation) -> None:
        """Draw the geometry of each segment from its start, and its event."""
        poses, segments = self._pose_buffer.poses, found.segments
        starts = np.array([s.start_ns for s in segments], np.int64)
        spans = [poses_within(poses, one.start_ns, one.end_ns) for one in segments]
        for one, within in zip(segments, spans, strict=True):
            self._known.add_contact(one.start_ns, one.end_ns, one.geometry)
            if one.geometry is not None:
                self._upward.add(one.geometry, within, one.end_ns - one.start_ns)
        drawings = [self._drawn(one, within) for one, within in zip(segments, spans, strict=True)]
        self._sheet.drawings(starts, drawings)
        self._further(poses, segments)
        self._joins_and_leaves(segments)
        self._fade(found, [one is not None and one.is_open for one in drawings])
        contacts, origin = [s.contact for s in segments], self._origin_ns
        texts = [event(s.start_ns - origin, s.probability, s.geometry, s.inseparable) for s in segments]
        self._sheet.events(starts, contacts, texts)
        self._sheet.inseparable(starts, [s.inseparable for s in segments])
        self._sheet.states(canvas.SMOOTHED, starts, contacts)

    def _further(self, poses: Poses, segments: Sequence[Segment]) -> None:
        """Draw, label and plot each further contact from its start to its end."""
        self._sheet.have_further(max((len(segment.further) for segment in segments), default=0))
        parts = [(segment, part) for segment in segments for part in segment.parts]
        starts = np.array([part.start_ns for _, part in parts], np.int64)
        spans = [poses_within(poses, part.start_ns, part.end_ns) for _, part in parts]
        for number in range(1, self._sheet.most_further + 1):
            held = [_further_of(segment, part, number) for segment, part in parts]
            drawings = [
                None if one is None else self._drawn(one, within)
                for one, within in zip(held, spans, strict=True)
            ]
            self._sheet.drawings(starts, drawings, number)
            named = [one for one in held if one is not None]
            self._sheet.fade(
                starts[[one is not None for one in held]],
                [one.contact for one in named],
                np.array([one.probability for one in named]),
                [further_caption(one) for one in named],
                number,
            )
            lane = canvas.further_lane(number)
            self._sheet.states(lane, starts, [None if one is None else one.contact for one in held])

    def _joins_and_leaves(self, segments: Sequence[Segment]) -> None:
        """Add the events of further contacts."""
        rows = [
            (stamp_ns, one.contact, further_event(stamp_ns - self._origin_ns, one, joins))
            for segment in segments
            for one in segment.further
            for stamp_ns, joins in ((one.start_ns, True), (one.end_ns, False))
            if stamp_ns is not None
        ]
        if rows:
            stamps, contacts, texts = zip(*sorted(rows, key=lambda row: row[0]), strict=True)
            self._sheet.events(np.array(stamps, np.int64), contacts, texts)

    def _drawn(self, one: Segment | FurtherContact, within: Poses) -> Drawing | None:
        """``within`` are the poses of the contact."""
        if one.geometry is None:
            return None
        return draw(one.geometry, within, self._extent, self._upward.direction)

    def _fade(self, found: Segmentation, is_open: Sequence[bool]) -> None:
        """Draw each tick's probability; a segment begins with that of its first tick."""
        beliefs, segments = found.beliefs, found.segments
        stamps = beliefs.stamp_ns
        begins = np.array([s.start_ns for s in segments], np.int64)
        first = np.minimum(np.searchsorted(stamps, begins), len(beliefs) - 1)
        contacts = [*(s.contact for s in segments), *beliefs.contacts]
        rows = np.concatenate([first, np.arange(len(beliefs))])
        probability = beliefs.probability[rows, [c.column for c in contacts]]
        times = np.concatenate([begins, stamps])
        number = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
        captions = [
            caption(contact, p, segments[i].inseparable, is_open[i])
            for contact, p, i in zip(contacts, probability, number, strict=True)
        ]
        order = np.argsort(times, kind="stable")
        self._sheet.fade(
            times[order], [contacts[i] for i in order], probability[order], [captions[i] for i in order]
        )


def _further_of(segment: Segment, part: SegmentPart, number: int) -> FurtherContact | None:
    """Further contact ``number`` (from 1) of a segment, if it holds in this part."""
    return next((one for one in segment.further[number - 1 : number] if one in part.further), None)
