"""Views of a whole recording with its segmentation, in a window, a file or a notebook, and of a stream."""

import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from contact_tracker.errors import NoPoses, ViewerError
from contact_tracker.geometry.elements import Array
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import DrawnRecording, KnownParts
from contact_tracker.outputs.scene import UNKNOWN_EXTENT, Upward, draw
from contact_tracker.outputs.text import Changes, is_settled, joint_name
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.informative_motion import InformativeMotion
from contact_tracker.viewer import canvas
from contact_tracker.viewer.canvas import Canvas, Stamps, caption, event, further_event
from contact_tracker.viewer.sinks import Sink, close, to_file, to_viewer

if TYPE_CHECKING:
    from rerun.notebook import Viewer as Viewer

Draw = Callable[[Outcome], None]


def write_rrd(outcome: Outcome, path: Path, _: str) -> None:
    """Write a rerun file with its layout; raises NoPoses."""
    begin(to_file(path), outcome.trajectory.name)(outcome)


def show_in_notebook(outcome: Outcome, width: int, height: int) -> "Viewer":
    """A widget with the whole recording, ``width`` and ``height`` in pixels; raises ModuleNotFoundError if
    rerun_notebook is not installed."""
    # Set before the import of rerun_notebook: otherwise the viewer's page is loaded from a server of rerun.
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "inline")
    import rerun_notebook  # noqa: F401 - rerun would fail later
    from rerun.notebook import Viewer

    viewers: list[Viewer] = []

    def sink(recording: rr.RecordingStream, blueprint: rrb.Blueprint | None) -> None:
        viewers.append(Viewer(width=width, height=height, recording=recording, blueprint=blueprint))

    begin(sink, outcome.trajectory.name)(outcome)
    return viewers[0]


def begin(sink: Sink, name: str, is_one_of_several: bool = False) -> Draw:
    """Open a view before the recording is segmented; returns the function that draws it. A viewer that
    ``sink`` opens stays open. Both raise ViewerError if the viewer does not accept the data."""
    recording, eye = canvas.new_recording(name), Upward(UNKNOWN_EXTENT).eye(UNKNOWN_EXTENT.radius_m)
    sink(recording, canvas.offline_layout(eye, is_one_of_several))
    return partial(_draw, recording, is_one_of_several)


def _draw(recording: rr.RecordingStream, is_one_of_several: bool, outcome: Outcome) -> None:
    """Draw a whole recording: known parts, motion, beliefs, segments and truth."""
    poses, beliefs, filtered = outcome.trajectory.poses, outcome.beliefs, outcome.segmentation.filtered
    if not len(poses):
        raise NoPoses("there is no pose to show")
    drawn = DrawnRecording.of(outcome)
    sheet = Canvas(recording, outcome.origin_ns, drawn.extent.radius_m)
    if drawn.parts:
        sheet.known(drawn.parts)
    sheet.centre(drawn.full_extent.centre_m)
    sheet.poses(poses)
    sheet.scalars(canvas.P_FILTERED, filtered.stamp_ns, filtered.probability)
    sheet.scalars(canvas.RESIDUAL, filtered.stamp_ns, filtered.residual)
    sheet.states(canvas.FILTERED, filtered.stamp_ns, filtered.contacts)
    if len(beliefs):
        sheet.scalars(canvas.P_SMOOTHED, beliefs.stamp_ns, beliefs.probability)
        _draw_segments(sheet, outcome, drawn)
        _draw_further(sheet, outcome, drawn)
        # a strip of the path per tick, joined to the previous one
        ends = np.searchsorted(poses.stamp_ns, beliefs.stamp_ns, side="right")
        starts = np.maximum(np.concatenate([[0], ends[:-1]]) - 1, 0)
        strips = [poses.position_m[a:b] for a, b in zip(starts, ends, strict=True)]
        long = [i for i, strip in enumerate(strips) if len(strip) > 1]
        contacts = beliefs.contacts
        sheet.trail(beliefs.stamp_ns[long], [strips[i] for i in long], [contacts[i] for i in long])
    if (truth := outcome.truth) is not None:
        changes = truth.between(int(poses.stamp_ns[0]), int(poses.stamp_ns[-1])).changes()
        starts = np.array([start_ns for start_ns, _ in changes], np.int64)
        sheet.states(canvas.TRUTH, starts, [contact for _, contact in changes])
    eye = drawn.upward.eye(max(drawn.extent.radius_m, drawn.full_extent.radius_m))
    recording.send_blueprint(canvas.offline_layout(eye, is_one_of_several))
    close(recording)


