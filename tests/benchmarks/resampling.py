"""Confidence intervals of figures from few recordings: bootstrap over true phases.

Frames of one phase are right or wrong together, so whole phases are resampled, with replacement. Calibration
errors are sums of absolute values, which tend to be larger in resamples, so that the interval may lie above
the figure.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import STATES
from contact_tracker_lab.evaluation.metrics import CALIBRATION_BINS
from contact_tracker_lab.evaluation.scoring import Scoring, Subset

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RESAMPLES: Final = 1000
BAND: Final = (0.05, 0.95)
UNKNOWN: Final = (float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class Phases:
    """Statistics of Q true phases: ``label_s`` (Q, 2), seconds and those with the right label; ``belief_s``
    (Q, 15, 3) by bin of the top probability: seconds, seconds x probability, seconds with the top state
    true."""

    label_s: Array
    belief_s: Array

    def __add__(self, other: "Phases") -> "Phases":
        return Phases(
            np.concatenate([self.label_s, other.label_s]), np.concatenate([self.belief_s, other.belief_s])
        )

    @classmethod
    def of(cls, scored: Scoring, tick: Ints, label: Ints, probability: Array) -> "Phases":
        """The phases of a recording, in each of which one state lasts. Arguments as of ``tallying.tally``."""
        every = np.cumsum(np.append(0, np.diff(scored.truth) != 0))
        taken = scored.subsets[Subset.ALL]
        phase = np.unique(every[taken], return_inverse=True)[1]
        tick, truth, seconds = tick[taken], scored.truth[taken], scored.seconds[taken]
        frame_label = np.append(label, -1)[tick]
        belief = np.vstack([probability, np.full(len(STATES), 1 / len(STATES))])[tick]
        top, top_p = belief.argmax(axis=1), belief.max(axis=1, initial=0.0)
        bins = np.clip((top_p * CALIBRATION_BINS).astype(int), 0, CALIBRATION_BINS - 1)
        count = int(phase.max(initial=-1)) + 1
        label_s, belief_s = np.zeros((count, 2)), np.zeros((count, CALIBRATION_BINS, 3))
        right = (top == truth) & (tick >= 0)
        np.add.at(
            label_s, phase, seconds[:, None] * np.stack([np.ones(len(truth)), frame_label == truth], axis=1)
        )
        np.add.at(
            belief_s,
            (phase, bins),
            seconds[:, None] * np.stack([np.ones(len(truth)), top_p, right], axis=1),
        )
        return cls(label_s, belief_s)

    def accuracy(self) -> tuple[float, float]:
        """The ``BAND`` of the share of the time in which the label was right; nan without phases."""
        seconds, right_s = self._resampled(self.label_s).T
        return _band(right_s, seconds)

    def calibration_error(self) -> tuple[float, float]:
        """The ``BAND`` of the expected calibration error; nan without phases."""
        sums = self._resampled(self.belief_s.reshape(len(self.belief_s), CALIBRATION_BINS * 3))
        sums = sums.reshape(len(sums), CALIBRATION_BINS, 3)
        return _band(np.abs(sums[..., 2] - sums[..., 1]).sum(axis=1), sums[..., 0].sum(axis=1))

    def calibration_error_if_exact(self) -> tuple[float, float]:
        """The calibration error of exact probabilities: mean, and upper end of the ``BAND``; nan without
        phases.

        Frames of one phase in one bin are all right, with that probability, or all wrong.
        """
        seconds, weighted_s = self.belief_s[..., 0], self.belief_s[..., 1]
        if not seconds.sum():
            return UNKNOWN
        probability = weighted_s / np.where(seconds > 0, seconds, 1.0)
        drawn = np.random.default_rng(0).random((RESAMPLES, *seconds.shape)) < probability
        off_s = np.einsum("qk,bqk->bk", seconds, drawn) - weighted_s.sum(axis=0)
        error = np.abs(off_s).sum(axis=1) / seconds.sum()
        return float(error.mean()), float(np.quantile(error, BAND[1]))

    def _resampled(self, of_phase: Array) -> Array:
        """Sums (B, n) of rows (Q, n) over resampled phases; the resamples are always the same."""
        count = len(of_phase)
        if not count:
            return np.zeros((0, of_phase.shape[1]))
        drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), RESAMPLES)
        return np.asarray(drawn @ of_phase)


def _band(part: Array, whole: Array) -> tuple[float, float]:
    known = whole > 0
    if not known.any():
        return UNKNOWN
    low, high = np.quantile(part[known] / whole[known], BAND)
    return float(low), float(high)
