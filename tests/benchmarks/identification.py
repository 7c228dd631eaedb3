"""Accuracy of identification on sets of labelled recordings: of the tracker, and of alternatives.

    python tests/benchmarks/identification.py --set paper sequence
    python tests/benchmarks/identification.py FOLDER --tables docs/benchmarks/identification.json

A set is a folder with .mcap files; its figures are computed from the sum over its recordings, of identifiable
motion. The tracker makes one pass over each; the alternatives are described in ``fixed_windows`` and
``segment_bic``. ``5-95 %`` is a bootstrap interval of the accuracy over the true phases, ``delay`` the median
time from a true onset until the label is right for 0.3 s, plus the lag; errors of elements are medians.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final, NamedTuple

import fixed_windows
import segment_bic
import tracking
from contact_tracker.config.loading import load_model
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors, geometry_errors
from contact_tracker_lab.evaluation.metrics import quantile
from contact_tracker_lab.evaluation.scoring import scoring
from contact_tracker_lab.evaluation.tables import number
from fixed_windows import Recorded, Windows
from runner import Table, find_sets, measured, parser_of, show
from scores import OFFLINE, Method, Score, Scores, total

TOTAL: Final = "all sets"
COLUMNS: Final = (
    *("set", "mode", "accuracy", "5-95 %", "F1", "delay, s", "log-loss", "ECE", "sure and wrong"),
    *("angle, deg", "distance, mm", "within 3 sd"),
)
SHOWN: Final = ("offline", "lag 1 s", "online")


class Measured(NamedTuple):
    """Results on one recording.

    ``scores`` by method; ``geometry`` of the tracker's segments, without singular motion; ``recorded`` is the
    input of the method that is calibrated on the whole set.
    """

    scores: Scores
    geometry: GeometryErrors
    recorded: Recorded


class Total(NamedTuple):
    """Sums over recordings."""

    scores: Scores
    geometry: GeometryErrors


def measure(path: Path, model_name: str) -> Measured:
    """Track and evaluate one recording; raises ContactTrackerError if it cannot be used."""
    model, truth = load_model(model_name), need_truth(str(path))
    poses = Poses.collect(open_log(str(path)))
    tracked = tracking.track(poses, model)
    scored, windows = scoring(poses.stamp_ns, truth), Windows.of(poses)
    answers = {
        **tracking.answers(poses, tracked),
        **fixed_windows.smallest_answers(windows, poses.stamp_ns),
        **segment_bic.answers(poses, scored, tracked, model),
    }
    return Measured(
        {method: Score.of(answer, scored) for method, answer in answers.items()},
        geometry_errors(poses, identifiable(truth), tracked.segmentation.segments),
        Recorded(windows, scored),
    )


def identifiable(truth: Truth) -> Truth:
    """The truth without the elements of singular intervals, whose motion does not determine them."""
    return Truth(tuple(replace(i, geometry=None) if i.singular else i for i in truth.intervals))


def summed(found: Sequence[Measured], calibrated: Sequence[Scores]) -> Total:
    """Sums over at least one recording, with the scores of the method that is calibrated on the set."""
    each = [one.scores | more for one, more in zip(found, calibrated, strict=True)]
    scores = {method: total([one[method] for one in each]) for method in each[0]}
    return Total(scores, reduce(add, (one.geometry for one in found)))


def tracker_row(name: str, method: Method, whole: Total) -> list[str]:
    """Figures of the tracker in one mode."""
    main, geometry, is_offline = whole.scores[method].main, whole.geometry, method.wait_s == OFFLINE
    low, high = map(number, whole.scores[method].phases.accuracy())
    delay_s = main.detection_delay_s
    found_s = delay_s[delay_s == delay_s]  # nan where an onset was missed
    elements = (quantile(geometry.angle_deg, 0.5), quantile(geometry.distance_mm, 0.5), geometry.within_3_sd)
    return [
        name,
        method.when,
        number(main.accuracy()),
        low if low == high else f"{low}-{high}",
        number(main.macro_f1),
        "-" if is_offline else number(quantile(found_s, 0.5) + method.wait_s, 2),
        number(main.log_loss),
        number(main.calibration_error),
        number(main.sure_wrong),
        *(number(value, 2) if is_offline else "-" for value in elements),
    ]


def in_order(scores: Scores) -> list[Method]:
    """Each method from offline to online."""
    names = list(dict.fromkeys(method.name for method in scores))
    return sorted(scores, key=lambda m: (names.index(m.name), -m.wait_s))


def tables(totals: Mapping[str, Total]) -> dict[str, Table]:
    """Figures of the tracker by set, and its accuracy beside the alternatives."""
    by_set, compared = list[list[str]](), list[list[str]]()
    others = list[Method]()
    for name, whole in totals.items():
        methods = in_order(whole.scores)
        by_set += [
            tracker_row(name, m, whole) for m in methods if m.name == tracking.NAME and m.when in SHOWN
        ]
        others = [method for method in methods if method.when in ("offline", "online")]
        seconds = next(iter(whole.scores.values())).main.seconds()
        accuracies = (number(whole.scores[method].main.accuracy()) for method in others)
        compared.append([name, f"{seconds:.0f}", *accuracies])
    columns = ("set", "scored, s", *(f"{method.name} {method.when}" for method in others))
    return {"tracker": Table(COLUMNS, by_set), "alternatives": Table(columns, compared)}


def main() -> int:
    parser = parser_of(__doc__, has_sets=True)
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    args = parser.parse_args()
    sets = find_sets(args.folder, args.set)
    jobs = {name: [(path, args.model) for path in paths] for name, paths in sets.items()}
    found = dict(measured(measure, jobs, args.processes))
    model = load_model(args.model)
    calibrations = {name: [([one.recorded for one in some], model)] for name, some in found.items()}
    totals, everything = dict[str, Total](), list[tuple[Measured, Scores]]()
    for name, (calibrated,) in measured(fixed_windows.hmm_scores, calibrations, args.processes):
        totals[name] = summed(found[name], calibrated)
        everything += zip(found[name], calibrated, strict=True)
    if len(totals) > 1:
        totals[TOTAL] = summed(*zip(*everything, strict=True))
    return show(args, **tables(totals))


if __name__ == "__main__":
    sys.exit(main())
