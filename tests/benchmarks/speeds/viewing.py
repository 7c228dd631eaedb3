"""Writing for the viewer: poses per second, streamed with each belief and as a whole recording."""

from collections import deque
from collections.abc import Callable, Iterable
from itertools import islice, pairwise
from typing import Final

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.tick_averaging import TickGrid
from contact_tracker.recording import open_log, read_metadata
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.viewer.live import LiveViewer
from contact_tracker.viewer.offline import Shown, write_rrd
from contact_tracker.viewer.scene import vertices_from_metadata
from contact_tracker.viewer.sinks import to_file
from speeds.figures import Figure, Setup, cpu_s

SECONDS: Final = 20.0


def measure(setup: Setup) -> list[Figure]:
    model, log = load_model(setup.model), str(setup.log)
    vertices = vertices_from_metadata(read_metadata(log))
    poses = _beginning(log)
    grid, one, tracked = TickGrid(model), ContactFilter.start(model), list[tuple[Pose, Belief | None]]()
    for pose in poses:
        beliefs = [one.update(tick) for tick in grid.add(Poses.collect([pose]))]
        tracked.append((pose, beliefs[-1] if beliefs else None))
    segmentation, path = segment(poses, model), setup.scratch / "view.rrd"

    def stream() -> None:
        with LiveViewer(vertices, to_file(path)) as viewer:
            for pose, belief in tracked:
                viewer.pose(pose)
                if belief is not None:
                    viewer.belief(belief)

    def segmented(poses: Iterable[Pose]) -> list[Segmentation]:
        deque(poses, maxlen=0)
        return [segmentation]

    def write() -> None:
        write_rrd(path, Shown(poses, segmented, vertices_m=vertices))

    def rate(work: Callable[[], None]) -> float:
        return len(poses) / cpu_s(work, setup.runs)

    return [
        Figure("viewer, streamed", rate(stream), "poses/s"),
        Figure("viewer, whole recording", rate(write), "poses/s"),
    ]


def _beginning(log: str) -> list[Pose]:
    """The poses of the first seconds."""
    poses = list(islice(open_log(log), 1_000_000))
    ends = [i for i, (_, b) in enumerate(pairwise(poses)) if b.stamp_ns - poses[0].stamp_ns > 1e9 * SECONDS]
    return poses[: ends[0] + 1] if ends else poses
