"""The mixture of the beliefs of several trackers, and a belief while the stream itself is in doubt."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.ambiguity import at_most, with_rivals
from contact_tracker.tracking.belief import Belief

Array = NDArray[np.float64]

DOUBT: Final = 0.5
"""Weight of the uniform distribution while the stream is in doubt."""


def mixture(beliefs: Sequence[Belief], log_weight: Array, possible: tuple[Contact, ...] = CONTACTS) -> Belief:
    """The belief of K trackers by their ``log_weight`` (K,): the mean posterior and its most probable state.

    Onset, elements and alternatives are those of the most probable tracker with this label. Without one,
    onset and elements are unknown, and the label is indistinguishable from all states that the trackers
    report. ``possible`` are the contacts that can occur.
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
        reported = {one for belief in beliefs for one in (belief.contact, *belief.inseparable)} - {label}
        source = replace(
            source,
            contact=label,
            onset_ns=source.stamp_ns,
            geometry=None,
            inseparable=tuple(one for one in STATES if one in reported),
            p_restricted=0.0,
            further=(),
            is_open=False,
        )
    probability = with_rivals(probability, label, source.inseparable)  # as of the other trackers they may be
    limited = at_most(probability, label, possible=possible)
    # only one of the trackers searches further contacts, and only its label is limited
    return replace(source, probability=limited if source.is_open else probability)


def mixed_with_uniform(probability: Array, possible: tuple[Contact, ...] = CONTACTS) -> Array:
    """Posterior (..., 7) mixed with a uniform one over free motion and the ``possible`` contacts, while the
    poses or the map may be wrong."""
    uniform = np.array([one in (*possible, Contact.FREE) for one in STATES]) / (1 + len(possible))
    return np.asarray((1.0 - DOUBT) * probability + DOUBT * uniform)
