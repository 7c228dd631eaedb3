"""View of a whole recording with its segmentation: in a window, a file or a notebook."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from contact_tracker.errors import NoPoses
from contact_tracker.files import accept_any, whole_file
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.paper.window_curves import curves
from contact_tracker.tracking.belief import FurtherContact, Segment, SegmentPart
from contact_tracker.viewer import canvas
from contact_tracker.viewer.canvas import Canvas, Stamps, caption, event, further_caption, further_event
from contact_tracker.viewer.parts import KnownParts
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Drawing, Upward, draw, poses_within
from contact_tracker.viewer.sinks import Sink, close, to_file

if TYPE_CHECKING:
    from rerun.notebook import Viewer as Viewer

Draw = Callable[[Outcome], None]


def write_rrd(path: Path, outcome: Outcome, check: Callable[[], None] = accept_any) -> None:
    """Write a rerun file with its layout, atomically; ``check`` as of ``whole_file``.

    Raises
    ------
    NoPoses : there is no pose.
    OSError : the file cannot be written.
    """
    with whole_file(path, check) as temporary:
        begin(to_file(temporary), outcome.trajectory.name)(outcome)


def show_in_notebook(outcome: Outcome, width: int, height: int) -> "Viewer":
    """A widget that shows the whole recording, with the size given in pixels; raises ModuleNotFoundError if
    there is none."""
    # Read when rerun_notebook is imported: otherwise the viewer's page is loaded from a server of rerun.
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "inline")
    import rerun_notebook  # noqa: F401 - rerun would fail later
    from rerun.notebook import Viewer

    viewers: list[Viewer] = []

    def sink(recording: rr.RecordingStream, blueprint: rrb.Blueprint | None) -> None:
        viewers.append(Viewer(width=width, height=height, recording=recording, blueprint=blueprint))

    begin(sink, outcome.trajectory.name)(outcome)
    return viewers[0]


def begin(sink: Sink, name: str, is_one_of_several: bool = False) -> Draw:
    """Open a view before the recording is segmented; the function that is returned draws it there. A viewer
    that ``sink`` opens stays open.

    Raises
    ------
    ViewerError : the viewer does not start, or later, does not take the data.
    """
    recording, eye = canvas.new_recording(name), Upward(UNKNOWN_EXTENT).eye(UNKNOWN_EXTENT.radius_m)
    sink(recording, canvas.offline_layout(eye, is_one_of_several))
    return partial(_draw, recording, is_one_of_several)


def _draw(recording: rr.RecordingStream, is_one_of_several: bool, outcome: Outcome) -> None:
    """Draw a whole recording: what is known, the motion, beliefs and segments, and the truth."""
    poses, beliefs, filtered = outcome.trajectory.poses, outcome.beliefs, outcome.segmentation.filtered
    if not len(poses):
        raise NoPoses("there is no pose to show")
    known = KnownParts.of(outcome)
    extent, whole = known.object_extent or UNKNOWN_EXTENT, known.extent(outcome.touched)
    upward = Upward(extent)
    spans = [poses_within(poses, one.start_ns, one.end_ns) for one in outcome.segments]
    for one, within in zip(outcome.segments, spans, strict=True):
        if one.geometry is not None:
            upward.add(one.geometry, within, one.end_ns - one.start_ns)
    sheet = Canvas(recording, outcome.origin_ns, extent.radius_m)
    if parts := known.parts(outcome.touched):
        sheet.known(parts)
    sheet.centre(whole.centre_m)
    sheet.poses(poses)
    sheet.scalars(canvas.P_FILTERED, filtered.stamp_ns, filtered.probability)
    sheet.scalars(canvas.RESIDUAL, filtered.stamp_ns, filtered.residual)
    sheet.states(canvas.FILTERED, filtered.stamp_ns, filtered.contacts)
    if len(beliefs):
        sheet.scalars(canvas.P_SMOOTHED, beliefs.stamp_ns, beliefs.probability)

        def drawn(one: Segment | FurtherContact | None, within: Poses) -> Drawing | None:
            """The drawing of a contact with its poses, if it has a geometry."""
            if one is None or one.geometry is None:
                return None
            return draw(one.geometry, within, extent, upward.direction)

        _draw_segments(sheet, outcome, [drawn(*both) for both in zip(outcome.segments, spans, strict=True)])
        _draw_further(sheet, outcome, drawn)
        _draw_trail(sheet, outcome)
        _draw_motion(sheet, outcome)
    if (truth := outcome.truth) is not None:
        changes = truth.between(int(poses.stamp_ns[0]), int(poses.stamp_ns[-1])).changes()
        starts = np.array([start_ns for start_ns, _ in changes], np.int64)
        sheet.states(canvas.TRUTH, starts, [contact for _, contact in changes])
    paper = curves(poses)
    sheet.scalars(canvas.PAPER, paper.stamp_ns, paper.normalised)
    eye = upward.eye(max(extent.radius_m, whole.radius_m))
    recording.send_blueprint(canvas.offline_layout(eye, is_one_of_several))
    close(recording)


def _draw_trail(sheet: Canvas, outcome: Outcome) -> None:
    """Draw a strip of the path per tick, joined to the previous one."""
    poses, beliefs = outcome.trajectory.poses, outcome.beliefs
    ends = np.searchsorted(poses.stamp_ns, beliefs.stamp_ns, side="right")
    starts = np.maximum(np.concatenate([[0], ends[:-1]]) - 1, 0)
    strips = [poses.position_m[a:b] for a, b in zip(starts, ends, strict=True)]
    long = [i for i, strip in enumerate(strips) if len(strip) > 1]
    contacts = beliefs.contacts
    sheet.trail(beliefs.stamp_ns[long], [strips[i] for i in long], [contacts[i] for i in long])


def _draw_motion(sheet: Canvas, outcome: Outcome) -> None:
    """Draw the slip at the touching point, with a gap after each segment."""
    for motion in (one.motion for one in outcome.segments if one.motion is not None):
        speeds = np.stack([motion.speed_m_per_s, 3.0 * motion.slip_sd_m_per_s], axis=1)
        gap_ns = motion.stamp_ns[-1] + 1
        sheet.scalars(canvas.MOTION, np.append(motion.stamp_ns, gap_ns), np.vstack([speeds, [np.nan] * 2]))


def _draw_segments(sheet: Canvas, outcome: Outcome, drawings: Sequence[Drawing | None]) -> None:
    """Draw the geometry of each segment from its start, its name, state and event."""
    segments, origin_ns = outcome.segments, outcome.origin_ns
    starts = np.array([s.start_ns for s in segments], np.int64)
    sheet.drawings(starts, drawings)
    _fade(sheet, outcome, starts, [one is not None and one.is_open for one in drawings])
    contacts = [s.contact for s in segments]
    texts = [event(s.start_ns - origin_ns, s.probability, s.geometry, s.inseparable) for s in segments]
    sheet.events(starts, contacts, texts)
    sheet.inseparable(starts, [s.inseparable for s in segments])
    sheet.states(canvas.SMOOTHED, starts, contacts)


def _draw_further(
    sheet: Canvas, outcome: Outcome, drawn: Callable[[FurtherContact | None, Poses], Drawing | None]
) -> None:
    """Draw, label and plot each further contact from its start to its end, and add its events."""
    segments, origin_ns = outcome.segments, outcome.origin_ns
    sheet.have_further(max((len(segment.further) for segment in segments), default=0))
    parts = [(segment, part) for segment in segments for part in segment.parts]
    starts = np.array([part.start_ns for _, part in parts], np.int64)
    spans = [poses_within(outcome.trajectory.poses, part.start_ns, part.end_ns) for _, part in parts]
    for number in range(1, sheet.most_further + 1):
        held = [_further_of(segment, part, number) for segment, part in parts]
        sheet.drawings(starts, [drawn(*both) for both in zip(held, spans, strict=True)], number)
        named = [one for one in held if one is not None]
        sheet.fade(
            starts[[one is not None for one in held]],
            [one.contact for one in named],
            np.array([one.probability for one in named]),
            [further_caption(one) for one in named],
            number,
        )
        lane = canvas.further_lane(number)
        sheet.states(lane, starts, [None if one is None else one.contact for one in held])
    rows = [
        (stamp_ns, one.contact, further_event(stamp_ns - origin_ns, one, joins))
        for segment in segments
        for one in segment.further
        for stamp_ns, joins in ((one.start_ns, True), (one.end_ns, False))
        if stamp_ns is not None
    ]
    if rows:
        stamps, contacts, texts = zip(*sorted(rows, key=lambda row: row[0]), strict=True)
        sheet.events(np.array(stamps, np.int64), contacts, texts)


def _fade(sheet: Canvas, outcome: Outcome, begins: Stamps, is_open: Sequence[bool]) -> None:
    """Draw each tick's probability; a segment begins with that of its first tick."""
    beliefs, segments = outcome.beliefs, outcome.segments
    stamps = beliefs.stamp_ns
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
    sheet.fade(times[order], [contacts[i] for i in order], probability[order], [captions[i] for i in order])


def _further_of(segment: Segment, part: SegmentPart, number: int) -> FurtherContact | None:
    """Further contact ``number`` (from 1) of a segment, if it holds in this part."""
    return next((one for one in segment.further[number - 1 : number] if one in part.further), None)
