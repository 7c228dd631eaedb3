"""Accuracy of the geometry, relative to the Cramer-Rao bound, to the paper's table and to its covariance.

    python tests/benchmarks/geometry.py --seeds 60
    python tests/benchmarks/geometry.py FOLDER --set paper sequence --noise mocap

Simulated: intervals of one known contact, fitted to all their ticks. FOLDER: sets of labelled recordings, a
folder each, segmented by the tracker; without one, only the simulation.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import chi2

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import estimate_noise
from contact_tracker.paper.objectives import REPORTED_ERRORS
from contact_tracker.recording import need_truth, open_log
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker_lab.benchmark.runner import Table, find_sets, measured, parser_of, report
from contact_tracker_lab.evaluation.bound import angles_and_distances, cramer_rao, errors_at_bound
from contact_tracker_lab.evaluation.geometry_errors import SIDES, Deviation, ElementError, geometry_errors
from contact_tracker_lab.evaluation.scoring import Scoring, scoring
from contact_tracker_lab.evaluation.tables import number, table
from shared_recordings import SHARED_RECORDINGS
from simulated_fits import NOISES, Fitted, fit_simulated

BAND: Final = 0.95
MOSTLY: Final = 0.5
SIMULATED: Final = ("noise", "contact", "side", "error", "median", "bound", "x bound", "NEES", "95 % band")
AGAINST_PAPER: Final = ("contact", "side", "error", "n", "median", "worst", "bound", "paper's")
COVARIANCE: Final = ("set", "elements", "n", "NEES", "95 % band", "median", "within 95 %")


def over_bound(error: Array, bound: Array) -> tuple[float, float, float]:
    """Median of errors (n, d), median of their bounds (n, d, d), and the ratio of both.

    The ratio is the median of |error| / bound, relative to that of errors drawn from the bound.
    """
    least = np.sqrt(np.trace(bound, axis1=1, axis2=2))
    size = np.linalg.norm(error, axis=1)
    worse = np.median(size / least) / np.median(errors_at_bound(bound) / least[:, None])
    return float(np.median(size)), float(np.median(least)), float(worse)


def mean_deviation(deviations: Iterable[Deviation]) -> tuple[float, float, float]:
    """Mean normalised squared error per degree of freedom, and its band for correct covariances."""
    known = [d for d in deviations if d.freedom]
    freedom = sum(d.freedom for d in known)
    if not freedom:
        return float("nan"), float("nan"), float("nan")
    low, high = chi2.ppf([(1 - BAND) / 2, (1 + BAND) / 2], freedom) / freedom
    return sum(d.squared for d in known) / freedom, float(low), float(high)


def simulation_rows(name: str, contact: Contact, found: Sequence[Fitted]) -> Iterator[list[str]]:
    for side, title in enumerate(SIDES):
        error, bound = (np.array([getattr(f, key)[side] for f in found]) for key in ("error", "bound"))
        nees, low, high = mean_deviation(f.deviation[side] for f in found)
        for kind, part in angles_and_distances(contact, side, error.shape[1]):
            size, least, worse = over_bound(error[:, part], bound[:, part, part])
            unit, per = ("deg", float(np.degrees(1.0))) if kind == "angle" else ("mm", 1e3)
            figures = number(size * per, 4), number(least * per, 4), number(worse, 2), number(nees, 2)
            yield [name, contact.value, title, f"{kind} {unit}", *figures, f"{low:.2f}-{high:.2f}"]


class RecordingErrors(NamedTuple):
    """The errors of one recording, and the bounds (rms; deg, mm) of its true segments by contact and side."""

    rows: tuple[ElementError, ...]
    bounds: dict[tuple[Contact, str], tuple[float, float]]


def measure(path: Path) -> RecordingErrors:
    """Compare the elements found in a recording; bounds are for the measured motion and estimated noise."""
    poses, truth = Poses.collect(open_log(str(path))), need_truth(str(path))
    bounds = {}
    for interval in truth.intervals:
        inside = poses[(poses.stamp_ns >= interval.start_ns) & (poses.stamp_ns <= interval.end_ns)]
        if interval.contact is None or interval.geometry is None or interval.motion == "rest":
            continue
        model = CONTACT_MODELS[interval.contact.column]
        least = cramer_rao(model, interval.geometry, inside, estimate_noise(poses))
        for number_, (side, bound) in enumerate(zip(SIDES, least, strict=True)):
            parts = angles_and_distances(interval.contact, number_, len(bound))
            rms = {kind: float(np.sqrt(np.trace(bound[part, part]))) for kind, part in parts}
            angle_rad, distance_m = (rms.get(kind, float("nan")) for kind in ("angle", "distance"))
            bounds[interval.contact, side] = float(np.degrees(angle_rad)), 1e3 * distance_m
    found = correctly_labelled(segment(poses, load_model()).segments, scoring(poses.stamp_ns, truth))
    return RecordingErrors(geometry_errors(poses, truth, found).rows, bounds)


def correctly_labelled(segments: Iterable[Segment], scored: Scoring) -> list[Segment]:
    """Segments whose label is true for most of their time; elements of others have no true ones."""

    def share(segment: Segment) -> float:
        inside = (scored.stamp_ns >= segment.start_ns) & (scored.stamp_ns <= segment.end_ns)
        return float(np.mean(scored.truth[inside] == segment.contact.column)) if inside.any() else 0.0

    return [segment for segment in segments if share(segment) > MOSTLY]


def paper_rows(recordings: Sequence[RecordingErrors]) -> Iterator[list[str]]:
    for (contact, side), best in REPORTED_ERRORS.items():
        errors = [row for one in recordings for row in one.rows if (row.contact, row.side) == (contact, side)]
        least = [one.bounds[contact, side] for one in recordings if (contact, side) in one.bounds]
        for column, kind in enumerate(("angle deg", "distance mm")):
            values = [(row.angle_deg, row.distance_mm)[column] for row in errors]
            if not np.isnan(best[column]) and values:
                bound = number(float(np.median([b[column] for b in least])), 3)
                middle, worst = number(float(np.median(values)), 3), number(max(values), 3)
                yield [contact.value, side, kind, str(len(values)), middle, worst, bound, f"{best[column]:g}"]


def covariance_rows(name: str, rows: Sequence[ElementError]) -> Iterator[list[str]]:
    for kind in ("plane", "line", "point", "all"):
        some = [row.deviation for row in rows if kind in (row.kind, "all") and row.deviation.freedom]
        if some:
            nees, low, high = mean_deviation(some)
            middle = float(np.median([d.squared / d.freedom for d in some]))
            within = float(np.mean([d.squared <= chi2.ppf(BAND, d.freedom) for d in some]))
            figures = number(nees, 2), f"{low:.2f}-{high:.2f}", number(middle, 2), number(within, 2)
            yield [name, kind, str(len(some)), *figures]


def summary(rows: Sequence[list[str]]) -> Table:
    """Medians of the errors by noise and contact, over both elements, and their worst ratios."""
    columns = "noise", "contact", "angle, deg", "distance, mm", "worst ratio to bound", "NEES"
    kept = list[list[str]]()
    for noise, contact in dict.fromkeys((row[0], row[1]) for row in rows):
        some = [row for row in rows if (row[0], row[1]) == (noise, contact)]
        cells = [noise, contact]
        for kind in ("angle", "distance"):
            medians = [float(row[4]) for row in some if row[3].startswith(kind)]
            cells.append(" to ".join(dict.fromkeys(f"{end(medians):g}" for end in (min, max) if medians)))
        nees = [float(row[7]) for row in some]
        kept.append([*cells, f"{max(float(row[6]) for row in some):g}", f"{min(nees):g} to {max(nees):g}"])
    return Table(columns, kept)


def main() -> int:
    parser = parser_of(__doc__, has_sets=True, folder=SHARED_RECORDINGS)
    parser.add_argument("--noise", nargs="*", default=list(NOISES), choices=list(NOISES))
    parser.add_argument("--seeds", type=int, default=60, help="simulated intervals per contact and noise")
    parser.set_defaults(set=["paper", "sequence"])
    args = parser.parse_args()
    jobs = {
        (name, contact): [(contact, NOISES[name], seed) for seed in range(args.seeds)]
        for name, contact in product(args.noise, CONTACTS)
    }
    simulated = [
        row
        for (name, contact), found in measured(fit_simulated, jobs, args.processes)
        for row in simulation_rows(name, contact, found)
    ]
    print(table(SIMULATED, simulated))
    sets = find_sets(args.folder, args.set) if args.folder.is_dir() else {}
    recordings = {name: [(path,) for path in paths] for name, paths in sets.items()}
    by_set = dict(measured(measure, recordings, args.processes))
    rows = [
        row
        for name, found in by_set.items()
        for row in covariance_rows(name, [error for one in found for error in one.rows])
    ]
    tables = {"simulated": summary(simulated), "covariance": Table(COVARIANCE, rows)}
    if "paper" in by_set:
        tables["paper"] = Table(AGAINST_PAPER, list(paper_rows(by_set["paper"])))
    return report(args, **tables)


if __name__ == "__main__":
    sys.exit(main())
