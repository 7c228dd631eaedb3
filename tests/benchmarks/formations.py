"""Accuracy of further contacts, beside the labelled one.

    python tests/benchmarks/formations.py --seeds 20
    python tests/benchmarks/formations.py --single recordings --tables formations.json

Scenarios with a further contact, and with one contact alone, are simulated with seeds 1, 2, ... (0.3 mm,
0.15 deg, 200 Hz, 24 s). ``found`` is the share of the recordings in which the first contact is labelled and
the true kind of the further one is reported, or reported as inseparable (``kind open``: only so); if the
first one is reported as ambiguous, it counts as ``label open``. ``within 3 sd`` is the share of the elements
of correctly reported contacts. ``start error`` and ``end error`` of a further contact are median absolute
errors (s) over the recordings that have one. ``false`` is the share of the time with a false further
contact, in the simulated recordings and in those of ``--single`` folders, offline and online. ``found
online`` is the share of the time of the further contact in which it is reported online, with its kind or an
inseparable one, and ``delay online`` the median time (s) until the first report.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.config.loading import load_model
from contact_tracker.ground_truth import FurtherTruth, Truth, TruthInterval
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import read_truth
from contact_tracker.segmenting import segmented
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail, FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.trajectory import Trajectory
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.geometry_errors import geometry_errors
from contact_tracker_lab.evaluation.tables import number
from contact_tracker_lab.simulate import Phase, Scenario, simulate
from contact_tracker_lab.simulate.scenarios import FORMATIONS
from summaries import (
    NAN,
    duration_s,
    mean_of_known,
    median_of_known,
    read_gated,
    recordings_in,
    share_within_3,
    shares_row,
)

ALONE: Final = {
    f"{contact.value} alone": Scenario((Phase(contact, 24.0),), name="alone")
    for contact in (Contact.FF, Contact.EF, Contact.VF)
}
"""Scenarios with one contact. (Two vertices on the table would be an edge.)"""
COLUMNS: Final = (
    *("scenario", "recordings", "found offline", "kind open", "label open", "within 3 sd"),
    *("start error, s", "end error, s", "false offline"),
    *("found online", "delay online, s", "false online"),
)

SINGLE_COLUMNS: Final = ("recordings of single contacts", "seconds", "false offline", "false online")
MARGIN_NS: Final = 300_000_000
"""Beside the true time, in which a report online is not false."""


class Measured(NamedTuple):
    """Figures of one recording; nan where one does not apply."""

    found: float = NAN
    is_open: float = NAN
    ambiguous: float = NAN
    deviations_sd: tuple[float, ...] = ()
    joins_s: float = NAN
    leaves_s: float = NAN
    false_s: float = 0.0
    online: float = NAN
    delay_s: float = NAN
    false_online_s: float = 0.0
    seconds: float = 0.0
    online_seconds: float = 0.0


def measure(name: str, seed: int, online: bool) -> Measured:
    """Simulate, segment and evaluate one recording, with ``online`` also its online beliefs."""
    made = simulate(ALONE.get(name, name), seed)
    segmentation = _segmented(gate(made.poses), online)
    interval = made.truth.intervals[0]
    if not interval.further:
        return single(segmentation, made.poses)
    return _evaluated(segmentation, made.poses, interval, interval.further[0])


def measure_file(path: str) -> Measured:
    """Segment a recording of single contacts; others have no figures."""
    truth = read_truth(path)
    if truth is not None and any(interval.further for interval in truth.intervals):
        return Measured()
    poses = read_gated(path)
    return single(_segmented(poses, True), poses)


def _segmented(poses: Poses, online: bool) -> Segmentation:
    detail = Detail.FORMATION if online else Detail.WEIGHTS
    return segmented(Trajectory(poses), load_model(), detail=detail).segmentation


def single(found: Segmentation, poses: Poses) -> Measured:
    """Figures of a recording without further contacts: all reported ones are false."""
    spans = [(one.start_ns, _end(one)) for segment in found.segments for one in segment.further]
    online = sum(1 for belief in found.filtered if belief.further)
    return Measured(
        false_s=sum(end - start for start, end in spans) * 1e-9,
        false_online_s=online * _tick_s(found),
        seconds=duration_s(poses),
        online_seconds=duration_s(poses) if len(found.filtered) else 0.0,
    )


def _evaluated(found: Segmentation, poses: Poses, first: TruthInterval, second: FurtherTruth) -> Measured:
    right = [one for segment in found.segments for one in segment.further if _overlap(one, second) > 0]
    best = max(right, key=lambda one: _overlap(one, second), default=None)
    label = max(found.segments, key=duration_s)
    is_first = label.contact is first.contact
    ambiguous = not is_first or len(label.inseparable) > 1
    named = best is not None and is_first and _names(best, second)
    deviations = _deviations(poses, (first, second), (label, best)) if named and best is not None else ()
    begins, ends = second.start_ns > first.start_ns, second.end_ns < first.end_ns
    false_ns = sum(
        _end(one) - one.start_ns - max(_overlap(one, second), 0)
        for segment in found.segments
        for one in segment.further
        if one is not best
    )
    beliefs, span = list(found.filtered), (second.start_ns, second.end_ns)
    inside = [belief for belief in beliefs if span[0] <= belief.stamp_ns <= span[1]]
    true_reports = [belief for belief in inside if any(_names(one, second) for one in belief.further)]
    right_ns = {
        belief.stamp_ns
        for belief in beliefs
        if span[0] - MARGIN_NS <= belief.stamp_ns <= span[1] + MARGIN_NS
        and all(_names(one, second) for one in belief.further)
    }
    false_online = sum(bool(belief.further) and belief.stamp_ns not in right_ns for belief in beliefs)
    return Measured(
        float(named or (ambiguous and best is None)),
        float(named and best is not None and best.contact is not second.contact),
        float(ambiguous and not named),
        tuple(deviations),
        abs(best.start_ns - second.start_ns) * 1e-9 if best is not None and begins else NAN,
        abs(_end(best) - second.end_ns) * 1e-9 if best is not None and ends else NAN,
        false_ns * 1e-9,
        len(true_reports) / len(inside) if inside else NAN,
        (true_reports[0].stamp_ns - second.start_ns) * 1e-9 if true_reports else NAN,
        false_online * _tick_s(found),
        duration_s(poses),
        duration_s(poses) if beliefs else 0.0,
    )


def _names(one: FurtherContact, true: FurtherTruth) -> bool:
    return true.contact in (one.contact, *one.inseparable)


def _deviations(
    poses: Poses, true: tuple[TruthInterval, FurtherTruth], found: tuple[Segment, FurtherContact]
) -> tuple[float, ...]:
    """Errors of all elements in standard deviations. Two contacts of one kind may be in either order."""
    first, second = true
    label, further = found
    span = second.start_ns, second.end_ns
    true_pair = [
        TruthInterval(*span, contact, geometry=geometry)
        for contact, geometry in ((first.contact, first.geometry), (second.contact, second.geometry))
    ]
    found_pair = [Segment(*span, one.contact, 1.0, one.geometry) for one in (label, further)]
    orders = [
        [
            error.deviation.sd
            for one, other in zip(true_pair, order, strict=True)
            if one.contact is other.contact
            for error in geometry_errors(poses, Truth((one,)), [other]).rows
            if np.isfinite(error.deviation.sd)
        ]
        for order in (found_pair, found_pair[::-1] if label.contact is further.contact else found_pair)
    ]
    return tuple(min(orders, key=lambda deviations: sum(deviations)))


def _overlap(one: FurtherContact, true: FurtherTruth) -> int:
    return min(_end(one), true.end_ns) - max(one.start_ns, true.start_ns)


def _end(one: FurtherContact) -> int:
    assert one.end_ns is not None
    return one.end_ns


def _tick_s(found: Segmentation) -> float:
    return float(np.median(np.diff(found.filtered.stamp_ns))) * 1e-9 if len(found.filtered) > 1 else 0.0


def row(name: str, found: Sequence[Measured]) -> list[str]:
    """A row of the table of scenarios."""
    seconds = sum(one.seconds for one in found)
    online_seconds = sum(one.online_seconds for one in found)
    figures = (
        mean_of_known([one.found for one in found]),
        mean_of_known([one.is_open for one in found]),
        mean_of_known([one.ambiguous for one in found]),
        share_within_3([sd for one in found for sd in one.deviations_sd]),
        median_of_known([one.joins_s for one in found]),
        median_of_known([one.leaves_s for one in found]),
        sum(one.false_s for one in found) / seconds,
        mean_of_known([one.online for one in found]),
        median_of_known([one.delay_s for one in found]),
        sum(one.false_online_s for one in found) / online_seconds if online_seconds else NAN,
    )
    return [name, str(len(found)), *(number(figure) for figure in figures)]


def main() -> int:
    parser = parser_of(__doc__)
    names = [*FORMATIONS, *ALONE]
    parser.add_argument("--seeds", type=int, default=3, help="number of each scenario (default: %(default)s)")
    parser.add_argument(
        "--online", type=int, default=1000, metavar="N", help="the first N also online (default: all)"
    )
    parser.add_argument("--only", nargs="+", default=names, choices=names, metavar="NAME")
    parser.add_argument("--single", nargs="+", type=Path, default=[], metavar="FOLDER")
    args = parser.parse_args()
    seeds = range(1, args.seeds + 1)
    jobs = {name: [(name, seed, seed <= args.online) for seed in seeds] for name in args.only}
    rows = [row(*which) for which in measured(measure, jobs, args.processes)]
    singles = [
        shares_row(name, [(one.seconds, one.false_s, one.false_online_s) for one in found])
        for name, found in measured(measure_file, recordings_in(args.single), args.processes)
    ]
    return report(args, scenarios=Table(COLUMNS, rows), singles=Table(SINGLE_COLUMNS, singles))


if __name__ == "__main__":
    sys.exit(main())
