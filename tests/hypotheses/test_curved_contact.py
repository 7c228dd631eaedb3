"""Curved contacts: only true contact has evidence."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.explanations import curved_contact
from contact_tracker.geometry import lifted_pose
from contact_tracker.motion.window import Window
from contact_tracker.tracking.state import scales_of
from restricted_motions import MOTIONS, tilted_mug
from short_recordings import MODEL

SCALES = scales_of(MODEL)
VARIANCE = np.array([1e-8, 1e-6])
EXCESS = np.array([1e-6, 1e-4])


def window_of(name, seed, seconds=6.0):
    """A window of ticks of 0.1 s."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.0, seconds, 0.1)
    turn, place = MOTIONS[name](time_s, rng)
    turn = turn * Rotation.from_rotvec(np.sqrt(VARIANCE[1]) * rng.normal(size=(len(time_s), 3)))
    place = place + np.sqrt(VARIANCE[0]) * rng.normal(size=place.shape)
    rows = np.ones((len(time_s), 1))
    lifts = lifted_pose.lift(turn.as_matrix(), place)
    return Window(np.arange(len(time_s)), lifts, rows * VARIANCE, rows * EXCESS)


def curved_evidence(window, touched=()):
    return curved_contact.curved_evidence(window, SCALES, touched)


@pytest.mark.parametrize("name", [name for name in MOTIONS if "sphere" in name or "cylinder" in name])
def test_contact_along_curved_surfaces_has_evidence(name):
    assert curved_evidence(window_of(name, 1)) > 10.0


def test_free_motion_and_rest_have_none():
    assert curved_evidence(window_of("free", 0)) < -100.0
    assert curved_evidence(window_of("free", 1, 4.0)) < -100.0
    rest = lifted_pose.lift(np.eye(3)[None].repeat(60, axis=0), np.zeros((60, 3)))
    rows = np.ones((60, 1))
    window = Window(np.arange(60), rest, rows * VARIANCE, 0.0 * rows * EXCESS)
    assert curved_evidence(window) < 3.0


UP = np.array([0.0, 0.0, 1.0])


def test_rims_of_touched_faces_are_found(monkeypatch):
    monkeypatch.setitem(MOTIONS, "mug", lambda time_s, rng: tilted_mug(time_s + 10.0, rng))
    window = window_of("mug", 1)
    other = np.array([0.6, 0.0, 0.8])
    assert curved_evidence(window, [(other, UP), (UP, UP)]) > 30.0
    assert curved_evidence(window) < 0.0, "random starts do not find it"


@pytest.mark.parametrize("seed", range(4))
def test_rims_of_touched_faces_do_not_explain_free_motion(seed):
    assert curved_evidence(window_of("free", seed), [(UP, UP)]) < -100.0
