"""What the ticks since its onset say of each hypothesis, summed up."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.evidence import EvidenceParameters, log_ratio
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class EvidenceSums:
    """Sums over the ticks of a window from the onset on, and for some without the onset, which is given.

    ``log_ratio`` (B,) and ``gain`` (B, K) after the onset (see ``evidence.Ratio``); ``precision`` (B, K) of
    the residuals relative to that of the position; ``chi_sq`` (B,) squared residuals over their noise;
    ``ticks`` (B,) how many there are, ``after`` (B,) without the onset.
    """

    log_ratio: Array
    gain: Array
    precision: Array
    chi_sq: Array
    ticks: Index
    after: Index


def sum_evidence(
    model: ContactModel,
    x: Array,
    onset: Index,
    window: Window,
    scales: EvidenceParameters,
    certain: NDArray[np.bool_],
) -> EvidenceSums:
    """Evaluate hypotheses x (B, S) that begin at ``onset`` (B,) as ``evidence.log_ratio`` does."""
    ratio = log_ratio(model, x, window, scales, certain)
    mine, after = window.index >= onset[:, None], window.index > onset[:, None]
    relative = ratio.row_weight * window.variance[:, :1]  # the moments' own weight is 1 over that
    return EvidenceSums(
        np.where(after, ratio.log_ratio, 0.0).sum(axis=1),
        np.where(after[..., None], ratio.gain, 0.0).sum(axis=1),
        np.where(mine[..., None], relative, 0.0).sum(axis=1),
        np.where(mine[..., None], ratio.chi_sq, 0.0).sum(axis=(1, 2)),
        mine.sum(axis=1),
        after.sum(axis=1),
    )
