"""Writes logs of robots with their truth, for the benchmark and the sensitivity to constants.

    python tests/benchmarks/robot_logs.py FOLDER
    python -m contact_tracker_lab.benchmark FOLDER --only tracker
    python tests/benchmarks/sensitivity.py FOLDER/*/*.mcap --only CAME_TO_REST

A robot slides and tilts a part on a table and carries it, along straight lines and with exact poses, rounded
to 1 um. In the sets ``carry`` it only carries it; with ``turns`` the part turns on the way, about its centre.
``noise`` has 0.1 mm and 0.03 deg.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import write_recording
from contact_tracker.states import STATES
from robot_moves import logged, pick_and_place

LOGS: Final = 3
"""Number of logs of each set."""


class LogSet(NamedTuple):
    rate_hz: float
    slides: bool = True
    turn_rad: float = 0.0
    noise: tuple[float, float] = (0.0, 0.0)


SETS: Final = {
    "slide_tilt_carry_30hz": LogSet(30.0),
    "slide_tilt_carry_125hz": LogSet(125.0),
    "slide_tilt_carry_500hz": LogSet(500.0),
    "carry_125hz": LogSet(125.0, slides=False),
    "slide_tilt_carry_turns_125hz": LogSet(125.0, turn_rad=0.4),
    "carry_turns_125hz": LogSet(125.0, slides=False, turn_rad=0.4),
    "slide_tilt_carry_turns_noise_125hz": LogSet(125.0, turn_rad=0.4, noise=(1e-4, 5e-4)),
}


def write_log(path: Path, made: LogSet, seed: int) -> None:
    """Write one log of the set."""
    robot = pick_and_place(made.rate_hz, seed, made.turn_rad, made.slides)
    trajectory, columns = logged(robot, seed, made.noise)
    changes = np.flatnonzero(np.diff(columns, prepend=-1, append=-1))
    stamp_ns = trajectory.stamp_ns
    intervals = tuple(
        TruthInterval(int(stamp_ns[first]), int(stamp_ns[end - 1]), STATES[columns[first]])
        for first, end in pairwise(changes.tolist())
    )
    write_recording(str(path), Poses.collect(trajectory), Truth(intervals), {})


def main() -> int:
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=described)
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    for name, made in SETS.items():
        (args.folder / name).mkdir(parents=True, exist_ok=True)
        for seed in range(LOGS):
            write_log(args.folder / name / f"{name}_{seed}.mcap", made, seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
