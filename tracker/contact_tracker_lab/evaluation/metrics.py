"""Metrics of labels and posteriors, derived from statistics that add over recordings.

A ``Tally`` holds sufficient statistics (seconds, sums weighted by seconds, single errors) and no means: each
metric of several recordings is computed from the sum of their tallies.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.ground_truth import CoarseLabel
from contact_tracker.outputs.text import SURE_PROBABILITY
from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.scoring import SHORTEST_PHASE_NS, Change, Columns, Scoring, Subset

CALIBRATION_BINS: Final = 15
SMALLEST_PROBABILITY: Final = 1e-12
"""Lower limit of probabilities in the log-loss, which would be infinite at zero."""
NO_LABEL: Final = -1
_BATCH_FRAMES: Final = 20_000
_CHANGES: Final = ("into", "boundary_error_s", "detection_delay_s")


@dataclass(frozen=True, eq=False)
class Tally:
    """Sufficient statistics of one recording, or (``a + b``) of several.

    Parameters
    ----------
    confusion_s : (5, 7, 8) seconds per ``Subset``, true state and label; the last column is without a label.
        Coarse labels have further rows, here and in other values by state.
    calibration : (15, 3) per bin of the top probability, equally wide over [0, 1]: seconds,
        seconds x probability, seconds in which the top state was true.
    log_loss_s : seconds x -log p(truth), in nats.
    brier_s : seconds x squared distance of posterior and truth, summed over the states.
    sure_wrong_s : seconds with a probability above 0.9 on a wrong state.
    open_s : seconds in which the motion leaves the contact open, whatever the label.
    into : (C,) column of the state after each true change.
    boundary_error_s : (C,) time between the true change and the nearest found one; nan: none found.
    detection_delay_s : (C,) from the onset until the label is right for 0.3 s; nan: never.
    """

    confusion_s: Array
    calibration: Array
    log_loss_s: float
    brier_s: float
    sure_wrong_s: float
    open_s: float
    into: Ints
    boundary_error_s: Array
    detection_delay_s: Array
    coarse: tuple[CoarseLabel, ...] = ()

    def __add__(self, tally: "Tally") -> "Tally":
        """The sum; both have the same coarse labels."""
        a, b = vars(self), vars(tally)
        sums = {name: a[name] + b[name] for name in a if name not in (*_CHANGES, "coarse")}
        lists: dict[str, Any] = {name: np.concatenate([a[name], b[name]]) for name in _CHANGES}
        return Tally(**sums, **lists, coarse=self.coarse)

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows of ``confusion_s``."""
        return (*(state.value for state in STATES), *(label.name for label in self.coarse))

    def right_s(self, subset: Subset = Subset.ALL) -> Array:
        """Time in which each row was true and the label right."""
        labelled_s = self.confusion_s[subset][:, : len(STATES)]
        return np.asarray((labelled_s * right_states(self.coarse)).sum(axis=1))

    def seconds(self, subset: Subset = Subset.ALL) -> float:
        """Time scored in ``subset``."""
        return float(self.confusion_s[subset].sum())

    @property
    def subsets(self) -> tuple[Subset, ...]:
        """The subsets that the truth determines: a user's labels do not say how the object moved."""
        is_known = self.seconds(Subset.MOVED) + self.seconds(Subset.AMBIGUOUS) > 0.0
        return tuple(Subset) if is_known or not self.seconds() else (Subset.ALL, Subset.CLEAR)

    def accuracy(self, subset: Subset = Subset.ALL) -> float:
        """Share of the time in which the label was right; nan where there was none."""
        return ratio(float(self.right_s(subset).sum()), self.seconds(subset))

    @property
    def seconds_by_state(self) -> Array:
        """Time scored (7,) in which each state was true."""
        return np.asarray(self.confusion_s[Subset.ALL].sum(axis=1))

    @property
    def recall(self) -> Array:
        """Share (7,) of a state's time in which the label was right; nan where it never was true."""
        return _ratios(self.right_s(), self.seconds_by_state)

    @property
    def f1(self) -> Array:
        """F1 (7,) of each state; nan where it never was true."""
        admits = right_states(self.coarse)
        wrong_s = (self.confusion_s[Subset.ALL][:, : len(STATES)] * ~admits).sum(axis=0)
        found_s = np.where(self.seconds_by_state > 0, self.right_s() + admits @ wrong_s, 0.0)
        return _ratios(2 * self.right_s(), self.seconds_by_state + found_s)

    @property
    def macro_f1(self) -> float:
        """Mean F1 over the states that occur in the truth."""
        occurring = finite_values(self.f1)
        return float(occurring.mean()) if len(occurring) else float("nan")

    @property
    def log_loss(self) -> float:
        """Mean of -log p(truth), in nats."""
        return ratio(self.log_loss_s, self.seconds())

    @property
    def brier(self) -> float:
        """Mean squared distance of posterior and truth, summed over the states: 0 perfect, 2 worst."""
        return ratio(self.brier_s, self.seconds())

    @property
    def calibration_error(self) -> float:
        """Expected calibration error: mean |share true - probability| of the bins, weighted by time."""
        expected_s, right_s = self.calibration[:, 1], self.calibration[:, 2]
        return ratio(float(np.abs(right_s - expected_s).sum()), self.seconds())

    @property
    def sure_wrong(self) -> float:
        """Share of the time with a probability above 0.9 on a wrong state."""
        return ratio(self.sure_wrong_s, self.seconds())

    @property
    def open(self) -> float:
        """Share of the time in which the motion leaves the contact open."""
        return ratio(self.open_s, self.seconds())

    @property
    def boundary_s(self) -> Array:
        """Errors (B,) of the true changes with an estimated one."""
        return finite_values(self.boundary_error_s)

    @property
    def delay_s(self) -> Array:
        """Delays (D,) of the detected true phases."""
        return finite_values(self.detection_delay_s)

    @property
    def missed_share(self) -> float:
        """Share of the true changes without an estimated one."""
        return ratio(len(self.into) - len(self.boundary_s), len(self.into))

    @property
    def never_share(self) -> float:
        """Share of the true phases that were never detected."""
        return ratio(len(self.into) - len(self.delay_s), len(self.into))


