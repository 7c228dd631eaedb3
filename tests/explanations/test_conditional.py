"""A further contact: the constraints that it adds, and the times at which it holds."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_motions import touching, x_of
from contact_tracker.arrays import Array
from contact_tracker.explanations.conditional_contact import (
    AT_FIRST,
    ConditionalMotion,
    ExplainedTicks,
    KnownContact,
    count_constraints,
    most_probable,
)
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact

TICKS = 120
SCALES = EvidenceParameters(0.3, 0.0, 0.2, 0.6, 0.1)
VARIANCE, EXCESS = (1e-8, 1e-6), (1e-4, 1e-2)


def kept(contact: Contact, seed: int) -> tuple[Window, Array]:
    """Noisy ticks in a contact, and its true x."""
    rng = np.random.default_rng(seed)
    motion = touching(contact, rng, TICKS)
    position = motion.position_m + rng.normal(0.0, np.sqrt(VARIANCE[0]), (TICKS, 3))
    noise = (np.tile(one, (TICKS, 1)) for one in (VARIANCE, EXCESS))
    window = Window(np.arange(TICKS), lift(motion.rotation, position), *noise)
    return window, x_of(contact, motion.object, motion.environment)


@pytest.mark.parametrize(("contact", "seed"), [*product(CONTACTS, range(3))])
def test_constraints_are_counted_once(contact: Contact, seed: int) -> None:
    window, x = kept(contact, seed)
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES))
    c = KnownContact(contact, x).c
    assert count_constraints(motion.moved, [c]) == contact.codimension
    assert count_constraints(motion.moved, [c, c]) == contact.codimension


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=8), st.floats(0.01, 0.6))
@settings(max_examples=40)
def test_presence_is_the_best_of_all_paths(ratio: list[float], change: float) -> None:
    def weight(path: tuple[int, ...]) -> float:
        total = np.log(AT_FIRST if path[0] else 1.0 - AT_FIRST)
        for before, now in pairwise(path):
            total += np.log(change if before != now else 1.0 - change)
        return float(total + np.dot(path, ratio))

    weights = {path: weight(path) for path in product((0, 1), repeat=len(ratio))}
    found = most_probable(np.array(ratio), np.full(len(ratio), np.log(change)))
    path = np.zeros(len(ratio), int)
    for run in found.runs:
        path[slice(*run)] = 1
    none = weights[(0,) * len(ratio)]
    assert weights[tuple(path.tolist())] == pytest.approx(max(weights.values()))
    assert found.log_odds == pytest.approx(max(weights.values()) - none, abs=1e-9)
