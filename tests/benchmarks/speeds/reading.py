"""Reading: validated poses from a log, against bare iteration over its records with the mcap library."""

from pathlib import Path

from mcap.reader import make_reader

from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.recording import open_log
from speeds.figures import Figure, Setup, cpu_s


def measure(setup: Setup) -> list[Figure]:
    return [f for log in (setup.log, setup.fast_log) for f in _figures(log, setup.runs)]


def _figures(log: Path, runs: int) -> list[Figure]:
    opened = open_log(str(log))
    poses, topic = list(opened), opened.source.topic

    def iterate() -> None:
        with log.open("rb") as file:
            for _ in make_reader(file).iter_messages(topics=[topic], log_time_order=False):
                pass

    def read() -> None:
        for _ in open_log(str(log)):
            pass

    def read_columns() -> None:
        for _ in open_log(str(log)).batches():
            pass

    def admit() -> None:
        gate = PoseGate()
        for pose in poses:
            gate.admit(pose)

    works = (iterate, read, read_columns, admit)
    bare, whole, columns, gate = (cpu_s(work, runs) / len(poses) for work in works)
    return [
        Figure(f"{log.stem}: bare records", 1.0 / bare, "records/s"),
        Figure(f"{log.stem}: poses", 1.0 / whole, "poses/s"),
        Figure(f"{log.stem}: poses", 1e6 * whole, "us per pose", "<= 15"),
        Figure(f"{log.stem}: in columns, as offline", 1e6 * columns, "us per pose"),
        Figure(f"{log.stem}: time over that of bare records", whole / bare, "x"),
        Figure(f"{log.stem}: gate alone", 1e6 * gate, "us per pose"),
    ]
