"""A whole recording with its segmentation: written to a file or opened in the viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from contact_tracker.geometry import Array
from contact_tracker.labels import Contact
from contact_tracker.poses import Poses
from contact_tracker.segmentation import Beliefs, Segmentation
from contact_tracker.truth import Truth
from contact_tracker.viewer import canvas, layout
from contact_tracker.viewer.canvas import Canvas, Stamps
from contact_tracker.viewer.events import event
from contact_tracker.viewer.hull import hull
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Drawing, Extent, draw, viewpoint
from contact_tracker.viewer.sinks import PORT, Sink, close, to_file, to_viewer
from contact_tracker.whole_file import whole_file
from contact_tracker.windows import WindowCurves


def write_rrd(
    path: Path,
    poses: Poses,
    segmentation: Segmentation,
    truth: Truth | None = None,
    curves: WindowCurves | None = None,
    vertices_m: Array | None = None,
) -> None:
    """Write a rerun recording with its blueprint, whole or not at all.

    Parameters
    ----------
    path : ends in ``.rrd``.
    poses : at least one, of which ``segmentation`` was made.
    vertices_m : (V, 3) of the object in the body frame, where known: its hull is drawn faintly.

    Raises
    ------
    OSError : the file cannot be written.
    """
    with whole_file(path) as temporary:
        _show(to_file(temporary), poses, segmentation, truth, curves, vertices_m)


def open_viewer(
    poses: Poses,
    segmentation: Segmentation,
    truth: Truth | None = None,
    curves: WindowCurves | None = None,
    vertices_m: Array | None = None,
    port: int = PORT,
) -> None:
    """Show the same in the rerun viewer, and leave it open.

    Raises
    ------
    ViewerError : the viewer does not start or does not take the data.
    """
    _show(to_viewer(port), poses, segmentation, truth, curves, vertices_m)


def _show(
    sink: Sink,
    poses: Poses,
    segmentation: Segmentation,
    truth: Truth | None,
    curves: WindowCurves | None,
    vertices_m: Array | None,
) -> None:
    solid = None if vertices_m is None else hull(vertices_m)
    extent = UNKNOWN_EXTENT if solid is None else solid.extent
    recording = canvas.new_recording()
    sink(recording, layout.offline(viewpoint(poses, segmentation, extent), paper=curves is not None))
    sheet = Canvas(recording, int(poses.stamp_ns[0]), solid, extent.radius_m)
    sheet.poses(poses)
    _trail(sheet, poses, segmentation.beliefs)
    _segments(sheet, poses, segmentation, extent)
    _fade(sheet, segmentation)
    _beliefs(sheet, segmentation)
    if truth is not None:
        starts = np.array([i.start_ns for i in truth.intervals], np.int64)
        _changes(sheet, canvas.TRUTH, starts, [i.contact for i in truth.intervals])
    if curves is not None:
        sheet.scalars(canvas.PAPER, curves.stamp_ns, curves.normalised)
    close(recording)


def _trail(sheet: Canvas, poses: Poses, beliefs: Beliefs) -> None:
    """A strip per tick, joined to the one before."""
    ends = np.searchsorted(poses.stamp_ns, beliefs.stamp_ns, side="right")
    starts = np.maximum(np.concatenate([[0], ends[:-1]]) - 1, 0)
    strips = [poses.position_m[a:b] for a, b in zip(starts, ends, strict=True)]
    long = [i for i, strip in enumerate(strips) if len(strip) > 1]
    contacts = beliefs.contacts
    sheet.trail(beliefs.stamp_ns[long], [strips[i] for i in long], [contacts[i] for i in long])


def _segments(sheet: Canvas, poses: Poses, segmentation: Segmentation, extent: Extent) -> None:
    """The geometry of each segment from its start, nothing where there is none; its event."""
    segments = segmentation.segments
    starts = np.array([s.start_ns for s in segments], np.int64)
    drawings: list[Drawing | None] = []
    for segment in segments:
        first = int(np.searchsorted(poses.stamp_ns, segment.start_ns))
        last = int(np.searchsorted(poses.stamp_ns, segment.end_ns, side="right"))
        first = min(first, len(poses) - 1)
        within = poses[first : max(last, first + 1)]
        drawings.append(None if segment.geometry is None else draw(segment.geometry, within, extent))
    sheet.drawings(starts, drawings)
    origin, contacts = int(poses.stamp_ns[0]), [s.contact for s in segments]
    texts = [event(s.start_ns - origin, s.probability, s.geometry, s.inseparable) for s in segments]
    sheet.events(starts, contacts, texts)
    _changes(sheet, canvas.SMOOTHED, starts, contacts)


def _fade(sheet: Canvas, segmentation: Segmentation) -> None:
    """Each tick's probability; a segment begins with that of its first tick."""
    beliefs = segmentation.beliefs
    stamps = beliefs.stamp_ns
    begins = np.array([s.start_ns for s in segmentation.segments], np.int64)
    first = np.minimum(np.searchsorted(stamps, begins), len(beliefs) - 1)
    contacts = [*(s.contact for s in segmentation.segments), *beliefs.contacts]
    rows = np.concatenate([first, np.arange(len(beliefs))])
    probability = beliefs.probability[rows, [c.column for c in contacts]]
    times = np.concatenate([begins, stamps])
    order = np.argsort(times, kind="stable")
    sheet.fade(times[order], [contacts[i] for i in order], probability[order])


def _beliefs(sheet: Canvas, segmentation: Segmentation) -> None:
    filtered = segmentation.filtered
    stamps = filtered.stamp_ns
    sheet.scalars(canvas.P_SMOOTHED, segmentation.stamp_ns, segmentation.beliefs.probability)
    sheet.scalars(canvas.P_FILTERED, stamps, filtered.probability)
    sheet.scalars(canvas.RESIDUAL, stamps, filtered.residual)
    _changes(sheet, canvas.FILTERED, stamps, filtered.contacts)


def _changes(sheet: Canvas, entity: str, stamp_ns: Stamps, contacts: Sequence[Contact | None]) -> None:
    """Only where the state differs from the one before."""
    kept = [i for i, contact in enumerate(contacts) if i == 0 or contact is not contacts[i - 1]]
    sheet.states(entity, stamp_ns[kept], [contacts[i] for i in kept])
