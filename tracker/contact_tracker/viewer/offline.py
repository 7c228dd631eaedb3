"""View of a whole recording with its segmentation, written to a file or shown in a viewer."""

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from contact_tracker.atomic_file import accept_any, whole_file
from contact_tracker.errors import NoPoses
from contact_tracker.geometry.elements import Array
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Pose
from contact_tracker.tracking.pose_buffer import Pieces, with_pose_callback
from contact_tracker.viewer import canvas, layout
from contact_tracker.viewer.segmentation_view import Painter
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
    """

    poses: Iterable[Pose]
    pieces: Pieces
    truth: Truth | None = None
    vertices_m: Array | None = None
    paper: bool = False
    name: str | None = None
    origin_ns: Callable[[], int] | None = None


def write_rrd(path: Path, shown: Shown, check: Callable[[], None] = accept_any) -> None:
    """Write a rerun file with its layout, atomically; ``check`` as of ``whole_file``.

    Memory grows during one contact, with ``paper`` (70 bytes per ten poses), and by rerun's index of chunks.

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
    sink(recording, layout.offline(shown.paper, is_one_of_several))
    painter = Painter(recording, origin_ns, shown.vertices_m, shown.paper)
    for piece in with_pose_callback(chain([first], rest), shown.pieces, painter.poses):
        painter.piece(piece)
    painter.finish(shown.truth)
    close(recording)
