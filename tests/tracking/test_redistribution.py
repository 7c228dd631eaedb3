"""Redistribution of probability keeps every posterior a distribution: offline, lagged and online."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contact_tracker.cli.main import run
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking import ambiguity
from pose_filter import PoseFilter
from short_recordings import EDGE_TO_EDGES, MODEL, recorded

weights = st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7).filter(lambda w: sum(w) > 1e-3)
posteriors = weights.map(lambda w: np.array(w) / sum(w))
states = st.sampled_from(STATES)


def is_distribution(probability: np.ndarray) -> bool:
    return bool((probability >= 0.0).all() and abs(probability.sum() - 1.0) < 1e-9)


@given(posteriors, states, st.sets(states), st.floats(0.0, 1.0))
@example(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.4, 0.4]), Contact.EF, {Contact.FREE}, 1.0)
def test_sharing_among_inseparable_states_keeps_a_distribution(posterior, label, others, purpose):
    """Also if the label is not the most probable state, as on a Viterbi path or with a lag."""
    others = tuple(state for state in STATES if state in others - {label})
    shared = ambiguity.redistribute(posterior, label, others, purpose)
    assert is_distribution(shared)
    group = [label.column, *(other.column for other in others)]
    outside = np.setdiff1d(np.arange(7), group)
    assert shared[outside] == pytest.approx(posterior[outside], abs=1e-12)
    first = int(posterior.argmax())
    assert shared[first] >= shared.max() - 1e-9, "what was most probable stays so"


def test_free_motion_shares_where_all_possible_contacts_are_open():
    posterior, faces = np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.98]), (Contact.FF, Contact.EF, Contact.VF)
    shared = ambiguity.redistribute(posterior, Contact.FREE, faces, 1.0, faces)
    assert shared[Contact.FREE.column] < 0.5
    assert is_distribution(shared)
    assert not shared[[Contact.FE.column, Contact.FV.column, Contact.EE.column]].any()
    some = ambiguity.redistribute(posterior, Contact.FREE, faces[:2], 1.0, faces)
    assert (some == posterior).all()
    assert (ambiguity.redistribute(posterior, Contact.FREE, faces, 1.0) == posterior).all()


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


@given(posteriors, states, states)
def test_indistinguishable_states_share_whichever_is_the_label(posterior, first, second):
    """The shares do not depend on which of the indistinguishable contacts is the label."""
    every = [tuple(state for state in STATES if state is not label) for label in (first, second)]
    if Contact.FREE in (first, second):
        return
    one, other = (
        ambiguity.redistribute(posterior, c, o, 1.0) for c, o in zip((first, second), every, strict=True)
    )
    assert one == pytest.approx(other, abs=1e-12)


def test_every_belief_with_a_lag_is_a_distribution():
    one, beliefs = PoseFilter(MODEL, 1.0), []
    for pose in recorded(EDGE_TO_EDGES).poses:
        beliefs += one.update(pose)
    assert all(is_distribution(b.probability) for b in [*beliefs, *one.finish()])


@pytest.mark.long
def test_a_hinge_offline_is_a_distribution_at_every_tick(shared_recordings: Path, tmp_path: Path):
    """Real poses of a door; a fifth of its ticks had negative probabilities."""
    log = shared_recordings.parent / "field_cases" / "real" / "00_negative_probability_hinge.mcap"
    if not log.is_file():
        pytest.skip("the recording of the hinge is not here")
    assert run(["segment", str(log), "-o", str(tmp_path / "out.jsonl")]) == 0
    lines = (tmp_path / "out.jsonl").read_text().splitlines()
    posterior = np.array([list(json.loads(line)["probability"].values()) for line in lines])
    assert len(posterior) > 100
    assert all(is_distribution(row) for row in posterior)
