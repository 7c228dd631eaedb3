"""The paper's fixed-window curves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_motions import touching
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import matrix, minimise_slsqp, motion
from contact_tracker.paper.window_curves import WindowCurves, curves, minimise_windows
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.simulate import Phase, Scenario, simulate

RATE_NS = 5_000_000


def recording(*contacts, frames=150, seed=0, sigma_m=3e-4):
    """Phases of random poses in contact, one after the other."""
    rng = np.random.default_rng(seed)
    parts = [touching(contact, rng, frames, swing=0.5) for contact in contacts]
    rotation = np.concatenate([t.rotation for t in parts])
    position = np.concatenate([t.position_m - t.position_m.mean(axis=0) for t in parts])
    position += rng.normal(size=position.shape) * sigma_m
    stamps = 1_000 + RATE_NS * np.arange(len(position), dtype=np.int64)
    return Poses(stamps, position, Rotation.from_matrix(rotation).as_quat())


def test_stamps_are_the_windows_ends():
    poses = recording(Contact.VF)
    found = curves(poses, frames=50, step=20)
    np.testing.assert_array_equal(found.stamp_ns, poses.stamp_ns[49::20])
    assert found.stamp_ns.dtype == np.int64
    assert found.minimum.shape == found.normalised.shape == found.converged.shape == (6, 6)


@pytest.mark.parametrize(("length", "windows"), [(0, 0), (49, 0), (69, 1), (70, 2)])
def test_short_recordings_have_few_windows(length, windows):
    found = curves(recording(Contact.VF)[:length], frames=50, step=20)
    assert found.minimum.shape == found.normalised.shape == (windows, 6)
    assert found.stamp_ns.shape == (windows,)


@pytest.mark.parametrize(("frames", "step"), [(0, 1), (1, 0), (-5, 10)])
def test_impossible_windows_are_refused(frames, step):
    with pytest.raises(ValueError, match="at least one"):
        curves(recording(Contact.VF), frames, step)


@pytest.mark.parametrize("contact", CONTACTS, ids=str)
def test_minima_are_low_for_the_true_contact_and_contained_ones(contact):
    """Low is at the noise; contacts with as many or more constraints are far above it."""
    found = curves(recording(contact, contact), frames=150, step=150)
    noise = 150 * 3e-4**2
    for column, other in enumerate(CONTACTS):
        if contact.contains(other):
            assert (found.minimum[:, column] < 2.0 * noise).all(), other
        elif other.codimension >= contact.codimension:
            assert (found.minimum[:, column] > 10.0 * noise).all(), other


def test_normalised_by_the_maximum():
    minimum = np.random.default_rng(0).uniform(size=(9, 6)) * np.logspace(-9, 0, 6)
    found = WindowCurves(np.arange(9), minimum, np.ones((9, 6), bool))
    np.testing.assert_allclose(found.normalised.max(axis=0), 1.0)
    np.testing.assert_allclose(found.normalised * minimum.max(axis=0), minimum)


def test_windows_do_not_depend_on_how_frames_and_step_divide():
    poses = recording(Contact.EF)
    fine, coarse = curves(poses, 100, 7), curves(poses, 100, 50)
    np.testing.assert_allclose(fine.minimum[0], coarse.minimum[0], rtol=0.02)


def test_no_higher_than_slsqp():
    poses = recording(Contact.EF, Contact.EE)
    found = curves(poses, frames=100, step=50)
    rotation, p = motion(poses.rotation, poses.position_m - poses.position_m.mean(axis=0))
    rng = np.random.default_rng(1)
    for column, contact in enumerate(CONTACTS):
        for window in (0, 2, 4):
            frames = slice(50 * window, 50 * window + 100)
            slsqp = minimise_slsqp(contact, matrix(contact, rotation[frames], p[frames]), rng, starts=2)
            assert found.minimum[window, column] <= 1.02 * slsqp.value, (contact, window)


def test_a_window_without_neighbours_is_no_higher_than_slsqp():
    """Two in which the relaxed problems alone lead to a minimum that is higher by 29 and 40 %."""
    rng, model = np.random.default_rng(1), CONTACT_MODELS[Contact.EE.column]
    for seed in (2, 3):
        poses = simulate(Scenario((Phase(Contact.EE, 2.5),)), seed).poses
        position_m = poses.position_m - poses.position_m.mean(axis=0)
        found = minimise_windows(model, poses.rotation, position_m, len(poses), 1)
        slsqp = minimise_slsqp(Contact.EE, matrix(Contact.EE, *motion(poses.rotation, position_m)), rng, 6)
        assert found.value[0] <= 1.02 * slsqp.value, seed


def test_curves_do_not_depend_on_the_worlds_origin():
    poses = recording(Contact.VF)
    again = curves(poses, 100, 50).minimum
    np.testing.assert_array_equal(curves(poses, 100, 50).minimum, again)
    moved = Poses(poses.stamp_ns, poses.position_m + np.array([100.0, -50.0, 7.0]), poses.quat_xyzw)
    np.testing.assert_allclose(curves(moved, 100, 50).minimum, again, rtol=1e-3)


def test_at_rest_every_contact_fits():
    """Without motion and noise the minima are finite and zero up to rounding."""
    moving = recording(Contact.VF)
    still = moving[np.zeros(80, int)]
    found = curves(Poses(moving.stamp_ns[:80], still.position_m, still.quat_xyzw), 50, 10)
    assert np.isfinite(found.minimum).all()
    assert (np.abs(found.minimum) < 1e-9).all()
    assert np.isfinite(found.normalised).all()


def test_long_recordings_in_pieces_give_the_same(monkeypatch):
    poses = recording(Contact.EF, Contact.VF)[:225]
    whole = curves(poses, 100, 25)
    monkeypatch.setattr("contact_tracker.paper.window_curves.CHUNK_FRAMES", 75)
    pieces = curves(poses, 100, 25)
    np.testing.assert_array_equal(pieces.stamp_ns, whole.stamp_ns)
    np.testing.assert_allclose(pieces.minimum, whole.minimum, rtol=0.05)
