"""What several trackers believe together, and what is left of it while the stream itself is in doubt."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import STATES
from contact_tracker.tracking.belief import Belief

Array = NDArray[np.float64]

DOUBT: Final = 0.5
"""Share of the probability that is spread evenly while the stream is in doubt."""


def mixture(beliefs: Sequence[Belief], log_weight: Array) -> Belief:
    """The belief of K trackers by their ``log_weight`` (K,): the mean posterior and its most probable state.

    What else there is to say of that state says the most probable tracker among those that have its label;
    where none has, its onset and elements are not known.
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
        source = replace(
            source, contact=label, onset_ns=source.stamp_ns, geometry=None, inseparable=(), further=()
        )
    return replace(source, probability=probability)


def spread_out(probability: Array) -> Array:
    """Posterior (..., 7) of which nothing is sure: the poses may not be what they seem."""
    return np.asarray((1.0 - DOUBT) * probability + DOUBT / len(STATES))
