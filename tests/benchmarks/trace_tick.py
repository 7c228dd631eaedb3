"""How much of the package one tick takes: files, packages, functions and Python calls.

    python tests/benchmarks/trace_tick.py recordings/paper_experiment.mcap

Twenty ticks are traced from pose 4000 on, where one filter is left. Calls of the package's own Python
functions count, comprehensions and generators included.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from cProfile import Profile
from itertools import islice
from pathlib import Path
from statistics import median
from types import CodeType
from typing import Final

import contact_tracker
from contact_tracker.cli.terminal import show
from contact_tracker.config.loading import load_model
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.recording import open_log
from contact_tracker.tracker import Tracker

FIRST_POSE: Final = 4000
TICKS: Final = 20
PACKAGE: Final = Path(contact_tracker.__file__).parent


Trace = Counter[tuple[str, str]]
"""Calls by the file and function called, from the pose that closes a tick to its belief."""


def by_file(trace: Trace) -> Counter[str]:
    """Calls by file."""
    return Counter(file for file, _ in trace.elements())


def traced_ticks(log: Path) -> list[Trace]:
    """The traces of the ``TICKS`` ticks that are closed after ``FIRST_POSE`` poses, by one filter."""
    return list(islice(_traces(log), TICKS))


def _traces(log: Path) -> Iterator[Trace]:
    tracker, gate = Tracker.start(load_model()), PoseGate()
    for number, pose in enumerate(open_log(str(log))):
        if number < FIRST_POSE:
            tracker.update(gate.arrive(pose))
            continue
        if not tracker.is_decided:
            raise SystemExit(f"several filters are left at pose {number}: trace a later one")
        with Profile(builtins=False) as profile:
            beliefs = tracker.update(gate.arrive(pose))
        if beliefs:
            yield _calls(profile)


def _calls(profile: Profile) -> Trace:
    """Calls of the package's functions; the code of built-in ones is text."""
    calls = Trace()
    for code, count, *_ in profile.getstats():
        if isinstance(code, CodeType) and (path := Path(code.co_filename)).is_relative_to(PACKAGE):
            calls[path.relative_to(PACKAGE).as_posix(), code.co_qualname] += count
    return calls


def main() -> int:
    if len(sys.argv) != 2:
        raise SystemExit("usage: python tests/benchmarks/trace_tick.py LOG")
    traces = traced_ticks(Path(sys.argv[1]))
    figures = {
        "files": [len(by_file(one)) for one in traces],
        "packages": [len({file.split("/")[0] for file in by_file(one)}) for one in traces],
        "functions": [len(one) for one in traces],
        "calls": [one.total() for one in traces],
    }
    for name, counts in figures.items():
        show(f"{name:10} median {median(counts):5.0f}  least {min(counts):5}  most {max(counts):5}")
    show("calls by file, in the tick with the fewest:")
    for file, count in by_file(min(traces, key=Trace.total)).most_common():
        show(f"{count:5}  {file}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
