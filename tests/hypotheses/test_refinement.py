"""Geometry reaches the Cramer-Rao bound, and its covariance is consistent."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.simulated_fits import NOISES, fit_simulated, fitted_geometry
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import chi2

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Plane
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.refinement import (
    FIRST_CORRELATION,
    Ar1Noise,
    estimate_ar1,
    refine,
    whiten_ar1,
)
from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.evaluation.bound import cramer_rao
from contact_tracker_lab.evaluation.geometry_errors import angle_rad, deviation
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from smooth_motion import moving

SEEDS = 6
RARE = 1e-3
each_contact = pytest.mark.parametrize("contact", CONTACTS, ids=str)
each_side = pytest.mark.parametrize("side", [0, 1], ids=["object", "environment"])


@cache
def found(contact):
    return [fit_simulated(contact, NOISES["mocap"]._replace(seconds=6.0), seed) for seed in range(SEEDS)]


@each_side
@each_contact
def test_errors_reach_the_bound_and_do_not_pass_it(contact, side):
    """Squared errors relative to the bound are chi-squared; the tolerance is 1.3 times the bound."""
    errors, bounds = (np.array([getattr(f, key)[side] for f in found(contact)]) for key in ("error", "bound"))
    squared = np.einsum("ni,nij,nj->", errors, np.linalg.inv(bounds), errors)
    assert chi2.ppf(RARE, errors.size) < squared < 1.3**2 * chi2.ppf(1 - RARE, errors.size)


@each_side
@each_contact
def test_covariances_are_consistent_with_the_errors(contact, side):
    deviations = [f.deviation[side] for f in found(contact)]
    freedom = sum(d.freedom for d in deviations)
    low, high = chi2.ppf([RARE, 1 - RARE], freedom)
    assert low < sum(d.squared for d in deviations) < high


def test_covariances_follow_the_residuals_where_the_model_expects_worse():
    """For a robot the model's floors are six times the noise of a tick, but absent in the data."""
    noise = NOISES["robot"]._replace(seconds=3.0)
    deviations = [d for seed in range(6) for d in fit_simulated(Contact.EF, noise, seed).deviation]
    assert 0.4 < np.mean([d.squared / d.freedom for d in deviations]) < 2.5


@pytest.mark.long
@pytest.mark.parametrize("contact", [Contact.FV, Contact.EE], ids=str)
def test_covariances_include_correlated_errors(contact, monkeypatch):
    """The compliance of a contact, some hundredths of a millimetre, is correlated over many ticks. Errors
    that resemble geometry cannot be separated; but with independent errors in each tick the covariance would
    be too small."""
    gives = NOISES["robot"]._replace(rate_hz=200.0, seconds=5.0, compliance_m=30e-6, correlation_s=0.5)

    def normalised():
        deviations = [d for seed in range(SEEDS) for d in fit_simulated(contact, gives, seed).deviation]
        return sum(d.squared for d in deviations) / sum(d.freedom for d in deviations)

    known = normalised()
    monkeypatch.setattr("contact_tracker.hypotheses.refinement.MOST_CORRELATION", 0.0)
    assert 0.5 < known < 2.5
    assert known < 0.6 * normalised()


@pytest.mark.long
@pytest.mark.parametrize("contact", [Contact.FF, Contact.EF, Contact.VF, Contact.EE], ids=str)
def test_covariances_are_consistent_where_the_model_knows_that_errors_wander(contact):
    """Errors of 0.5 mm and 0.15 deg that last for 2 s. A covariance that is far too large fails as well."""
    wanders = NOISES["mocap"]._replace(wander_m=0.5e-3, wander_deg=0.15)
    deviations = [d for seed in range(SEEDS) for d in fit_simulated(contact, wanders, seed).deviation]
    assert 0.4 < sum(d.squared for d in deviations) / sum(d.freedom for d in deviations) < 2.5


@given(st.integers(0, 10_000), st.floats(0.0, 0.7))
@example(seed=138, correlation=0.6875).via("squares of other ticks than those of the products had it at 0.92")
def test_size_and_correlation_of_errors_are_estimated_from_residuals(seed, correlation):
    """Of residuals, before and after the fit of a line and a wave."""
    rng, count = np.random.default_rng(seed), 400
    index = np.cumsum(rng.integers(1, 3, count))
    new = rng.normal(size=(1, count))
    errors = new.copy()
    for tick in range(1, count):
        left = correlation ** (index[tick] - index[tick - 1])
        errors[:, tick] = left * errors[:, tick - 1] + np.sqrt(1.0 - left**2) * new[:, tick]
    np.testing.assert_allclose(whiten_ar1(errors, np.full(1, correlation), index), new, atol=1e-9)
    shapes = np.stack([np.ones(count), index / 400.0, np.sin(index / 5.0), np.cos(index / 5.0)], axis=1)
    left_over = errors - (shapes @ np.linalg.lstsq(shapes, errors.T, rcond=None)[0]).T
    start = Ar1Noise(np.ones(1), np.full(1, FIRST_CORRELATION))
    for residuals, fitted in ((errors, 0.0 * shapes), (left_over, shapes)):
        found = estimate_ar1(start, 2.0 * residuals, fitted[None], np.zeros((4, 4)), index)
        assert abs(found.correlation - correlation) < 0.3
        assert 0.5 < 4.0 * found.weight < 2.0


