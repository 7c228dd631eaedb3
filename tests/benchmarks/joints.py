"""Accuracy of joints, and false ones.

    python tests/benchmarks/joints.py --seeds 20
    python tests/benchmarks/joints.py --single FOLDER/physics/robot --tables docs/benchmarks/joints.json

An object in each joint is simulated for some seconds with seeds 1, 2, ... (0.3 mm, 0.15 deg, 200 Hz), and
segmented. ``true kind`` is the share of the time with a reported joint of the true kind, ``other kind`` with
one of another kind. Angle, distance and pitch are medians of the errors of axes and centres, in the body and
in the world, at their points nearest to the body's origin; ``within 3 sd`` is the share of these elements;
both in the longest segment with the true kind.

``false`` is the share of the time with a reported joint although the object is in one contact, or free: in
simulated motion by hand, and in the recordings of ``--single`` folders. In these an object may turn about one
axis or move along one direction, as in a joint; ``of which singular`` is the share where the truth says so.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import read_truth
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.geometry_errors import angle_rad, deviation, distance_m, places
from contact_tracker_lab.evaluation.tables import number
from contact_tracker_lab.simulate import Phase, Scenario, named_scenario, simulate
from contact_tracker_lab.simulate.jointed import TrueJoint
from summaries import NAN, duration_s, median_of_known, read_gated, recordings_in, share_within_3, shares_row

COLUMNS: Final = (
    *("joint", "seconds", "recordings", "true kind", "other kind"),
    *("angle, deg", "distance, mm", "pitch, mm/rad", "within 3 sd"),
)

FALSE_COLUMNS: Final = ("recordings without a joint", "seconds", "false", "of which singular")


class Measured(NamedTuple):
    """Figures of one recording with a joint; nan where there is none."""

    named: float
    other: float
    angle_deg: tuple[float, ...] = ()
    distance_mm: tuple[float, ...] = ()
    pitch_mm: float = NAN
    deviations_sd: tuple[float, ...] = ()


class Without(NamedTuple):
    """Times (s) in one recording without a joint: its duration, with a reported joint, and singular ones."""

    seconds: float
    named_s: float
    singular_s: float


def measure(kind: JointKind, seconds: float, seed: int) -> Measured:
    """Simulate an object in a joint, segment and evaluate."""
    scenario = named_scenario(kind.value, seed)
    (phase,) = scenario.phases
    made = simulate(replace(scenario, phases=(phase._replace(duration_s=seconds),)), seed)
    assert made.joint is not None
    poses = gate(made.poses)
    segments = _segments(poses)
    whole = sum(duration_s(one) for one in segments)
    right = [one for one in segments if one.joint is not None and one.joint.kind is kind]
    named = sum(map(duration_s, right)) / whole
    other = sum(duration_s(one) for one in segments if one.joint is not None) / whole - named
    if not right:
        return Measured(named, other)
    best = max(right, key=duration_s)
    assert best.joint is not None
    inside = (poses.stamp_ns >= best.start_ns) & (poses.stamp_ns <= best.end_ns)
    return _errors(best.joint, made.joint, poses[inside])._replace(named=named, other=other)


def _errors(found: Joint, true: TrueJoint, poses: Poses) -> Measured:
    pairs = (found.object, true.object), (found.environment, true.environment)
    near = places(ContactGeometry(true.object, true.environment), poses)
    errors = [
        (np.degrees(angle_rad(a, b)), 1e3 * distance_m(a, place), deviation(a, b, place).sd)
        for (a, b), place in zip(pairs, near, strict=True)
    ]
    angle, distance, sd = (tuple(float(one) for one in column) for column in zip(*errors, strict=True))
    pitch = NAN
    if found.kind is JointKind.SCREW and found.pitch_m_per_rad is not None and true.pitch_m_per_rad:
        pitch = 1e3 * abs(found.pitch_m_per_rad - true.pitch_m_per_rad)
    return Measured(0.0, 0.0, angle, distance, pitch, sd)


def measure_alone(name: str, seed: int) -> Without:
    """Simulate an object in one contact, or in none, moved by hand."""
    made = simulate(Scenario((Phase(Contact(name), 24.0),), name="alone"), seed)
    return _false(gate(made.poses), made.truth)


def measure_file(path: str) -> Without:
    """Segment a recording; singular motion is also counted separately."""
    return _false(read_gated(path), read_truth(path))


def _false(poses: Poses, truth: Truth | None) -> Without:
    found = [segment for segment in _segments(poses) if segment.joint is not None]
    singular_ns = sum(
        max(min(one.end_ns, interval.end_ns) - max(one.start_ns, interval.start_ns), 0)
        for one in found
        for interval in (truth.intervals if truth is not None else ())
        if interval.singular
    )
    return Without(duration_s(poses), sum(map(duration_s, found)), singular_ns * 1e-9)


def _segments(poses: Poses) -> tuple[Segment, ...]:
    return tuple(segmenting.segment(poses, load_model()).segments)


def row(kind: JointKind, seconds: float, found: Sequence[Measured]) -> list[str]:
    """A row of the table of joints."""
    figures = (
        float(np.mean([one.named for one in found])),
        float(np.mean([one.other for one in found])),
        median_of_known([one for each in found for one in each.angle_deg]),
        median_of_known([one for each in found for one in each.distance_mm]),
        median_of_known([one.pitch_mm for one in found]),
        share_within_3([one for each in found for one in each.deviations_sd]),
    )
    return [kind.value, f"{seconds:g}", str(len(found)), *map(number, figures)]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="number of each (default: %(default)s)")
    parser.add_argument("--seconds", type=float, nargs="+", default=[2.5, 5.0, 24.0], metavar="S")
    parser.add_argument("--single", nargs="+", type=Path, default=[], metavar="FOLDER")
    args = parser.parse_args()
    seeds = range(1, args.seeds + 1)
    joints = {
        (kind, seconds): [(kind, seconds, seed) for seed in seeds]
        for kind in JointKind
        for seconds in args.seconds
    }
    rows = [row(*which, found) for which, found in measured(measure, joints, args.processes)]
    by_hand = {f"{state.value}, by hand": [(state.value, seed) for seed in seeds] for state in STATES}
    without = [*measured(measure_alone, by_hand, args.processes)]
    without += measured(measure_file, recordings_in(args.single), args.processes)
    false_rows = [shares_row(name, found) for name, found in without]
    return report(args, joints=Table(COLUMNS, rows), false=Table(FALSE_COLUMNS, false_rows))


if __name__ == "__main__":
    sys.exit(main())
