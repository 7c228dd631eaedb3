"""Figures of belief against truth, as sums that add over recordings.

A ``Tally`` holds sufficient statistics (seconds, sums weighted by seconds, single errors), never a mean:
every figure of many recordings is derived from the sum of their tallies.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.evaluation.scoring import SHORTEST_PHASE_NS, Change, Scoring, Subset
from contact_tracker.labels import STATES

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CALIBRATION_BINS: Final = 15
SURE: Final = 0.9
SMALLEST_PROBABILITY: Final = 1e-12
"""A probability below this counts as this in the log-loss, which would be infinite otherwise."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Sufficient statistics of one recording, or (``a + b``) of several.

    Parameters
    ----------
    confusion_s : (5, 7, 8) seconds per ``Subset``, true state and label; the last column is no answer.
    calibration : (15, 3) per bin of the top probability, equally wide over [0, 1]: seconds,
        seconds x probability, seconds in which the top state was true.
    log_loss_s : seconds x -log p(truth).
    brier_s : seconds x squared distance of the posterior from the truth's indicator (0 to 2).
    sure_wrong_s : seconds with a probability above 0.9 on a wrong state.
    boundary_s : (B,) distance of the found changes from the true ones.
    boundaries_missed : true changes without a found one.
    delay_s : (D,) from the true onset until the label became right and stayed so for 0.3 s.
    never_detected : true phases in which it never did.
    """

    confusion_s: Array
    calibration: Array
    log_loss_s: float
    brier_s: float
    sure_wrong_s: float
    boundary_s: Array
    boundaries_missed: int
    delay_s: Array
    never_detected: int

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(
            confusion_s=self.confusion_s + other.confusion_s,
            calibration=self.calibration + other.calibration,
            log_loss_s=self.log_loss_s + other.log_loss_s,
            brier_s=self.brier_s + other.brier_s,
            sure_wrong_s=self.sure_wrong_s + other.sure_wrong_s,
            boundary_s=np.concatenate([self.boundary_s, other.boundary_s]),
            boundaries_missed=self.boundaries_missed + other.boundaries_missed,
            delay_s=np.concatenate([self.delay_s, other.delay_s]),
            never_detected=self.never_detected + other.never_detected,
        )

    def seconds(self, subset: Subset = Subset.ALL) -> float:
        """Time scored in ``subset``."""
        return float(self.confusion_s[subset].sum())

    def accuracy(self, subset: Subset = Subset.ALL) -> float:
        """Share of the time in which the label was right; nan where there was none."""
        return _ratio(float(np.trace(self.confusion_s[subset])), self.seconds(subset))

    @property
    def macro_f1(self) -> float:
        """Mean F1 over the states that occur in the truth."""
        confusion = self.confusion_s[Subset.ALL]
        true_s, found_s = confusion.sum(axis=1), confusion.sum(axis=0)[: len(STATES)]
        present = true_s > 0
        if not present.any():
            return float("nan")
        return float(np.mean(2 * np.diag(confusion)[present] / (true_s + found_s)[present]))

    @property
    def log_loss(self) -> float:
        """Mean of -log p(truth), in nats."""
        return _ratio(self.log_loss_s, self.seconds())

    @property
    def brier(self) -> float:
        """Mean squared distance of posterior and truth, summed over the states: 0 perfect, 2 worst."""
        return _ratio(self.brier_s, self.seconds())

    @property
    def calibration_error(self) -> float:
        """Expected calibration error: mean |share true - probability| of the bins, weighted by time."""
        _, probability_s, true_s = self.calibration.T
        return _ratio(float(np.abs(true_s - probability_s).sum()), self.seconds())

    @property
    def sure_wrong(self) -> float:
        """Share of the time with a probability above 0.9 on a wrong state."""
        return _ratio(self.sure_wrong_s, self.seconds())

    @property
    def missed_share(self) -> float:
        """Share of the true changes that have no found one."""
        return _ratio(self.boundaries_missed, self.boundaries_missed + len(self.boundary_s))

    @property
    def never_share(self) -> float:
        """Share of the true phases that were never detected."""
        return _ratio(self.never_detected, self.never_detected + len(self.delay_s))


def tally(scoring: Scoring, tick: Ints, label: Ints, probability: Array) -> Tally:
    """Score beliefs against truth.

    Parameters
    ----------
    scoring : of N frames.
    tick : (N,) index of the belief that holds at each frame. At -1 there is no answer: it counts as wrong,
        with the posterior of one who knows nothing (all seven states alike).
    label : (T,) column of each belief's label.
    probability : (T, 7) each belief's posterior.
    """
    frame_label = np.append(label, -1)[tick]
    posterior = np.vstack([probability, np.full(len(STATES), 1 / len(STATES))])[tick]
    scored = scoring.subsets[Subset.ALL]
    truth, seconds = scoring.truth[scored], scoring.seconds[scored]
    p = posterior[scored]
    top, top_p = p.argmax(axis=1), p.max(axis=1, initial=0.0)
    right = (top == truth) & (tick[scored] >= 0)
    log_loss = -np.log(np.maximum(p[np.arange(len(p)), truth], SMALLEST_PROBABILITY))
    brier = ((p - np.eye(len(STATES))[truth]) ** 2).sum(axis=1)
    boundary = [_boundary_error(scoring, frame_label, change) for change in scoring.changes]
    delay = [_delay(scoring, frame_label, change) for change in scoring.changes]
    return Tally(
        confusion_s=np.stack([_confusion(scoring, frame_label, subset) for subset in Subset]),
        calibration=_calibration(seconds, top_p, right),
        log_loss_s=float(seconds @ log_loss),
        brier_s=float(seconds @ brier),
        sure_wrong_s=float(seconds[(top_p > SURE) & ~right].sum()),
        boundary_s=np.array([e for e in boundary if e is not None], float),
        boundaries_missed=boundary.count(None),
        delay_s=np.array([d for d in delay if d is not None], float),
        never_detected=delay.count(None),
    )


def quantile(values: Array, q: float) -> float:
    """Quantile of values (K,) by linear interpolation; nan where there are none."""
    return float(np.quantile(values, q)) if len(values) else float("nan")


def _confusion(scoring: Scoring, frame_label: Ints, subset: Subset) -> Array:
    confusion = np.zeros((len(STATES), len(STATES) + 1))
    rows = scoring.subsets[subset]  # the label -1, no answer, is the last column
    np.add.at(confusion, (scoring.truth[rows], frame_label[rows]), scoring.seconds[rows])
    return confusion


def _calibration(seconds: Array, top_p: Array, right: NDArray[np.bool_]) -> Array:
    bins = np.clip((top_p * CALIBRATION_BINS).astype(int), 0, CALIBRATION_BINS - 1)
    columns = (seconds, seconds * top_p, seconds * right)
    return np.stack([np.bincount(bins, c, CALIBRATION_BINS) for c in columns], axis=1)


def _boundary_error(scoring: Scoring, frame_label: Ints, change: Change) -> float | None:
    """Seconds from the true change to the nearest found one into the same state; None where there is none.

    Looked for from the begin of the old phase to the end of the new one, both within what is judged: a
    label that was there for all of the old phase has not changed.
    """
    is_new = frame_label[change.begin : change.end] == change.into
    turned = change.begin + 1 + np.flatnonzero(is_new[1:] & ~is_new[:-1])
    if len(turned) == 0:
        return None
    found = scoring.stamp_ns[turned]
    early = scoring.stamp_ns[change.earliest] - found
    late = found - scoring.stamp_ns[change.onset]
    return float(np.maximum(np.maximum(early, late), 0).min()) * 1e-9


def _delay(scoring: Scoring, frame_label: Ints, change: Change) -> float | None:
    """Seconds from the true onset until the label is right for 0.3 s within the phase; None if never."""
    right = np.concatenate([[False], frame_label[change.onset : change.end] == change.into, [False]])
    start, stop = np.flatnonzero(right[1:] & ~right[:-1]), np.flatnonzero(right[:-1] & ~right[1:])
    begin_ns = scoring.stamp_ns[change.onset + start]
    lasting = np.flatnonzero(scoring.end_ns[change.onset + stop - 1] - begin_ns >= SHORTEST_PHASE_NS)
    if len(lasting) == 0:
        return None
    return float(begin_ns[lasting[0]] - scoring.stamp_ns[change.onset]) * 1e-9


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else float("nan")
