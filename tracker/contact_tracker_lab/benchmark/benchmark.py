"""The benchmark: the tracker and other methods on recordings with truth, in one table.

    python -m contact_tracker_lab.benchmark FOLDER
    python -m contact_tracker_lab.benchmark FOLDER --method my_method.py:label --labels theirs/
    python -m contact_tracker_lab.benchmark FOLDER --split tuning --only "tracker" "speed threshold"

FOLDER has a folder of .mcap files for each set. Recordings with an even number in their name are for tuning,
those with an odd number for testing; methods learn, and their constants are chosen, on the tuning
split only. Scored is the time in which the motion determines the contact (``docs/benchmarks.md``).

``5-95 %`` is a bootstrap interval of the accuracy over the true phases, ``delay`` the median time from a true
onset until the label is right for 0.3 s, plus the lag; ``CPU`` seconds for each second of the recordings.
"""

import argparse
import re
import time
from collections.abc import Mapping, Sequence
from functools import partial, reduce
from operator import add
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker.config.loading import load_model
from contact_tracker.errors import ContactTrackerError, UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker_lab.benchmark import bic, fixed_windows, others, tracked
from contact_tracker_lab.benchmark.fixed_windows import Windows
from contact_tracker_lab.benchmark.runner import Table, find_sets, measured, parser_of, report
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Method, Score, Scores
from contact_tracker_lab.evaluation.metrics import quantile
from contact_tracker_lab.evaluation.scoring import scoring
from contact_tracker_lab.evaluation.tables import number

TOTAL: Final = "all sets"
SPLITS: Final = ("tuning", "test")
DETAILS: Final = ("5-95 %", "F1", "delay, s", "log-loss", "ECE", "sure and wrong", "CPU")
WINDOWED: Final = (fixed_windows.SMALLEST, fixed_windows.HMM)
BY_CRITERION: Final = (bic.WINDOWS, bic.CHANGES, bic.SEGMENTS)


class Job(NamedTuple):
    """One recording, and the methods to apply.

    ``earlier``: the first take of the same scene, for a later take; ``only``: names of methods, all if empty;
    ``functions``: names of others' methods; ``labels``: a folder with NAME.csv.
    """

    path: Path
    model: str
    earlier: Path | None = None
    only: tuple[str, ...] = ()
    functions: tuple[str, ...] = ()
    labels: Path | None = None

    def wants(self, *names: str) -> bool:
        return not self.only or any(name in self.only for name in names)


class Measured(NamedTuple):
    """Results on one recording: ``scores`` and CPU time by method; ``windows``: input of the method that is
    calibrated on the tuning split; ``seconds``: duration."""

    scores: Scores
    cpu_s: dict[Method, float]
    windows: Windows | None
    seconds: float


