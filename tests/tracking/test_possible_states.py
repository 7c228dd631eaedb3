"""``states``: contacts that cannot occur have probability zero."""

from pathlib import Path

import numpy as np
import pytest

import contact_tracker
from contact_tracker.states import STATES, Contact
from short_recordings import FACE_TO_EDGE, recorded

POSSIBLE = ("e-f", "v-f")
NEVER = [state.column for state in STATES if state not in (*POSSIBLE, Contact.FREE)]


def assert_possible(probability: np.ndarray) -> None:
    np.testing.assert_array_equal(probability[..., NEVER], 0.0)
    np.testing.assert_allclose(probability.sum(axis=-1), 1.0, atol=1e-12)


def test_others_have_probability_zero_offline() -> None:
    """The recording begins with f-f, which fits as e-f."""
    trajectory = contact_tracker.Trajectory(recorded(FACE_TO_EDGE).poses[400:800:2])
    result = contact_tracker.segment(trajectory, states=POSSIBLE)
    assert_possible(result.beliefs.probability)
    assert_possible(result.segmentation.filtered.probability)
    assert {one.contact for one in result.segments} <= {*POSSIBLE, Contact.FREE}
    assert {other for one in result.segments for other in one.inseparable} <= {*POSSIBLE, Contact.FREE}


def test_a_contact_that_is_left_out_is_noticed_and_no_label_is_sure() -> None:
    trajectory = contact_tracker.Trajectory(recorded(FACE_TO_EDGE).poses[300:1200:2])
    with pytest.warns(contact_tracker.ContactTrackerWarning, match="states, which leaves out e-f, f-e, v-f"):
        result = contact_tracker.segment(trajectory, states=["f-f"])
    assert max(one.probability for one in result.segments) < 0.8
    assert not contact_tracker.segment(trajectory, states=["f-f", "e-f"]).warnings


def test_others_have_probability_zero_online_also_after_a_restore(tmp_path: Path) -> None:
    tracker = contact_tracker.Tracker(states=POSSIBLE, lag_s=0.5)
    for number, pose in enumerate(recorded(FACE_TO_EDGE).poses[300:800:2]):
        if number == 100:
            tracker.save(tmp_path / "state")
            tracker = contact_tracker.Tracker.load(tmp_path / "state")
        belief = tracker.update(*pose)
        if belief is not None:
            assert_possible(belief.probability)
    assert tracker.finish()