def right_states(coarse: tuple[CoarseLabel, ...]) -> Bools:
    """States (7 + C, 7) that each state and each coarse label admits."""
    rows = [[state in label.states for state in STATES] for label in coarse]
    return np.array([*np.eye(len(STATES), dtype=bool), *rows], bool)


def quantile(values: Array, q: float) -> float:
    """Quantile of values (K,) by linear interpolation; nan without values."""
    return float(np.quantile(values, q)) if len(values) else float("nan")


def finite_values(values: Array) -> Array:
    """The values that are finite."""
    return values[np.isfinite(values)]


def _ratios(part: Array, whole: Array) -> Array:
    return np.asarray(np.divide(part, whole, out=np.full(len(part), np.nan), where=whole > 0))


def ratio(part: float, whole: float) -> float:
    """The share ``part`` of ``whole``; nan if that is zero."""
    return part / whole if whole > 0 else float("nan")


def tally(
    scoring: Scoring, tick: Ints, label: Ints, probability: Array, is_open: Bools | None = None
) -> Tally:
    """Score beliefs against truth.

    Parameters
    ----------
    scoring : of N frames.
    tick : (N,) index of the belief that holds at each frame; -1 where there is none, which counts as a wrong
        label with a uniform posterior.
    label : (T,) column of each belief's label.
    probability : (T, 7) posterior of each belief.
    is_open : (T,) whether the motion does not distinguish each label from others; by default none is open.
    """
    frame_label = np.append(label, NO_LABEL).astype(np.int8)[tick]
    posterior = np.append(probability, np.full((1, len(STATES)), 1 / len(STATES)), axis=0)
    sums = _sums(scoring.part(slice(0, 0)), frame_label[:0], posterior[:0])
    for begin in range(0, len(tick), _BATCH_FRAMES):  # to bound the memory for posteriors
        frames = slice(begin, min(begin + _BATCH_FRAMES, len(tick)))
        sums += _sums(scoring.part(frames), frame_label[frames], posterior[tick[frames]])
    right = np.column_stack([right_states(scoring.coarse), np.zeros(len(STATES) + len(scoring.coarse), bool)])
    opens = np.zeros(len(label), bool) if is_open is None else is_open
    open_frames = np.append(opens, False)[tick] & scoring.subsets[Subset.ALL]
    changes = [(right[c.into][frame_label[c.begin : c.end]], c) for c in scoring.changes]
    return replace(
        sums,
        open_s=float(scoring.seconds @ open_frames),
        into=np.array([change.into for change in scoring.changes], np.int64),
        boundary_error_s=np.array([_boundary_error(scoring, fits, c) for fits, c in changes], float),
        detection_delay_s=np.array([_delay(scoring, fits, c) for fits, c in changes], float),
    )


