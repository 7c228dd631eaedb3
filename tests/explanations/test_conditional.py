"""Evidence of a further contact, without constraints that the first one implies, in any units."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_motions import touching, x_of
from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.explanations.conditional_contact import (
    AT_FIRST,
    RELAXED,
    ConditionalMotion,
    ExplainedTicks,
    coefficients,
    count_constraints,
    moments,
    most_probable,
    relaxed,
)
from contact_tracker.explanations.further_contacts import MIN_RATIO
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


@pytest.mark.parametrize("contact", CONTACTS)
def test_a_repeated_contact_has_no_evidence(contact: Contact) -> None:
    window, x = kept(contact, 1)
    c = coefficients(CONTACT_MODELS[contact.column], x)
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES))
    assert motion.evidence(c).gain.min() > 1.0
    again = motion.keeping(c).evidence(c)
    np.testing.assert_allclose(again.gain, 0.0, atol=1e-6)
    np.testing.assert_allclose(again.log_ratio, 0.0, atol=1e-6)


def test_vertices_and_lines_of_an_edge_on_a_face_are_implied() -> None:
    window, x = kept(Contact.EF, 2)
    direction, foot, normal, offset = x[:3], x[3:6], x[6:9], x[9:]
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES)).keeping(coefficients(CONTACT_MODELS[1], x))
    for along_m in (-0.1, 0.0, 0.3):
        vertex = np.concatenate([foot + along_m * direction, normal, offset])
        found = motion.evidence(coefficients(CONTACT_MODELS[Contact.VF.column], vertex))
        np.testing.assert_allclose(found.log_ratio, 0.0, atol=1e-6)
    beside = np.concatenate([foot + 0.1 * np.cross(direction, normal), normal, offset])
    found = motion.evidence(coefficients(CONTACT_MODELS[Contact.VF.column], beside))
    assert np.median(found.gain) > 0.5  # not implied
    assert found.log_ratio.sum() < -100.0  # nor kept


@given(st.sampled_from(CONTACTS), st.floats(1e-4, 1e4), st.integers(0, 99))
@settings(max_examples=40)
def test_units_of_a_row_do_not_matter(contact: Contact, unit: float, seed: int) -> None:
    window, x = kept(contact, seed)
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES))
    c = coefficients(CONTACT_MODELS[contact.column], x)
    one, other = motion.evidence(c), motion.evidence(c * unit)
    np.testing.assert_allclose(other.log_ratio, one.log_ratio, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("contact", "seed"), [*product(CONTACTS, range(3))])
def test_constraints_are_counted_once(contact: Contact, seed: int) -> None:
    window, x = kept(contact, seed)
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES))
    c = coefficients(CONTACT_MODELS[contact.column], x)
    assert count_constraints(motion.moved, [c]) == contact.codimension
    assert count_constraints(motion.moved, [c, c]) == contact.codimension


@pytest.mark.parametrize("contact", CONTACTS)
def test_the_relaxed_problem_indicates_only_unknown_contacts(contact: Contact) -> None:
    window, x = kept(contact, 5)
    motion = ConditionalMotion.of(ExplainedTicks(window, SCALES))
    known = motion.keeping(coefficients(CONTACT_MODELS[contact.column], x))
    before = max(relaxed(moments(model, motion))[0][-1] for model in RELAXED)
    after = max(relaxed(moments(model, known))[0][-1] for model in RELAXED)
    assert before > 100.0
    assert after < MIN_RATIO


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
