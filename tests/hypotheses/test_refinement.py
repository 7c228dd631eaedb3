"""Geometry reaches the Cramer-Rao bound, and its covariance is consistent."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.simulated_fits import NOISES, fit_simulated, fitted_geometry
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Plane
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.observability import MOST_TICKS, representatives
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.evaluation.bound import cramer_rao
from contact_tracker_lab.evaluation.geometry_errors import angle_rad, deviation
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import forward
from smooth_motion import exact_transfers, moving

SEEDS = 3
RARE = 1e-3
each_contact = pytest.mark.parametrize("contact", CONTACTS, ids=str)
each_side = pytest.mark.parametrize("side", [0, 1], ids=["object", "environment"])


@cache
def found(contact):
    return [fit_simulated(contact, NOISES["mocap"]._replace(seconds=6.0), seed) for seed in range(SEEDS)]


def normalised(contact, noise, seeds=SEEDS):
    """Squared deviations of elements per degree of freedom, in simulated intervals."""
    deviations = [d for seed in range(seeds) for d in fit_simulated(contact, noise, seed).deviation]
    return sum(d.squared for d in deviations) / sum(d.freedom for d in deviations)


@each_side
@each_contact
def test_errors_reach_the_bound_and_covariances_are_consistent_with_them(contact, side):
    """Squared errors relative to the bound are chi-squared; the tolerance is 1.3 times the bound."""
    errors, bounds = (np.array([getattr(f, key)[side] for f in found(contact)]) for key in ("error", "bound"))
    squared = np.einsum("ni,nij,nj->", errors, np.linalg.inv(bounds), errors)
    assert chi2.ppf(RARE, errors.size) < squared < 1.3**2 * chi2.ppf(1 - RARE, errors.size)
    deviations = [f.deviation[side] for f in found(contact)]
    low, high = chi2.ppf([RARE, 1 - RARE], sum(d.freedom for d in deviations))
    assert low < sum(d.squared for d in deviations) < high


def test_covariances_follow_the_residuals_where_the_model_expects_worse():
    """For a robot the model's floors are six times the noise of a tick, but absent in the data."""
    assert 0.4 < normalised(Contact.EF, NOISES["robot"]._replace(seconds=3.0)) < 2.5


@pytest.mark.long
@pytest.mark.parametrize("contact", [Contact.FV, Contact.EE], ids=str)
def test_covariances_include_correlated_errors(contact, monkeypatch):
    """The compliance of a contact, some hundredths of a millimetre, is correlated over many ticks. Errors
    that resemble geometry cannot be separated; but with independent errors in each tick the covariance would
    be too small."""
    gives = NOISES["robot"]._replace(rate_hz=200.0, seconds=5.0, compliance_m=30e-6, correlation_s=0.5)
    known = normalised(contact, gives)
    monkeypatch.setattr("contact_tracker.hypotheses.refinement.MOST_CORRELATION", 0.0)
    assert 0.5 < known < 2.5
    assert known < 0.6 * normalised(contact, gives)


@pytest.mark.long
@pytest.mark.parametrize("contact", [Contact.FF, Contact.EF, Contact.VF, Contact.EE], ids=str)
def test_covariances_are_consistent_where_the_model_knows_that_errors_wander(contact):
    """Errors of 0.5 mm and 0.15 deg that last for 2 s. A covariance that is far too large fails as well."""
    wanders = NOISES["mocap"]._replace(wander_m=0.5e-3, wander_deg=0.15)
    assert 0.4 < normalised(contact, wanders) < 2.5


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


@cache
def simulated(contact):
    scenario = Scenario((Phase(contact, 3.0),), sigma_position_m=0.0, sigma_rotation_rad=0.0)
    made = simulate(scenario, 4)
    return made.poses, made.truth.intervals[0].geometry


def bounds(contact, poses, sigma_m, sigma_rad):
    return cramer_rao(CONTACT_MODELS[contact.column], simulated(contact)[1], poses, (sigma_m, sigma_rad))


@each_contact
def test_a_very_short_contact_and_identical_poses_have_finite_elements(contact):
    measured = simulate(Scenario((Phase(contact, 1.0),)), 0)
    for frames in (1, 25):
        geometry = fitted_geometry(measured.poses[:frames], contact)
        for element in (geometry.object, geometry.environment):
            numbers = [np.ravel(v) for v in vars(element).values() if isinstance(v, np.ndarray)]
            assert np.isfinite(np.concatenate(numbers)).all()
    model, scales = CONTACT_MODELS[contact.column], scales_of(load_model())
    zeta = np.tile(lift(np.eye(3), np.zeros(3)), (20, 1))
    rest = Window(np.arange(20), zeta, np.tile([1e-9, 1e-8], (20, 1)), np.zeros((20, 2)))
    refined = refine(fit_window(model, rest, scales), model, rest, scales)
    assert np.isfinite(refined.bank.x).all()
    assert np.isfinite(refined.information).all()


@each_contact
def test_poses_without_noise_give_the_truth(contact):
    poses, true = simulated(contact)
    geometry = fitted_geometry(poses, contact)
    for found_, true_ in ((geometry.object, true.object), (geometry.environment, true.environment)):
        assert not angle_rad(found_, true_) > 1e-4


