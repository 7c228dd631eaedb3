"""Alternative: the Bayesian information criterion per segment, as in the selection of articulation models.

For n samples of a segment and contact j with k_j parameters and d_j degrees of freedom,

    log p(samples | j) - 1/2 (k_j + n d_j) log n

where log p is that of the whitened residuals of the constraints, -1/2 sum chi^2: the configuration in the d_j
degrees of freedom is estimated for each sample without residual, so these n d_j coordinates count as
parameters. Free has k = 0, d = 6 and no residual. The posterior is its normalised exponential. Samples are
the tracker's ticks of 0.1 s without outliers, with the noise estimated from the recording; fits are those of
the tracker.

Segments are the paper's windows of 500 frames, every 100 frames; and, to its advantage, the true ones.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.evaluation.scoring import UNSCORED, Scoring, tick_in_force
from scores import OFFLINE, Answer, Method
from tracking import Tracked

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FRAMES: Final = 500
STEP: Final = 100
WINDOWS: Final = "BIC on windows"
SEGMENTS: Final = "BIC, true segments"
FEWEST: Final = 2


def answers(poses: Poses, scored: Scoring, tracked: Tracked, model: Model) -> dict[Method, Answer]:
    """BIC on fixed windows, offline and online, and on the true segments."""
    stamp_ns = poses.stamp_ns
    first = np.arange(0, max(len(poses) - FRAMES + 1, 0), STEP)
    spans = [(int(stamp_ns[i]), int(stamp_ns[i + FRAMES - 1])) for i in first]
    probability, row = _posteriors(spans, tracked, scales_of(model))
    start_ns, end_ns = np.array(spans, np.int64).reshape(-1, 2)[row >= 0].T
    middle_ns = (start_ns + end_ns) // 2
    nearest = np.searchsorted((middle_ns[1:] + middle_ns[:-1]) // 2, stamp_ns)
    around = nearest if len(middle_ns) else np.full(len(stamp_ns), -1)
    return {
        Method(WINDOWS, OFFLINE): Answer.most_probable(around, probability),
        Method(WINDOWS, 0.0): Answer.most_probable(tick_in_force(stamp_ns, end_ns), probability),
        Method(SEGMENTS, OFFLINE): _true_segments(scored, tracked, scales_of(model)),
    }


def _true_segments(scored: Scoring, tracked: Tracked, scales: EvidenceParameters) -> Answer:
    """Labels of the true phases by the ticks within each."""
    begins = np.append(True, np.diff(scored.truth) != 0)
    run = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(run)) - 1
    is_known = scored.truth[first] != UNSCORED
    spans = [(int(scored.stamp_ns[a]), int(scored.stamp_ns[b])) for a, b in zip(first, last, strict=True)]
    probability, row = _posteriors(
        [s if known else (1, 0) for s, known in zip(spans, is_known, strict=True)], tracked, scales
    )
    return Answer.most_probable(row[run], probability)


def _posteriors(
    spans: list[tuple[int, int]], tracked: Tracked, scales: EvidenceParameters
) -> tuple[Array, Ints]:
    """Posterior (P, 7) of the spans with enough ticks, and the row of each span (-1: none)."""
    found: list[Array] = []
    row: list[int] = []
    for start_ns, end_ns in spans:
        inside = (tracked.start_ns >= start_ns) & (tracked.stamp_ns <= end_ns) & (tracked.frames > 0)
        enough = inside.sum() >= FEWEST
        row.append(len(found) if enough else -1)
        if enough:
            found.append(posterior(tracked.window.pick(inside), scales))
    return np.array(found).reshape(-1, len(STATES)), np.array(row, np.int64)


def posterior(window: Window, scales: EvidenceParameters) -> Array:
    """Posterior (7,) of the states for the samples of a window, by BIC."""
    chi_sq, parameters = np.zeros(len(STATES)), np.zeros(len(STATES))
    for model in CONTACT_MODELS:
        column, family = model.contact.column, model.family
        fitted = fit_window(model, window, scales)
        chi_sq[column] = fitted.rms[0] ** 2 * family.ROWS * len(window)
        parameters[column] = family.PARAMETERS
    return from_criteria(criteria(chi_sq, parameters, len(window)))


def criteria(chi_sq: Array, parameters: Array, samples: int) -> Array:
    """BIC (7,) of the states, the higher the better."""
    freedom = np.array([6 - Contact(state).codimension for state in STATES])
    return np.asarray(-0.5 * chi_sq - 0.5 * (parameters + samples * freedom) * np.log(samples))


def from_criteria(bic: Array) -> Array:
    weight = np.exp(bic - bic.max())
    return np.asarray(weight / weight.sum())
