"""The reported posterior is a distribution, without certainty beside open states; wrenches decide among
them."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.ambiguity import decide_by_wrenches, reported
from pose_filter import PoseFilter
from short_recordings import EDGE_TO_EDGES, MODEL, recorded

weights = st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7).filter(lambda w: sum(w) > 1e-3)
posteriors = weights.map(lambda w: np.array(w) / sum(w))
states = st.sampled_from(STATES)


def is_distribution(probability: np.ndarray) -> bool:
    return bool((probability >= 0.0).all() and abs(probability.sum() - 1.0) < 1e-9)


@given(posteriors, states, st.sets(states))
@example(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), Contact.EE, {Contact.VF})
def test_no_label_is_certain_beside_a_state_that_is_not_excluded(posterior, label, others):
    """The first example was reported as e-e 1.00, or v-f."""
    others = tuple(state for state in STATES if state in others - {label})
    shared = ambiguity.with_rivals(posterior, label, others)
    assert is_distribution(shared)
    assert (shared[label.column] >= shared).all() or not (posterior[label.column] >= posterior).all()
    assert shared[label.column] <= ambiguity.most_beside(len(others)) + 1e-8
    again = ambiguity.with_rivals(shared, label, others)
    assert again == pytest.approx(shared, abs=1e-8)


def test_every_belief_with_a_lag_is_a_distribution():
    one, beliefs = PoseFilter(MODEL, 1.0), []
    for pose in recorded(EDGE_TO_EDGES).poses[500:1100]:
        beliefs += one.update(pose)
    assert all(is_distribution(b.probability) for b in [*beliefs, *one.finish()])


# --- wrenches decide among states that motion does not distinguish, and only among them ---
def evidence(**nats: float) -> np.ndarray:
    return np.array([nats.get(state.name, 0.0) for state in STATES])


def test_only_states_left_open_by_motion_are_decided_among() -> None:
    assert decide_by_wrenches(Contact.FF, (), evidence(VF=1e3)) == (Contact.FF, (), None)
    label, others, share = decide_by_wrenches(Contact.FF, (Contact.EF, Contact.VF), evidence(VF=9.0, EF=7.0))
    assert (label, others) == (Contact.VF, (Contact.EF,))
    assert share.sum() == pytest.approx(1.0)
    assert share[Contact.EF.column] == pytest.approx(share[Contact.VF.column] * np.exp(-2.0))
    label, _, share = decide_by_wrenches(Contact.FF, (Contact.EF,), evidence(EE=1e4))  # excluded by motion
    assert label is Contact.FF
    assert share[Contact.EE.column] == 0.0
    assert share[Contact.FF.column] == pytest.approx(
        2.0 / 3.0
    )  # without evidence the label is twice as likely
    _, _, share = decide_by_wrenches(Contact.FF, (Contact.EF, Contact.FREE), evidence(FF=-1e8, EF=1e8))
    assert np.isfinite(share).all()


def test_what_wrenches_rule_out_gives_its_probability_to_the_label() -> None:
    """Also where the evidence is so large that its exponential is zero."""
    label, others, share = decide_by_wrenches(
        Contact.EE, (Contact.EF, Contact.VF), evidence(EF=40.0, EE=-900.0)
    )
    assert (label, others) == (Contact.EF, ())
    probability = np.array([0.01, 0.07, 0.06, 0.12, 0.17, 0.55, 0.02])
    found = reported(probability, label, others, EMPTY_MAP, share=share)
    assert found[Contact.EF.column] == pytest.approx(0.07 + 0.12 + 0.55)
    assert found.sum() == pytest.approx(1.0)


def test_sharing_keeps_the_probability_of_the_others() -> None:
    probability = np.array([0.5, 0.2, 0.1, 0.05, 0.05, 0.05, 0.05])
    share = np.array([0.25, 0.75, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = reported(probability, Contact.EF, (), EMPTY_MAP, share=share)
    np.testing.assert_allclose(found, [0.175, 0.525, *probability[2:]])
    assert found.sum() == pytest.approx(1.0)
