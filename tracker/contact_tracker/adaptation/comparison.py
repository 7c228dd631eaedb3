"""What the evidence says between trackers that take the noise of a tick to differ (docs/theory.md, T33).

A tracker's evidence is relative to free motion, as that tracker sees it. To compare two of them free motion
has to be the same for both; and noise that looks like motion at rest must not decide.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Motion
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.motion.lifted_pose import R, T
from contact_tracker.motion.window import Window
from contact_tracker.tracking.state import TrackerState

Array = NDArray[np.float64]

SPAN_TICKS: Final = 5
SMOOTH: Final = 4.0
"""An object gets farther in ``SPAN_TICKS`` ticks, in squares, by more than this times what noise would."""
LASTING_TICKS: Final = 3
"""It moves if it did in so many ticks that follow each other: by chance noise does it once, hardly thrice."""
HOPELESS_AFTER_S: Final = 1.5
HOPELESS_NATS: Final = 40.0
"""After so much motion a tracker so far behind the best is dropped."""
DROPPED_AFTER_S: Final = 5.0
MARGIN_NATS: Final = 20.0
"""After so much (its first ticks mislead) one so far behind."""
DECIDED_AFTER_S: Final = 10.0
"""After so much the best is taken, if it is the best by its evidence as well: the prior is meant for the
seconds before."""
LONGEST_S: Final = 30.0
"""After so much that of the most evidence is taken."""
_DISTANCES: Final = np.array([*(1.0 for _ in CONTACT_MODELS), 0.0])
_ANGLES: Final = np.array([*(model.contact.codimension - 1.0 for model in CONTACT_MODELS), 0.0])
"""Constraints of each state (7,) on a distance and on angles."""


class TickEvidence(NamedTuple):
    """What a tick was to one tracker: the ``gain`` of log evidence (nats), the ``posterior`` (7,) after it,
    the variances (2,) of free motion and noise together (m^2, rad^2), and the ``activity``."""

    gain: float
    posterior: Array
    free_variance: Array
    activity: float


def tick_evidence(before: TrackerState, after: TrackerState) -> TickEvidence:
    """Of the tick that has led from one state to the next."""
    weight = np.exp(after.log_state_weight - after.log_state_weight.max())
    window = after.window
    gain, free_variance = (
        after.log_evidence - before.log_evidence,
        window.innovation_excess[-1] + window.variance[-1],
    )
    return TickEvidence(gain, weight / weight.sum(), free_variance, window.latest_motion_ratio)


def relative_evidence(ticks: Sequence[TickEvidence], motion: Motion) -> Array:
    """Log evidence (K,) of one tick by K trackers, free motion being what it is to the first of them.

    A constraint gains log S / 2 where S is the variance of free motion along it. What a tracker of larger
    noise takes for noise it does not count as motion: its S is smaller, and so is the gain, by what is added
    here.
    """
    squared_lever_m2 = 2.0 * motion.body_radius_m**2
    free = np.array([tick.free_variance for tick in ticks])
    log_distance = np.log(free[:, 0] + squared_lever_m2 * free[:, 1])
    log_angle = np.log(free[:, 1])
    posterior = np.array([tick.posterior for tick in ticks])
    withheld = (posterior @ _DISTANCES) * (log_distance[0] - log_distance)
    withheld += (posterior @ _ANGLES) * (log_angle[0] - log_angle)
    gain = np.array([tick.gain for tick in ticks])
    return np.asarray(gain + 0.5 * motion.likelihood_exponent * withheld)


def are_compared(log_weight: Array, log_prior: Array, moved_s: float) -> NDArray[np.bool_]:
    """Which of K trackers go on once the object has moved for ``moved_s``: those near to the best, and from
    ``DECIDED_AFTER_S`` on that one alone.

    Parameters
    ----------
    log_weight, log_prior : (K,), in nats; their difference is the evidence. What the prior favours alone, or
        the evidence alone, is not taken before ``LONGEST_S``, nor is the other one dropped.
    """
    if moved_s < HOPELESS_AFTER_S:
        return np.ones(len(log_weight), np.bool_)
    margin = MARGIN_NATS if moved_s >= DROPPED_AFTER_S else HOPELESS_NATS
    ranked = log_weight, log_weight - log_prior
    best, favoured = (int(one.argmax()) for one in ranked)
    if moved_s >= LONGEST_S or (moved_s >= DECIDED_AFTER_S and best == favoured):
        return np.asarray(np.arange(len(log_weight)) == favoured, np.bool_)
    return np.asarray(np.any([one > one.max() - margin for one in ranked], axis=0))


def is_moving(window: Window) -> bool:
    """Whether the object moves in the newest tick, whatever the noise: noise does not lead away for long."""
    poses, least = window.zeta[-SPAN_TICKS - LASTING_TICKS :], SPAN_TICKS + LASTING_TICKS
    if len(poses) < least:
        return False
    spans = [poses[first : first + SPAN_TICKS + 1] for first in range(LASTING_TICKS)]
    return any(all(_leads_away(span[:, part]) for span in spans) for part in (R, T))


def _leads_away(places: Array) -> bool:
    """Whether the way (N, d) leads farther than as many steps of noise; ticks without frames are no steps."""
    steps_sq = (np.diff(places, axis=0) ** 2).sum(axis=1)
    steps_sq = steps_sq[steps_sq > 0.0]
    if len(steps_sq) < 2:
        return False
    return float(((places[-1] - places[0]) ** 2).sum()) > SMOOTH * float(steps_sq.mean())