def _sums(scoring: Scoring, frame_label: Columns, posterior: Array) -> Tally:
    """The statistics that are sums over frames."""
    scored = scoring.subsets[Subset.ALL]
    truth, seconds = scoring.truth[scored], scoring.seconds[scored]
    p = posterior[scored]
    top, top_p = p.argmax(axis=1), p.max(axis=1, initial=0.0)
    states = right_states(scoring.coarse)
    admitted = states[truth]
    right = admitted[np.arange(len(p)), top] & (frame_label[scored] != NO_LABEL)
    shares = np.maximum(p, SMALLEST_PROBABILITY) * admitted
    p_true = shares.sum(axis=1)
    is_true = shares / p_true[:, None]  # states of a coarse label by their posterior
    confusion_s = np.zeros((len(Subset), len(states), len(STATES) + 1))
    for subset, frames in enumerate(scoring.subsets):  # NO_LABEL indexes the last column
        cells = scoring.truth[frames], frame_label[frames]
        np.add.at(confusion_s[subset], cells, scoring.seconds[frames])
    bins = np.clip((top_p * CALIBRATION_BINS).astype(int), 0, CALIBRATION_BINS - 1)
    columns = (seconds, seconds * top_p, seconds * right)
    return Tally(
        confusion_s=confusion_s,
        calibration=np.stack([np.bincount(bins, column, CALIBRATION_BINS) for column in columns], axis=1),
        log_loss_s=float(seconds @ -np.log(p_true)),
        brier_s=float((seconds @ (p - is_true) ** 2).sum()),
        sure_wrong_s=float(seconds @ ((top_p > SURE_PROBABILITY) & ~right)),
        open_s=0.0,
        into=np.zeros(0, np.int64),
        boundary_error_s=np.zeros(0),
        detection_delay_s=np.zeros(0),
        coarse=scoring.coarse,
    )


def _boundary_error(scoring: Scoring, is_new: Bools, change: Change) -> float:
    """Seconds from the true change to the nearest estimated one into the same state; nan without one.

    ``is_new``: whether the label is that, from the begin of the old phase to the end of the new one, where
    the search is. A label that is already the new state at the begin is no change.
    """
    changed = change.begin + 1 + np.flatnonzero(is_new[1:] & ~is_new[:-1])
    if len(changed) == 0:
        return float("nan")
    found_ns = scoring.stamp_ns[changed]
    early = scoring.stamp_ns[change.earliest] - found_ns
    late = found_ns - scoring.stamp_ns[change.onset]
    return float(np.maximum(np.maximum(early, late), 0).min()) * 1e-9


def _delay(scoring: Scoring, is_new: Bools, change: Change) -> float:
    """Seconds from the true onset until the label is right for 0.3 s within the phase; nan if never."""
    right = np.concatenate([[False], is_new[change.onset - change.begin :], [False]])
    start, stop = np.flatnonzero(right[1:] & ~right[:-1]), np.flatnonzero(right[:-1] & ~right[1:])
    begin_ns = scoring.stamp_ns[change.onset + start]
    lasting = np.flatnonzero(scoring.end_ns[change.onset + stop - 1] - begin_ns >= SHORTEST_PHASE_NS)
    if len(lasting) == 0:
        return float("nan")
    return float(begin_ns[lasting[0]] - scoring.stamp_ns[change.onset]) * 1e-9
