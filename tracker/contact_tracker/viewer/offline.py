"""A whole recording with its segmentation: written to a file or shown in the viewer, piece by piece."""

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path

from contact_tracker.atomic_file import whatever_is_there, whole_file
from contact_tracker.geometry.elements import Array
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Pose
from contact_tracker.tracking.pose_buffer import Pieces, watched
from contact_tracker.viewer import canvas, layout
from contact_tracker.viewer.segmentation_view import Painter
from contact_tracker.viewer.sinks import PORT, Sink, close, to_file, to_viewer


def write_rrd(
    path: Path,
    poses: Iterable[Pose],
    pieces: Pieces,
    truth: Truth | None = None,
    vertices_m: Array | None = None,
    paper: bool = False,
    check: Callable[[], None] = whatever_is_there,
) -> None:
    """Write a rerun recording with its blueprint, whole or not at all.

    Memory grows while one contact lasts, by what ``paper`` keeps (70 bytes per ten poses), and by what rerun
    notes of each chunk for the end of the file.

    Parameters
    ----------
    path : ends in ``.rrd``.
    poses : at least one.
    pieces : what segments them.
    vertices_m : (V, 3) of the object in the body frame, where known: its hull is drawn faintly.
    paper : whether to draw the paper's objective functions as well.
    check : of what is replaced, as of ``whole_file``.

    Raises
    ------
    OSError : the file cannot be written.
    """
    with whole_file(path, check) as temporary:
        _show(to_file(temporary), poses, pieces, truth, vertices_m, paper)


def open_viewer(
    poses: Iterable[Pose],
    pieces: Pieces,
    truth: Truth | None = None,
    vertices_m: Array | None = None,
    paper: bool = False,
    port: int = PORT,
) -> None:
    """Show the same in the rerun viewer while it is found, and leave it open.

    Raises
    ------
    ViewerError : the viewer does not start or does not take the data.
    """
    _show(to_viewer(port), poses, pieces, truth, vertices_m, paper, watching=True)


def _show(
    sink: Sink,
    poses: Iterable[Pose],
    pieces: Pieces,
    truth: Truth | None,
    vertices_m: Array | None,
    paper: bool,
    watching: bool = False,
) -> None:
    """From where to look is known at the end; who is ``watching`` needs a layout before."""
    rest = iter(poses)
    first = next(rest)
    recording = canvas.new_recording()
    sink(recording, layout.offline(None, paper) if watching else None)
    painter = Painter(recording, first.stamp_ns, vertices_m, paper)
    for piece in watched(chain([first], rest), pieces, painter.poses):
        painter.piece(piece)
    painter.finish(truth)
    recording.send_blueprint(layout.offline(painter.viewpoint, paper), make_active=watching)
    close(recording)