def measure(job: Job) -> Measured:
    """Score the methods on one recording; raises ContactTrackerError if it cannot be used."""
    model, truth = load_model(job.model), need_truth(str(job.path))
    poses = Poses.collect(open_log(str(job.path)))
    scored = scoring(poses.stamp_ns, truth)
    scores, cpu_s = dict[Method, Score](), dict[Method, float]()

    def note(answers: Mapping[Method, Answer], began_s: float) -> None:
        cpu_s.update(dict.fromkeys(answers, time.process_time() - began_s))
        scores.update({method: Score.of(answer, scored) for method, answer in answers.items()})

    labellings = tracked.methods(model) if job.wants(tracked.NAME) else {}
    if job.wants(others.STILL):
        labellings[Method(others.STILL, 0.0, False)] = others.answer_by_speed
    labellings |= dict(map(others.load_function, job.functions))
    if job.earlier is not None and job.wants(tracked.WITH_MAP):
        labellings |= tracked.methods(model, job.earlier)
    if job.labels is not None:
        labelling = partial(others.answer_from_labels, path=job.labels / f"{job.path.stem}.csv")
        labellings[Method(job.labels.name, OFFLINE, False)] = labelling
    for method, answer in labellings.items():
        began_s = time.process_time()
        note({method: answer(poses)}, began_s)
    windows = None
    if job.wants(*WINDOWED):
        began_s = time.process_time()
        windows = Windows.of(poses, scored)
        note(fixed_windows.smallest_answers(windows), began_s)
    if job.wants(*BY_CRITERION):
        began_s = time.process_time()
        ticks = bic.Ticks.of(poses, model)
        ticks_s = time.process_time() - began_s
        for answers_of in bic.WAYS:
            began_s = time.process_time() - ticks_s
            note(answers_of(poses, scored, ticks), began_s)
    return Measured(scores, cpu_s, windows, float(poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-9)


def split_of(path: Path) -> str:
    """``tuning`` or ``test``, by the last number in the name."""
    numbers = re.findall(r"\d+", path.stem)
    return SPLITS[int(numbers[-1]) % 2] if numbers else "test"


def earlier_take(path: Path, paths: Sequence[Path]) -> Path | None:
    """The first take of the scene of a recording SCENE_TAKE; None if there is no earlier one.

    Sets of one scene have no takes.
    """
    scene = path.stem.rpartition("_")[0]
    takes = [take for take in paths if take.stem.rpartition("_")[0] == scene]
    is_of_takes = len({take.stem.rpartition("_")[0] for take in paths}) > 1
    first = min(takes, key=lambda take: (len(take.stem), take.stem))  # take 9 precedes take 10
    return first if is_of_takes and first != path else None


def with_hmm(
    results: Mapping[str, list[Measured]], tuning: Mapping[str, list[Measured]], model_name: str
) -> dict[str, list[Measured]]:
    """The results, with those of the HMM calibrated on the tuning split of each set added."""
    model, extended = load_model(model_name), dict[str, list[Measured]]()
    for name, recordings in results.items():
        learned = [recording.windows for recording in tuning.get(name, []) if recording.windows is not None]
        recorded = [recording.windows for recording in recordings if recording.windows is not None]
        if not learned or len(recorded) < len(recordings):
            extended[name] = recordings
            continue
        scores = fixed_windows.hmm_scores(recorded, learned, model)
        pairs = zip(recordings, scores, strict=True)
        extended[name] = [recording._replace(scores=recording.scores | added) for recording, added in pairs]
    return extended


def summary(results: Mapping[str, Sequence[Measured]]) -> Table:
    """A row for each method: accuracy by set, and further figures over all sets on which it was scored."""
    measured_all = [recording for recordings in results.values() for recording in recordings]
    methods = list(dict.fromkeys(method for recording in measured_all for method in recording.scores))
    names = [method.name for method in methods]
    methods.sort(key=lambda method: (names.index(method.name), -method.wait_s))  # from offline to online
    rows = []
    for method in methods:
        by_set = [accuracy(method, recordings) for recordings in results.values()]
        scored = [recording for recording in measured_all if method in recording.scores]
        total_score = reduce(add, (recording.scores[method] for recording in scored))
        cpu_s = [recording.cpu_s[method] for recording in scored if method in recording.cpu_s]
        total = [number(total_score.main.accuracy())] if len(results) > 1 else []
        share = number(sum(cpu_s) / sum(recording.seconds for recording in scored), 3) if cpu_s else "-"
        rows.append([method.name, method.when, *by_set, *total, *details(method, total_score), share])
    sets = (*results, TOTAL) if len(results) > 1 else tuple(results)
    return Table(("method", "when", *sets, *DETAILS), rows)


def accuracy(method: Method, recordings: Sequence[Measured]) -> str:
    """Accuracy in a set; with ``*`` if the method was not applied to all recordings, ``-`` if to none."""
    scored = [recording.scores[method] for recording in recordings if method in recording.scores]
    if not scored:
        return "-"
    return number(reduce(add, scored).main.accuracy()) + "*" * (len(scored) < len(recordings))


def details(method: Method, score: Score) -> list[str]:
    """The further figures of a row, except CPU time."""
    main, (low, high) = score.main, map(number, score.band())
    waits = "-" if method.wait_s == OFFLINE else number(quantile(main.delay_s, 0.5) + method.wait_s, 2)
    uncertain = map(number, (main.log_loss, main.calibration_error, main.sure_wrong))
    band = low if low == high else f"{low}-{high}"
    return [band, number(main.macro_f1), waits, *(uncertain if method.has_posterior else 3 * "-")]


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, has_sets=True)
    parser.add_argument("--split", choices=[*SPLITS, "all"], default="test", help="default: %(default)s")
    parser.add_argument("--only", nargs="+", default=[], metavar="METHOD", help="only these of the methods")
    parser.add_argument(
        "--method", nargs="+", default=[], metavar="FUNCTION", help="module:function, others'"
    )
    parser.add_argument("--labels", type=Path, metavar="FOLDER", help="others' labels, a NAME.csv for each")
    parser.add_argument("--model", default="default", metavar="NAME|FILE")
    args = parser.parse_args(argv)
    try:
        return report(args, benchmark=measured_table(args))
    except ContactTrackerError as error:
        parser.error(str(error))


def measured_table(args: argparse.Namespace) -> Table:
    sets = find_sets(args.folder, args.set)
    selection = (tuple(args.only), tuple(args.method), args.labels)
    jobs = dict[tuple[str, bool], list[tuple[Job]]]()
    for name, paths in sets.items():
        for path in paths:
            job = Job(path, args.model, earlier_take(path, paths), *selection)
            if args.split in ("all", split_of(path)):
                jobs.setdefault((name, True), []).append((job,))
            if split_of(path) == "tuning" and job.wants(fixed_windows.HMM):
                learning = Job(path, args.model, only=(fixed_windows.HMM,))
                jobs.setdefault((name, False), []).append((learning,))
    results = dict(measured(measure, jobs, args.processes))
    scored = {name: recordings for (name, is_scored), recordings in results.items() if is_scored}
    if not any(recording.scores for recordings in scored.values() for recording in recordings):
        names = "; ".join((tracked.NAME, tracked.WITH_MAP, others.STILL, *WINDOWED, *BY_CRITERION))
        reason = f"no recording is of the split {args.split}, or no method is {names}"
        raise UsageError(f"nothing to score: {reason}")
    tuning = {name: recordings for (name, is_scored), recordings in results.items() if not is_scored}
    return summary(with_hmm(scored, tuning, args.model))
