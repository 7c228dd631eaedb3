"""Wrenches decide among states that motion does not distinguish, and only among them."""

import numpy as np
import pytest

from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.ambiguity import decide_by_wrenches, shared

NOTHING = np.zeros(len(STATES))


def evidence(**nats: float) -> np.ndarray:
    return np.array([nats.get(state.name, 0.0) for state in STATES])


def test_a_label_determined_by_motion_stays() -> None:
    assert decide_by_wrenches(Contact.FF, (), evidence(VF=1e3)) == (Contact.FF, (), None)


def test_the_most_probable_of_those_left_open_becomes_the_label() -> None:
    label, others, share = decide_by_wrenches(Contact.FF, (Contact.EF, Contact.VF), evidence(VF=9.0, EF=7.0))
    assert label is Contact.VF
    assert others == (Contact.EF,)
    assert share is not None
    assert share.sum() == pytest.approx(1.0)
    assert share[Contact.EF.column] == pytest.approx(share[Contact.VF.column] * np.exp(-2.0))


def test_contacts_excluded_by_motion_are_not_chosen() -> None:
    label, _, share = decide_by_wrenches(Contact.FF, (Contact.EF,), evidence(EE=1e4))
    assert label is Contact.FF
    assert share is not None
    assert share[Contact.EE.column] == 0.0


def test_without_evidence_the_label_is_twice_as_likely() -> None:
    label, others, share = decide_by_wrenches(Contact.FF, (Contact.EF,), NOTHING)
    assert (label, others) == (Contact.FF, (Contact.EF,))
    assert share is not None
    assert share[Contact.FF.column] == pytest.approx(2.0 / 3.0)


def test_evidence_of_any_size_is_finite() -> None:
    _, _, share = decide_by_wrenches(Contact.FF, (Contact.EF, Contact.FREE), evidence(FF=-1e8, EF=1e8))
    assert share is not None
    assert np.isfinite(share).all()


def test_what_wrenches_rule_out_gives_its_probability_to_the_label() -> None:
    """Also where the evidence is so large that its exponential is zero."""
    label, others, share = decide_by_wrenches(
        Contact.EE, (Contact.EF, Contact.VF), evidence(EF=40.0, EE=-900.0)
    )
    assert (label, others) == (Contact.EF, ())
    assert share is not None
    probability = np.array([0.01, 0.07, 0.06, 0.12, 0.17, 0.55, 0.02])
    found = shared(probability, share)
    assert found[Contact.EF.column] == pytest.approx(0.07 + 0.12 + 0.55)
    assert found.sum() == pytest.approx(1.0)


def test_sharing_keeps_the_probability_of_the_others() -> None:
    probability = np.array([0.5, 0.2, 0.1, 0.05, 0.05, 0.05, 0.05])
    share = np.array([0.25, 0.75, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = shared(probability, share)
    np.testing.assert_allclose(found, [0.175, 0.525, *probability[2:]])
    assert found.sum() == pytest.approx(1.0)
