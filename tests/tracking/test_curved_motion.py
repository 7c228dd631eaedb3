"""Motion along a curved surface is none of the six contacts, and is not said to be free."""

import numpy as np
import pytest

from contact_tracker.hypotheses import compiled
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking import curved_motion, tracker
from contact_tracker.tracking.curved_motion import NOT_JUDGED, judged_online
from contact_tracker.tracking.offline_smoother import segment
from restricted_motions import MOTIONS, poses_of
from short_recordings import MODEL

FREE = Contact.FREE.column
needs_kernels = pytest.mark.skipif(not compiled.in_use(), reason="it takes numpy too long")


@needs_kernels
@pytest.mark.parametrize("name", ["vertex on a sphere of 0.2 m", "edge across a cylinder of 0.1 m"])
def test_curved_contact_is_any_other(name):
    found = segment(gate(poses_of(MOTIONS[name], np.random.default_rng(1), 10.0)), MODEL)
    longest = max(found.segments, key=lambda one: one.end_ns - one.start_ns)
    assert longest.contact is Contact.FREE
    assert set(longest.inseparable) == set(CONTACTS)
    assert longest.probability < 0.5
    assert found.filtered.probability[-20:, FREE].max() < 0.5
    assert found.beliefs.probability.sum(axis=1) == pytest.approx(1.0)


@needs_kernels
def test_free_motion_is_free():
    found = segment(gate(poses_of(MOTIONS["free"], np.random.default_rng(1), 10.0)), MODEL)
    longest = max(found.segments, key=lambda one: one.end_ns - one.start_ns)
    assert longest.contact is Contact.FREE
    assert longest.inseparable == ()
    assert longest.probability > 0.9


def test_free_motion_is_judged_now_and_then(monkeypatch):
    """Not before it has lasted, and again whenever it has lasted half as long again; anew after a contact."""
    asked = []
    monkeypatch.setattr(curved_motion, "curved_evidence", lambda window, _: asked.append(len(window)) or 9.0)
    known = NOT_JUDGED
    for tick in range(100):
        window = Window(np.arange(tick + 1), np.zeros((tick + 1, 25)), *np.ones((2, tick + 1, 2)))
        known = judged_online(known, window, 0, tracker.scales_of(MODEL), EMPTY_MAP)
        assert (known.probability > 0.9) == (tick >= 39)
    assert asked == [40, 60, 60]
    known = judged_online(known, window, 90, tracker.scales_of(MODEL), EMPTY_MAP)
    assert known.probability == 0.0
    complete = judged_online(NOT_JUDGED, window, 0, tracker.scales_of(MODEL), PriorMap(object_complete=True))
    assert complete.probability == 0.0
