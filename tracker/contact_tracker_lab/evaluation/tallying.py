"""Computation of a ``Tally``: beliefs against truth, frame by frame."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.metrics import CALIBRATION_BINS, Array, Ints, Tally, right_states
from contact_tracker_lab.evaluation.scoring import SHORTEST_PHASE_NS, Change, Columns, Scoring, Subset

SURE: Final = 0.9
SMALLEST_PROBABILITY: Final = 1e-12
"""Lower limit of probabilities in the log-loss, which is infinite at zero."""
NO_LABEL: Final = -1
_BATCH_FRAMES: Final = 20_000


def tally(scoring: Scoring, tick: Ints, label: Ints, probability: Array) -> Tally:
    """Score beliefs against truth.

    Parameters
    ----------
    scoring : of N frames.
    tick : (N,) index of the belief that holds at each frame; -1 where there is none, which counts as a wrong
        label with a uniform posterior.
    label : (T,) column of each belief's label.
    probability : (T, 7) posterior of each belief.
    """
    frame_label = np.append(label, NO_LABEL).astype(np.int8)[tick]
    sums = _sums(scoring.part(slice(0, 0)), frame_label[:0], np.zeros((0, len(STATES))))
    for begin in range(0, len(tick), _BATCH_FRAMES):  # posteriors of all frames at once would need memory
        frames = slice(begin, min(begin + _BATCH_FRAMES, len(tick)))
        posterior, has_belief = np.full((len(tick[frames]), len(STATES)), 1 / len(STATES)), tick[frames] >= 0
        posterior[has_belief] = probability[tick[frames][has_belief]]
        sums += _sums(scoring.part(frames), frame_label[frames], posterior)
    right = np.column_stack([right_states(scoring.coarse), np.zeros(len(STATES) + len(scoring.coarse), bool)])
    changes = [(right[c.into][frame_label[c.begin : c.end]], c) for c in scoring.changes]
    return replace(
        sums,
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
    is_one, is_class = states[truth], np.eye(len(states))[truth]
    right = is_one[np.arange(len(p)), top] & (frame_label[scored] != NO_LABEL)
    shares = np.maximum(p, SMALLEST_PROBABILITY) * is_one
    p_true = shares.sum(axis=1, keepdims=True)
    is_true = shares / p_true  # of a coarse label the states are as probable as they are found
    log_loss = -np.log(p_true[:, 0])
    return Tally(
        confusion_s=np.stack([_confusion(scoring, frame_label, subset) for subset in Subset]),
        calibration=_calibration(seconds, top_p, right),
        calibration_by_state=np.stack(
            [_calibration(seconds, p[:, i], is_true[:, i]) for i in range(len(STATES))]
        ),
        log_loss_by_state_s=(seconds * log_loss) @ is_class,
        brier_by_state_s=seconds @ (p - is_true) ** 2,
        sure_wrong_by_state_s=(seconds * ((top_p > SURE) & ~right)) @ is_class,
        into=np.zeros(0, np.int64),
        boundary_error_s=np.zeros(0),
        detection_delay_s=np.zeros(0),
        coarse=scoring.coarse,
    )


def _confusion(scoring: Scoring, frame_label: Columns, subset: Subset) -> Array:
    confusion = np.zeros((len(STATES) + len(scoring.coarse), len(STATES) + 1))
    rows = scoring.subsets[subset]  # NO_LABEL indexes the last column
    np.add.at(confusion, (scoring.truth[rows], frame_label[rows]), scoring.seconds[rows])
    return confusion


def _calibration(seconds: Array, p: Array, right: NDArray[np.bool_] | Array) -> Array:
    bins = np.clip((p * CALIBRATION_BINS).astype(int), 0, CALIBRATION_BINS - 1)
    columns = (seconds, seconds * p, seconds * right)
    return np.stack([np.bincount(bins, c, CALIBRATION_BINS) for c in columns], axis=1)


def _boundary_error(scoring: Scoring, is_new: NDArray[np.bool_], change: Change) -> float:
    """Seconds from the true change to the nearest found one into the same state; nan where there is none.
    ``is_new``: whether the label is that, from the begin of the old phase to the end of the new one.

    The search is from the begin of the old phase to the end of the new one. A label that is already the new
    state at the begin is no change.
    """
    changed = change.begin + 1 + np.flatnonzero(is_new[1:] & ~is_new[:-1])
    if len(changed) == 0:
        return float("nan")
    found = scoring.stamp_ns[changed]
    early = scoring.stamp_ns[change.earliest] - found
    late = found - scoring.stamp_ns[change.onset]
    return float(np.maximum(np.maximum(early, late), 0).min()) * 1e-9


def _delay(scoring: Scoring, is_new: NDArray[np.bool_], change: Change) -> float:
    """Seconds from the true onset until the label is right for 0.3 s within the phase; nan if never."""
    right = np.concatenate([[False], is_new[change.onset - change.begin :], [False]])
    start, stop = np.flatnonzero(right[1:] & ~right[:-1]), np.flatnonzero(right[:-1] & ~right[1:])
    begin_ns = scoring.stamp_ns[change.onset + start]
    lasting = np.flatnonzero(scoring.end_ns[change.onset + stop - 1] - begin_ns >= SHORTEST_PHASE_NS)
    if len(lasting) == 0:
        return float("nan")
    return float(begin_ns[lasting[0]] - scoring.stamp_ns[change.onset]) * 1e-9
