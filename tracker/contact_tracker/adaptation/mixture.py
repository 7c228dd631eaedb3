"""The mixture of the beliefs of several trackers, and a belief while the stream itself is in doubt."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import STATES
from contact_tracker.tracking.ambiguity import at_most
from contact_tracker.tracking.belief import Belief

Array = NDArray[np.float64]

DOUBT: Final = 0.5
"""Share of the probability that is spread evenly while the stream is in doubt."""


def mixture(beliefs: Sequence[Belief], log_weight: Array) -> tuple[Belief, int | None]:
    """The belief of K trackers by their ``log_weight`` (K,): the mean posterior and its most probable state.

    Onset, elements and alternatives are those of the most probable tracker with this label, whose number is
    returned; without one (None) they are unknown.
    """
    if len(beliefs) == 1:
        return beliefs[0], 0
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    probability = weight @ np.array([belief.probability for belief in beliefs])
    label = STATES[int(probability.argmax())]
    share = weight * [belief.probability[label.column] for belief in beliefs]
    with_label = [number for number, belief in enumerate(beliefs) if belief.contact is label]
    if not with_label:
        likely = beliefs[int(share.argmax())]
        unknown = Belief(likely.stamp_ns, label, probability, likely.stamp_ns, None, likely.residual)
        return unknown, None
    source = max(with_label, key=lambda number: share[number])
    belief = beliefs[source]
    # only one of the trackers looks for further contacts, and caps its own label
    probability = at_most(probability, label) if belief.is_open else probability
    return replace(belief, probability=probability), source


def spread_out(probability: Array) -> Array:
    """Posterior (..., 7) mixed with a uniform one: the poses may not be what they seem."""
    return np.asarray((1.0 - DOUBT) * probability + DOUBT / len(STATES))