def _draw_segments(sheet: Canvas, outcome: Outcome, drawn: DrawnRecording) -> None:
    """Draw geometry, name, state and event of each segment from its start on, and the slip at the touching
    point, with a gap after each segment."""
    segments, origin_ns = outcome.segments, outcome.origin_ns
    starts = np.array([s.start_ns for s in segments], np.int64)
    drawings = [drawn.pairs([s.geometry], s.start_ns, s.end_ns) for s in segments]
    sheet.drawings(starts, drawings)
    _fade(sheet, outcome, starts, [drawing is not None and drawing.is_open for drawing in drawings])
    contacts = [s.contact for s in segments]
    texts = [
        event(s.start_ns - origin_ns, s.probability, s.geometry, s.inseparable)
        + ("" if s.joint is None else f"; {joint_name(s.joint)}")
        for s in segments
    ]
    sheet.events(starts, contacts, texts)
    sheet.inseparable(starts, [s.inseparable for s in segments])
    sheet.states(canvas.SMOOTHED, starts, contacts)
    for motion in (s.motion for s in segments if s.motion is not None):
        speeds = np.stack([motion.speed_m_per_s, 3.0 * motion.slip_sd_m_per_s], axis=1)
        stamps = np.append(motion.stamp_ns, motion.stamp_ns[-1] + 1)
        sheet.scalars(canvas.MOTION, stamps, np.vstack([speeds, [np.nan] * 2]))


def _draw_further(sheet: Canvas, outcome: Outcome, drawn: DrawnRecording) -> None:
    """Draw, label and plot each further contact from its start to its end, and add its events."""
    segments, origin_ns = outcome.segments, outcome.origin_ns
    parts = [(segment, part) for segment in segments for part in segment.parts]
    starts = np.array([part.start_ns for _, part in parts], np.int64)
    held = [[f if f in part.further else None for f in segment.further] for segment, part in parts]
    sheet.further(starts, held)
    for number, row in enumerate(zip_longest(*held), start=1):
        drawings = [
            drawn.pairs([None if further is None else further.geometry], part.start_ns, part.end_ns)
            for further, (_, part) in zip(row, parts, strict=True)
        ]
        sheet.drawings(starts, drawings, number)
    rows = [
        (stamp_ns, further.contact, further_event(stamp_ns - origin_ns, further, joins))
        for segment in segments
        for further in segment.further
        for stamp_ns, joins in ((further.start_ns, True), (further.end_ns, False))
        if stamp_ns is not None
    ]
    if rows:
        stamps, contacts, texts = zip(*sorted(rows, key=lambda row: row[0]), strict=True)
        sheet.events(np.array(stamps, np.int64), contacts, texts)


def _fade(sheet: Canvas, outcome: Outcome, begins: Stamps, has_open_offset: Sequence[bool]) -> None:
    """Draw the label's probability at each tick; at the start of a segment that of its first tick."""
    beliefs, stamps = outcome.beliefs, outcome.beliefs.stamp_ns
    times = np.sort(np.concatenate([begins, stamps]))
    numbers = np.maximum(np.searchsorted(begins, times, side="right") - 1, 0)
    ticks = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    segments = [outcome.segments[number] for number in numbers]
    probability = beliefs.probability[ticks, [segment.contact.column for segment in segments]]
    captions = [
        caption(segment.contact, p, segment.inseparable, has_open_offset[number])
        for segment, p, number in zip(segments, probability, numbers, strict=True)
    ]
    are_open = [bool(segment.inseparable) for segment in segments]
    sheet.fade(times, [segment.contact for segment in segments], probability, are_open, captions)


_CLOSE_S: Final = 5.0
_FRAME_NS: Final = 10_000_000
_REDRAW_NS: Final = 500_000_000


