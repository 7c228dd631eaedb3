"""What is drawn of a segmentation, piece by piece: each with the poses that it is about."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from contact_tracker.geometry.elements import Array
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.paper.window_curves import Curves
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.pose_buffer import Waiting
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.viewer import canvas
from contact_tracker.viewer.canvas import Canvas, Stamps
from contact_tracker.viewer.events import event, further_event
from contact_tracker.viewer.hull import hull
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Drawing, Ground, Viewpoint, draw_all, viewpoint


class Painter:
    """Draws into ``recording``; times count from ``origin_ns``, the first pose.

    ``vertices_m`` (V, 3) of the object, where known. ``paper``: with the paper's objective functions.
    """

    def __init__(
        self, recording: rr.RecordingStream, origin_ns: int, vertices_m: Array | None, paper: bool
    ) -> None:
        solid = None if vertices_m is None else hull(vertices_m)
        self._extent = UNKNOWN_EXTENT if solid is None else solid.extent
        self._sheet = Canvas(recording, origin_ns, solid, self._extent.radius_m)
        self._origin_ns = origin_ns
        self._curves = Curves() if paper else None
        self._waiting, self._all = Waiting(), Waiting()
        self._ground = Ground()
        self._last: dict[str, Contact | None] = {}

    def poses(self, poses: Poses) -> None:
        """The next poses, before the piece that is about them."""
        self._sheet.poses(poses)
        self._waiting.extend(poses)
        self._all.extend(poses)
        if self._curves is not None:
            self._curves.extend(poses)

    def piece(self, found: Segmentation) -> None:
        """What was concluded next."""
        filtered, beliefs = found.filtered, found.beliefs
        self._sheet.scalars(canvas.P_FILTERED, filtered.stamp_ns, filtered.probability)
        self._sheet.scalars(canvas.RESIDUAL, filtered.stamp_ns, filtered.residual)
        self._changes(canvas.FILTERED, filtered.stamp_ns, filtered.contacts)
        if not len(beliefs):
            return
        self._sheet.scalars(canvas.P_SMOOTHED, beliefs.stamp_ns, beliefs.probability)
        self._segments(found)
        self._fade(found)
        self._trail(beliefs)
        self._ground = self._ground.or_longer(found.segments)

    def finish(self, truth: Truth | None) -> None:
        """What is drawn of the whole at once."""
        if truth is not None:
            starts = np.array([i.start_ns for i in truth.intervals], np.int64)
            self._changes(canvas.TRUTH, starts, [i.contact for i in truth.intervals])
        if self._curves is not None:
            curves = self._curves.finish()
            self._sheet.scalars(canvas.PAPER, curves.stamp_ns, curves.normalised)

    @property
    def viewpoint(self) -> Viewpoint:
        """From where to look on all of it."""
        return viewpoint(self._all.poses, self._ground.plane, self._extent)

    def _trail(self, beliefs: Beliefs) -> None:
        """A strip per tick, joined to the one before: of the poses, the last one goes on waiting for that."""
        poses = self._waiting.poses
        ends = np.searchsorted(poses.stamp_ns, beliefs.stamp_ns, side="right")
        starts = np.maximum(np.concatenate([[0], ends[:-1]]) - 1, 0)
        strips = [poses.position_m[a:b] for a, b in zip(starts, ends, strict=True)]
        long = [i for i, strip in enumerate(strips) if len(strip) > 1]
        contacts = beliefs.contacts
        self._sheet.trail(beliefs.stamp_ns[long], [strips[i] for i in long], [contacts[i] for i in long])
        self._waiting.drop(max(int(ends[-1]) - 1, 0))

    def _segments(self, found: Segmentation) -> None:
        """The geometry of each segment from its start, nothing where there is none; its event."""
        poses, segments = self._waiting.poses, found.segments
        starts = np.array([s.start_ns for s in segments], np.int64)
        parts = [part for segment in segments for part in segment.parts]
        drawings: list[Drawing | None] = []
        for part in parts:
            first = int(np.searchsorted(poses.stamp_ns, part.start_ns))
            last = int(np.searchsorted(poses.stamp_ns, part.end_ns, side="right"))
            first = min(first, len(poses) - 1)
            within = poses[first : max(last, first + 1)]
            drawings.append(draw_all(part.geometries, within, self._extent))
        self._sheet.drawings(np.array([part.start_ns for part in parts], np.int64), drawings)
        self._joins_and_leaves(segments)
        contacts, origin = [s.contact for s in segments], self._origin_ns
        texts = [event(s.start_ns - origin, s.probability, s.geometry, s.inseparable) for s in segments]
        self._sheet.events(starts, contacts, texts)
        self._changes(canvas.SMOOTHED, starts, contacts)

    def _joins_and_leaves(self, segments: Sequence[Segment]) -> None:
        """Events of further contacts."""
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

    def _fade(self, found: Segmentation) -> None:
        """Each tick's probability; a segment begins with that of its first tick."""
        beliefs = found.beliefs
        stamps = beliefs.stamp_ns
        begins = np.array([s.start_ns for s in found.segments], np.int64)
        first = np.minimum(np.searchsorted(stamps, begins), len(beliefs) - 1)
        contacts = [*(s.contact for s in found.segments), *beliefs.contacts]
        rows = np.concatenate([first, np.arange(len(beliefs))])
        probability = beliefs.probability[rows, [c.column for c in contacts]]
        times = np.concatenate([begins, stamps])
        order = np.argsort(times, kind="stable")
        self._sheet.fade(times[order], [contacts[i] for i in order], probability[order])

    def _changes(self, entity: str, stamp_ns: Stamps, contacts: Sequence[Contact | None]) -> None:
        """Only where the state differs from the one before."""
        before = [self._last.get(entity, "none yet"), *contacts]
        kept = [i for i, contact in enumerate(contacts) if contact is not before[i]]
        self._sheet.states(entity, stamp_ns[kept], [contacts[i] for i in kept])
        if len(contacts):
            self._last[entity] = contacts[-1]