def test_frames_of_the_previous_contact_do_not_bias_the_geometry():
    """A contact begins within the first tick of its segment, here with a landing at 8 cm/s."""
    made = simulate(Scenario((Phase(Contact.VF, 5.0),)), 3)
    true = made.truth.intervals[0].geometry
    height_m = 0.08 * np.maximum(12.0 - np.arange(len(made.poses)), 0.0) / 200.0
    position_m = made.poses.position_m + height_m[:, None] * true.environment.normal
    alone, early = (
        fitted_geometry(poses, Contact.VF)
        for poses in (made.poses, replace(made.poses, position_m=position_m))
    )
    assert np.linalg.norm(early.object.point_m - alone.object.point_m) < 0.0005
    assert deviation(early.object, true.object, np.zeros(3)).sd < 3.0


# --- the bound itself --------------------------------------------------------------------------------------


@cache
def simulated(contact):
    scenario = Scenario((Phase(contact, 3.0),), sigma_position_m=0.0, sigma_rotation_rad=0.0)
    made = simulate(scenario, 4)
    return made.poses, made.truth.intervals[0].geometry


def bounds(contact, poses, sigma_m, sigma_rad):
    return cramer_rao(CONTACT_MODELS[contact.column], simulated(contact)[1], poses, sigma_m, sigma_rad)


def test_the_height_of_a_face_is_known_as_well_as_a_mean():
    """For f-f: errors of angles turn the face about the body's mean position."""
    poses, _ = simulated(Contact.FF)
    of_environment = bounds(Contact.FF, poses, 1e-3, 1e-2)[1]
    assert np.sqrt(of_environment[2, 2]) == pytest.approx(1e-3 / np.sqrt(len(poses)), rel=1e-3)


@each_contact
def test_the_bound_grows_with_noise_and_shrinks_with_frames(contact):
    poses, _ = simulated(contact)
    usual = bounds(contact, poses, 1e-3, 1e-2)
    louder = bounds(contact, poses, 2e-3, 2e-2)
    # every frame twice
    longer = bounds(contact, poses[np.repeat(np.arange(len(poses)), 2)], 1e-3, 1e-2)
    for a, b, c in zip(usual, louder, longer, strict=True):
        np.testing.assert_allclose(b, 4.0 * a, rtol=1e-4, atol=1e-7 * a.max())
        np.testing.assert_allclose(c, 0.5 * a, rtol=1e-4, atol=1e-7 * a.max())


# --- little to go by ---------------------------------------------------------------------------------------


@each_contact
@pytest.mark.parametrize("frames", [1, 3, 25, 61])
def test_a_very_short_contact_has_finite_elements(contact, frames):
    measured = simulate(Scenario((Phase(contact, 1.0),)), 0)
    geometry = fitted_geometry(measured.poses[:frames], contact)
    for element in (geometry.object, geometry.environment):
        numbers = [np.ravel(v) for v in vars(element).values() if isinstance(v, np.ndarray)]
        assert np.isfinite(np.concatenate(numbers)).all()


@each_contact
def test_poses_without_noise_give_the_truth(contact):
    poses, true = simulated(contact)
    geometry = fitted_geometry(poses, contact)
    for found_, true_ in ((geometry.object, true.object), (geometry.environment, true.environment)):
        assert not angle_rad(found_, true_) > 1e-4


@pytest.mark.parametrize("contact", [Contact.EF, Contact.VF, Contact.FV, Contact.EE], ids=str)
def test_rest_of_any_duration_has_no_information(contact):
    poses = moving(np.random.default_rng(0), 8.0, 200.0, 3e-4, 3e-3, rms_m=0.0, rms_rad=0.0)
    geometry = fitted_geometry(poses, contact)
    for element in (geometry.object, geometry.environment):
        assert element.unobserved
        if isinstance(element, Plane):
            assert np.sqrt(np.trace(element.covariance[:3, :3])) > 0.3


@each_contact
def test_identical_poses_have_finite_geometry(contact):
    model, count = CONTACT_MODELS[contact.column], 20
    scales = scales_of(load_model())
    zeta = np.tile(lift(np.eye(3), np.zeros(3)), (count, 1))
    rest = Window(np.arange(count), zeta, np.tile([1e-9, 1e-8], (count, 1)), np.zeros((count, 2)))
    refined = refine(fit_window(model, rest, scales), model, rest, scales)
    assert np.isfinite(refined.bank.x).all()
    assert np.isfinite(refined.information).all()