class LiveViewer:
    """Shows the body at up to 100 Hz, and all else at each belief; a context manager that closes itself.

    Parameters
    ----------
    vertices_m : (V, 3) of the object in the body frame, if known.
    sink : destination; by default a viewer on this machine, which is started if necessary.
    origin_ns : returns, after the first pose, the stamp from which times count; by default the first pose's.
    known_map : prior knowledge of the object and its surroundings.

    Raises
    ------
    ViewerError : the viewer does not start.
    """

    def __init__(
        self,
        vertices_m: Array | None = None,
        sink: Sink | None = None,
        origin_ns: Callable[[], int] | None = None,
        known_map: Map = EMPTY_MAP,
    ) -> None:
        self._known = KnownParts(known_map, vertices_m)
        self._world: GrowingMap | None = None
        self._extent = self._known.object_extent
        self._recording = canvas.new_recording()
        self._sheet: Canvas | None = None
        self._origin = origin_ns
        self._origin_ns = self._shown_ns = self._drawn_ns = 0
        self._upward = Upward(self._extent)
        self._changes = Changes()
        self._contact: Contact | None = None
        self._is_open = False
        self._waiting: deque[Pose] = deque()
        self._last: Pose | None = None
        (sink or to_viewer())(self._recording, canvas.live_layout(self._upward.eye(self._extent.radius_m)))

    def pose(self, pose: Pose) -> None:
        """Move the body, at up to 100 Hz."""
        if self._sheet is None:
            self._origin_ns = pose.stamp_ns if self._origin is None else self._origin()
            self._sheet = Canvas(self._recording, self._origin_ns, self._extent.radius_m)
            self._sheet.known(self._known.bodies, pose.stamp_ns)
            self._sheet.centre(self._extent.centre_m)
        if pose.stamp_ns - self._shown_ns >= _FRAME_NS:
            self._shown_ns = pose.stamp_ns
            self._sheet.pose(pose)
        self._waiting.append(pose)

    def suggest(self, stamp_ns: int, motion: InformativeMotion | None) -> None:
        """Draw the suggested motion; None removes it."""
        if self._sheet is not None:
            self._sheet.suggest(stamp_ns, motion, self._extent.radius_m)

    def belief(self, belief: Belief, world: GrowingMap | None = None) -> None:
        """Draw a belief about earlier poses, and the map if it has changed; draws nothing before a pose."""
        rows = [] if self._last is None else [self._last]
        while self._waiting and self._waiting[0].stamp_ns <= belief.stamp_ns:
            rows.append(self._waiting.popleft())
        if self._sheet is None or not rows:
            return
        self._last, tick = rows[-1], Poses.collect(rows)
        self._known.add_poses(tick)
        is_new = self._known.add_contact(belief.onset_ns, belief.stamp_ns, belief.geometry)
        if is_new or world is not self._world:
            self._world = world
            self._sheet.known(self._known.parts(world), belief.stamp_ns)
        sheet, contact, p = self._sheet, belief.contact, belief.probability[belief.contact.column]
        stamp = np.array([belief.stamp_ns], np.int64)
        sheet.trail(stamp, [tick.position_m], [contact])
        sheet.scalars(canvas.P_FILTERED, stamp, belief.probability[None])
        sheet.scalars(canvas.RESIDUAL, stamp, belief.residual[None])
        changed, self._contact = contact is not self._contact, contact
        sheet.states(canvas.FILTERED, stamp, [contact])
        is_news, joins, leaves = self._changes.update(belief)
        if is_news:
            text = event(belief.stamp_ns - self._origin_ns, p, belief.geometry, belief.inseparable)
            sheet.events(stamp, [contact], [text])
        for contacts, begins in ((joins, True), (leaves, False)):
            for further in contacts:
                text = further_event(belief.stamp_ns - self._origin_ns, further, begins)
                sheet.events(stamp, [further.contact], [text])
        sheet.inseparable(stamp, [belief.inseparable])
        if changed or joins or leaves or belief.stamp_ns - self._drawn_ns >= _REDRAW_NS:
            self._draw(sheet, belief, tick)
            self._drawn_ns = belief.stamp_ns
        text = caption(contact, p, belief.inseparable, self._is_open)
        sheet.fade(stamp, [contact], np.array([p]), [bool(belief.inseparable)], [text])
        sheet.further(stamp, [belief.further])

    def _draw(self, sheet: Canvas, belief: Belief, tick: Poses) -> None:
        geometry, lasted_ns = belief.geometry, belief.stamp_ns - (self._drawn_ns or belief.stamp_ns)
        if geometry is not None and is_settled(belief) and self._upward.add(geometry, tick, lasted_ns):
            self._recording.send_blueprint(canvas.live_layout(self._upward.eye(self._extent.radius_m)))
        up = self._upward.direction
        drawing = None if geometry is None else draw(geometry, tick, self._extent, up)
        self._is_open = drawing is not None and drawing.is_open
        stamp = np.array([belief.stamp_ns], np.int64)
        sheet.drawings(stamp, [drawing])
        further = [draw(contact.geometry, tick, self._extent, up) for contact in belief.further]
        gone = [None] * max(sheet.most_further - len(further), 0)
        for number, pair in enumerate([*further, *gone], 1):
            sheet.drawings(stamp, [pair], number)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Send the remaining data; the viewer stays open."""
        with suppress(ViewerError):  # the user may have closed the window
            close(self._recording, _CLOSE_S)
