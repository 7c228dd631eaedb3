"""Comparison of trackers with different noise of a tick, by their evidence (docs/theory.md, T33).

A tracker's evidence is relative to its own model of free motion. For a comparison the model of free motion
must be the same for all, and noise at rest must not be taken for motion. By the weights beliefs are mixed.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Motion
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.ambiguity import reported
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.state import FilterState

Array = NDArray[np.float64]

EARLY_DROP_AFTER_S: Final = 1.5
EARLY_MARGIN_NATS: Final = 40.0
"""After this much motion trackers this far behind the best are dropped: a large margin, since the first ticks
mislead."""
DROP_AFTER_S: Final = 5.0
MARGIN_NATS: Final = 20.0
"""The same later, with a smaller margin."""
DECIDED_AFTER_S: Final = 10.0
"""After this much motion the best tracker is chosen, if it is also the best by evidence alone."""
LONGEST_S: Final = 30.0
"""After this much motion the tracker with the largest evidence is chosen."""
_DISTANCES: Final = np.array([*(1.0 for _ in CONTACT_MODELS), 0.0])
_ANGLES: Final = np.array([*(model.contact.codimension - 1.0 for model in CONTACT_MODELS), 0.0])
"""Number of constraints of each state (7,) on a distance and on angles."""


class TickEvidence(NamedTuple):
    """A tick as one tracker evaluates it: the ``gain`` of log evidence (nats), the ``posterior`` (7,) after
    it, the variances (2,) of free motion plus noise (m^2, rad^2), and the ``activity``."""

    gain: float
    posterior: Array
    free_variance: Array
    activity: float


def tick_evidence(before: FilterState, after: FilterState) -> TickEvidence:
    """The evidence of the tick between two states."""
    weight = np.exp(after.log_state_weight - after.log_state_weight.max())
    window = after.window
    gain, free_variance = (
        after.log_evidence - before.log_evidence,
        window.innovation_excess[-1] + window.variance[-1],
    )
    return TickEvidence(gain, weight / weight.sum(), free_variance, window.latest_motion_ratio)


def relative_evidence(ticks: Sequence[TickEvidence], motion: Motion) -> Array:
    """Log evidence (K,) of one tick by K trackers, relative to the free motion of the first.

    A constraint gains log S / 2, where S is the variance of free motion along it. A tracker with larger noise
    has a smaller S, because it takes a part of the motion for noise; the difference is added here.
    """
    squared_lever_m2 = 2.0 * motion.body_radius_m**2
    free = np.array([tick.free_variance for tick in ticks])
    log_distance = np.log(free[:, 0] + squared_lever_m2 * free[:, 1])
    log_angle = np.log(free[:, 1])
    posterior = np.array([tick.posterior for tick in ticks])
    difference = (posterior @ _DISTANCES) * (log_distance[0] - log_distance)
    difference += (posterior @ _ANGLES) * (log_angle[0] - log_angle)
    gain = np.array([tick.gain for tick in ticks])
    return np.asarray(gain + 0.5 * motion.likelihood_exponent * difference)


def are_compared(log_weight: Array, log_prior: Array, moved_s: float) -> NDArray[np.bool_]:
    """Which of K trackers are kept after ``moved_s`` seconds of motion: those near the best, and from
    ``DECIDED_AFTER_S`` on the best alone.

    Parameters
    ----------
    log_weight, log_prior : (K,), in nats; their difference is the evidence. Before ``LONGEST_S``, the best
        by weight and the best by evidence alone are both kept if they differ.
    """
    if moved_s < EARLY_DROP_AFTER_S:
        return np.ones(len(log_weight), np.bool_)
    margin = MARGIN_NATS if moved_s >= DROP_AFTER_S else EARLY_MARGIN_NATS
    scores = log_weight, log_weight - log_prior
    best, best_by_evidence = (int(one.argmax()) for one in scores)
    if moved_s >= LONGEST_S or (moved_s >= DECIDED_AFTER_S and best == best_by_evidence):
        return np.asarray(np.arange(len(log_weight)) == best_by_evidence, np.bool_)
    return np.asarray(np.any([one > one.max() - margin for one in scores], axis=0))


DOUBT: Final = 0.5
"""Weight of the uniform distribution while the stream is in doubt."""


def mixture(beliefs: Sequence[Belief], log_weight: Array, known_map: Map = EMPTY_MAP) -> Belief:
    """The belief of K trackers by their ``log_weight`` (K,): the mean posterior and its most probable state.

    Onset, elements and alternatives are those of the most probable tracker with this label. Without one,
    onset and elements are unknown, and the label is indistinguishable from all states that the trackers
    report. ``known_map`` has the contacts that can occur.
    """
    if len(beliefs) == 1:
        return beliefs[0]
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    probability = weight @ np.array([belief.probability for belief in beliefs])
    label = STATES[int(probability.argmax())]
    share = [w * b.probability[label.column] for w, b in zip(weight, beliefs, strict=True)]
    ranked = sorted(zip(beliefs, share, strict=True), key=lambda one: (one[0].contact is label, one[1]))
    source, _ = ranked[-1]
    if source.contact is not label:
        others = {one for belief in beliefs for one in (belief.contact, *belief.inseparable)} - {label}
        source = replace(
            source,
            contact=label,
            onset_ns=source.stamp_ns,
            geometry=None,
            inseparable=tuple(one for one in STATES if one in others),
            p_restricted=0.0,
            further=(),
            is_open=False,
        )
    # as of the other trackers they may be rivals; only one of the trackers searches further contacts, and
    # only its label is limited
    probability = reported(probability, label, source.inseparable, known_map, is_open=source.is_open)
    return replace(source, probability=probability)


def mixed_with_uniform(probability: Array, possible: tuple[Contact, ...] = CONTACTS) -> Array:
    """Posterior (..., 7) mixed with a uniform one over free motion and the ``possible`` contacts, while the
    poses or the map may be wrong."""
    uniform = np.array([one in (*possible, Contact.FREE) for one in STATES]) / (1 + len(possible))
    return np.asarray((1.0 - DOUBT) * probability + DOUBT * uniform)
