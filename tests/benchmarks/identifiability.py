"""Classes of the tracker's errors, avoidable and unavoidable ones, by comparison with oracles.

    python tests/benchmarks/identifiability.py FOLDER --set hard robot

Sets of labelled recordings as in identification.py. The tracker's offline labels are compared with those of
oracles with the true boundaries (``oracle.py``), and the time with wrong labels is divided into classes.
Singular motion, and rest before the first motion, are left out.
"""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import as_completed
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import identifiability_tables
import oracle
import tracking
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.errors import ContactTrackerError, NoPoses, NoTruth
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import estimate_noise
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.scoring import Columns, Scoring, Subset, scoring
from identifiability_tables import Mistake, RecordingErrors
from identification import find_sets
from scores import OFFLINE, Method
from shared_recordings import add_folder
from worker_pool import worker_pool

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def measure(path: Path, model_name: str) -> RecordingErrors:
    """Compare tracker and oracles on one recording; raises ContactTrackerError if it cannot be used."""
    model, truth = load_model(model_name), read_truth(str(path))
    if truth is None:
        raise NoTruth(f"{path}: no truth")
    poses = Poses.collect(open_log(str(path)))
    if not len(poses):
        raise NoPoses(f"{path}: no pose that can be used")
    tracked = tracking.track(poses, model)
    true = oracle.phases(truth)
    oracles = oracle.evaluate(true, tracked, poses.position_m[0], model)
    return compare(path.stem, poses, scoring(poses.stamp_ns, truth), true, tracked, oracles, model)


def compare(
    name: str,
    poses: Poses,
    scored: Scoring,
    true: Sequence[oracle.Phase],
    tracked: tracking.Tracked,
    oracles: oracle.OracleResults,
    model: Model,
) -> RecordingErrors:
    """Labels of tracker and oracles over identifiable frames, and the tracker's mistakes."""
    answer = tracking.answers(poses, tracked)[Method(tracking.NAME, OFFLINE)]
    label = answer.label[answer.tick]
    taken = scored.subsets[Subset.IDENTIFIABLE]
    phase = np.searchsorted([p.start_ns for p in true], poses.stamp_ns, side="right") - 1
    weight = np.where(taken, scored.seconds, 0.0)
    labels = {tracking.NAME: label} | {o: oracles.label[o][phase] for o in oracle.ORACLES}
    confusion_s = {name: _confusion(scored.truth, column, weight) for name, column in labels.items()}
    wrong = np.where(label != scored.truth, weight, 0.0)
    clear = np.where(scored.subsets[Subset.CLEAR], wrong, 0.0)
    stamp_s = (poses.stamp_ns - poses.stamp_ns[0]) * 1e-9
    rate_hz, sigma_mm = 1.0 / float(np.median(np.diff(stamp_s))), 1e3 * estimate_noise(poses)[0]
    log_odds = partial(_log_odds, poses, label, answer.tick, tracked, model)
    mistakes = []
    for run in _runs(wrong > 0, phase):
        row = int(phase[run[0]])
        seconds = np.bincount(label[run], weights=wrong[run], minlength=len(STATES))
        right = (phase == row) & (label == true[row].contact.column) & (weight > 0)
        mistakes.append(
            Mistake(
                recording=name,
                rate_hz=rate_hz,
                sigma_mm=sigma_mm,
                start_s=float(stamp_s[run[0]]),
                end_s=float(stamp_s[run[-1]]),
                phase_s=(true[row].end_ns - true[row].start_ns) * 1e-9,
                true=true[row].contact,
                taken=STATES[int(np.argmax(seconds))],
                near_s=float((wrong - clear)[run].sum()),
                clear_s=float(clear[run].sum()),
                oracles={o: STATES[oracles.label[o][row]] for o in oracle.ORACLES},
                beside=bool(right.any()),
                **log_odds(run, true[row]),
            )
        )
    return RecordingErrors(name, confusion_s, tuple(mistakes))


def _runs(wrong: NDArray[np.bool_], phase: Ints) -> list[Ints]:
    """Runs of consecutive frames with wrong labels, each within one true phase."""
    frames = np.flatnonzero(wrong)
    ends = np.flatnonzero((np.diff(frames) > 1) | (np.diff(phase[frames]) != 0)) + 1
    return [run for run in np.split(frames, ends) if len(run)]


def _log_odds(
    poses: Poses,
    label: Ints,
    tick: Ints,
    tracked: tracking.Tracked,
    model: Model,
    run: Ints,
    phase: oracle.Phase,
) -> dict[str, float]:
    """Evidence and prior (nats) of the true contact in a run of frames, relative to those of the labels."""
    stamp_ns, column = poses.stamp_ns[run], phase.contact.column
    evidence = cache(partial(oracle.evidence_within, tracked=tracked, model=model))  # spans may repeat
    pieces = np.split(np.arange(len(run)), np.flatnonzero(np.diff(label[run])) + 1)
    ends = [(int(stamp_ns[p[0]]), int(stamp_ns[p[-1]])) for p in pieces]
    of_labels = sum(float(evidence(*end)[label[run[p[0]]]]) for end, p in zip(ends, pieces, strict=True))
    span = ends[0][0], ends[-1][1]
    fitted = float(evidence(*span)[column])
    known = oracle.evidence_of_truth(phase, oracle.within(*span, tracked), poses.position_m[0], model)
    path = tracked.segmentation.beliefs.rows["contact"].astype(np.int64)
    corrected = path.copy()
    corrected[np.unique(tick[run])] = column
    prior = oracle.log_prior(corrected, tracked.window, model) - oracle.log_prior(path, tracked.window, model)
    return {"fitted": fitted - of_labels, "known": known - of_labels, "prior": prior}


def _confusion(truth: Columns, label: Ints, weight: Array) -> Array:
    """Seconds (7, 7) by truth and label; no label is wrong, and counts as free unless that is true."""
    confusion = np.zeros((len(STATES), len(STATES)))
    scored = weight > 0
    np.add.at(confusion, (truth[scored], label[scored]), weight[scored])
    return confusion


def measure_sets(
    sets: dict[str, list[Path]], model_name: str, processes: int
) -> dict[str, list[RecordingErrors]]:
    """The recordings that can be used, by set; the others are reported on stderr, one line each."""
    paths = [path for some in sets.values() for path in some]
    done: dict[Path, RecordingErrors] = {}
    with worker_pool(processes) as pool:
        jobs = {pool.submit(measure, path, model_name): path for path in paths}
        for future in tqdm(as_completed(jobs), total=len(jobs), unit="recording"):
            path = jobs[future]
            try:
                done[path] = future.result()
            except ContactTrackerError as error:
                tqdm.write(f"{path.name}: {error}", file=sys.stderr)
    return {name: [done[path] for path in some if path in done] for name, some in sets.items()}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_folder(parser)
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)
    sets = find_sets(args.folder, args.set)
    measured = measure_sets(sets, args.model, args.processes)
    print(identifiability_tables.to_text(measured))
    return 0 if sum(map(len, measured.values())) == sum(map(len, sets.values())) else 1


if __name__ == "__main__":
    sys.exit(main())
