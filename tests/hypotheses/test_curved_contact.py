"""Curved contacts: residuals vanish in contact, and only true contact has evidence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.explanations.curved_contact import (
    CURVED_CONTACTS,
    fit_curved,
    points_or_lines,
    rim_on_plane,
)
from contact_tracker.geometry import lifted_pose
from contact_tracker.motion.window import Window
from contact_tracker.tracking.state import scales_of
from restricted_motions import MOTIONS, tilted_mug
from short_recordings import MODEL

SCALES = scales_of(MODEL)
VARIANCE = np.array([1e-8, 1e-6])
EXCESS = np.array([1e-6, 1e-4])
each_contact = pytest.mark.parametrize("contact", CURVED_CONTACTS, ids=lambda contact: contact.name)
seeds = st.integers(0, 2**32 - 1)


@each_contact
@settings(max_examples=8)
@given(seeds)
def test_jacobians_are_derivatives(contact, seed):
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_quat(rng.normal(size=(4, 4))).as_matrix()
    position, x = rng.normal(size=(4, 3)), rng.normal(size=(2, contact.size))
    touch, step = contact.touch(x, rotation, position), 1e-6
    ahead = [
        (
            contact.touch(x + step * way, rotation, position).residual
            - contact.touch(x - step * way, rotation, position).residual
        )
        / (2.0 * step)
        for way in np.eye(contact.size)
    ]
    scale = np.abs(touch.jacobian).max()
    assert np.stack(ahead, axis=-1) == pytest.approx(touch.jacobian, abs=1e-5 * scale * scale + 1e-6)


def test_distances_are_those_of_geometry():
    poses = np.eye(3)[None].repeat(2, axis=0), np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 4.0]])
    at_point = points_or_lines(np.array([[0.0] * 6 + [1.0]]), *poses, lines=0)
    assert at_point.residual[0] == pytest.approx([1.0, 4.0])
    along_x = [1.0, 0.0, 0.0]
    at_line = points_or_lines(np.array([[0.0] * 6 + along_x + [1.0]]), *poses, lines=1)
    assert at_line.residual[0] == pytest.approx([1.0, 3.0])
    crossed = points_or_lines(np.array([[0.0] * 6 + along_x + [0.0, 1.0, 0.0, 0.0]]), *poses, lines=2)
    assert np.abs(crossed.residual[0]) == pytest.approx([2.0, 4.0])
    assert crossed.point[0] == pytest.approx(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), abs=1e-12)
    upright = [0.0, 0.0, 1.0]
    lying = rim_on_plane(np.array([[0.0] * 6 + upright + along_x + [0.5]]), *poses)
    assert lying.residual[0] == pytest.approx([1.5, 3.5]), "the lowest point of a rim that stands upright"


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
    return fit_curved(window, SCALES, touched=touched).log_evidence


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