@pytest.mark.parametrize("contact", [Contact.VF, Contact.EE], ids=str)
def test_rest_of_any_duration_has_no_information(contact):
    poses = moving(np.random.default_rng(0), 8.0, 200.0, 3e-4, 3e-3, rms_m=0.0, rms_rad=0.0)
    geometry = fitted_geometry(poses, contact)
    for element in (geometry.object, geometry.environment):
        assert element.unobserved
        if isinstance(element, Plane):
            assert np.sqrt(np.trace(element.covariance[:3, :3])) > 0.3


# --- the covariance of elements includes the systematic errors of the poses, if these are given ---
BENT = NOISES["mocap"]._replace(seconds=5.0, systematic_m=0.5e-3, systematic_deg=0.1)
SHIPPED = load_model()


def with_errors(position_m, rotation_rad, length_m=0.1, angle_rad=0.5):
    known = SHIPPED.with_systematic_errors(position_m, rotation_rad)
    return replace(known, systematic=replace(known.systematic, length_m=length_m, angle_rad=angle_rad))


def noisy(contact):
    return simulate(Scenario((Phase(contact, 3.0),)), 4).poses


def covariances(poses, contact, model):
    geometry = fitted_geometry(poses, contact, model)
    return geometry.object.covariance, geometry.environment.covariance


def test_covariances_are_consistent_with_errors_that_depend_on_the_pose(monkeypatch):
    assert 0.3 < normalised(Contact.EF, BENT, seeds=2) < 3.0
    # without them the same errors are many deviations away
    monkeypatch.setattr(
        "contact_tracker.hypotheses.observability.systematic_covariance", lambda *_, **__: np.zeros(())
    )
    assert normalised(Contact.EF, BENT, seeds=2) > 4.0


@pytest.mark.parametrize("contact", [Contact.VF, Contact.FV], ids=str)
def test_the_same_error_in_all_places_shifts_the_surroundings_by_its_size(contact):
    poses, sigma_m = noisy(contact), 2e-3
    noise = covariances(poses, contact, SHIPPED)
    bent = covariances(poses, contact, with_errors(sigma_m, 0.0, length_m=1e3))
    added = bent[1] - noise[1]
    if contact is Contact.VF:
        assert added[3, 3] == pytest.approx(sigma_m**2, rel=0.01)  # the offset of a plane
        assert np.abs(added[:3, :3]).max() < 1e-8
    else:
        np.testing.assert_allclose(added, sigma_m**2 * np.eye(3), atol=0.01 * sigma_m**2)
    assert np.abs(bent[0] - noise[0]).max() < 0.01 * sigma_m**2


@each_contact
def test_errors_do_not_widen_the_prior(contact):
    """Of errors so large that the ticks say nothing, the prior is left: touching points within reach."""
    for covariance in covariances(noisy(contact), contact, with_errors(1.0, 1.0)):
        assert np.isfinite(covariance).all()
        assert np.sqrt(covariance.diagonal().max()) < 10.0 * SHIPPED.geometry.reach_m


@pytest.mark.parametrize("contact", [Contact.EF, Contact.FE], ids=str)
def test_what_exact_poses_do_not_show_is_as_wide_as_the_prior_with_errors_too(contact):
    """Turns about one axis leave the place along it open; errors of 10 mm and 0.6 deg do not open it more."""
    poses = exact_transfers(np.random.default_rng(3), 6.0, 200.0)
    turn = Rotation.from_quat(poses.quat_xyzw).as_rotvec() * [0.0, 0.0, 1.0]
    flat = Poses(poses.stamp_ns, poses.position_m, Rotation.from_rotvec(turn).as_quat())
    covariance, _ = covariances(flat, contact, with_errors(1e-2, 1e-2))
    sd_m = np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])  # of a line's point, or a plane's offset
    assert 0.9 < sd_m / SHIPPED.geometry.reach_m < 1.01


def test_ticks_that_represent_a_window_count_as_many_as_it_has():
    rng, ticks = np.random.default_rng(0), 1000
    excess = np.where(np.arange(ticks)[:, None] < 100, 1.0, 0.0) * np.ones(2)
    window = Window(np.arange(ticks), rng.normal(size=(ticks, 25)), np.ones((ticks, 2)), excess)
    some, count = representatives(window)
    assert count.sum() == ticks
    assert len(some) <= MOST_TICKS
    assert (some.index < 100).sum() > 50
    assert representatives(window.cut(0, 50))[0].index.tolist() == list(range(50))


def test_online_and_offline_deviations_agree():
    """Of one contact that lasts; online the fit weighs ticks by their motion."""
    poses = noisy(Contact.VF)
    model = with_errors(0.5e-3, 2e-3)
    *_, last = forward(poses, model)
    belief = last.belief
    assert belief.contact is Contact.VF
    offline = fitted_geometry(poses, Contact.VF, model)
    for online, found in (
        (belief.geometry.object, offline.object),
        (belief.geometry.environment, offline.environment),
    ):
        ratio = np.trace(online.covariance) / np.trace(found.covariance)
        assert 0.3 < ratio < 3.0
