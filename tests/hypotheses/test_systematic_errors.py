"""The covariance of elements includes the systematic errors of the poses, if these are given."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.simulated_fits import NOISES, fit_simulated, fitted_geometry

from contact_tracker.config.loading import load_model
from contact_tracker.hypotheses.observability import MOST_TICKS, added_covariance, representatives
from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import forward

SEEDS = 3
BENT = NOISES["mocap"]._replace(seconds=5.0, systematic_m=0.5e-3, systematic_deg=0.1)
SHIPPED = load_model()
each_contact = pytest.mark.parametrize("contact", CONTACTS, ids=str)


def with_errors(position_m, rotation_rad, length_m=0.1, angle_rad=0.5):
    known = SHIPPED.with_systematic_errors(position_m, rotation_rad)
    return replace(known, systematic=replace(known.systematic, length_m=length_m, angle_rad=angle_rad))


def simulated(contact):
    return simulate(Scenario((Phase(contact, 3.0),)), 4).poses


def covariances(poses, contact, model):
    found = fitted_geometry(poses, contact, model)
    return found.object.covariance, found.environment.covariance


@pytest.mark.parametrize("contact", [Contact.EF, Contact.EE], ids=str)
def test_covariances_are_consistent_with_errors_that_depend_on_the_pose(contact, monkeypatch):
    def normalised():
        deviations = [d for seed in range(SEEDS) for d in fit_simulated(contact, BENT, seed).deviation]
        return sum(d.squared for d in deviations) / sum(d.freedom for d in deviations)

    assert 0.3 < normalised() < 3.0
    # without them the same errors are many deviations away
    monkeypatch.setattr(
        "contact_tracker.hypotheses.observability.systematic_covariance", lambda *_, **__: np.zeros(())
    )
    assert normalised() > 4.0


@pytest.mark.parametrize("contact", [Contact.VF, Contact.FV], ids=str)
def test_the_same_error_in_all_places_shifts_the_surroundings_by_its_size(contact):
    poses, sigma_m = simulated(contact), 2e-3
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
def test_covariances_grow_with_the_errors_squared(contact):
    poses = simulated(contact)
    noise, bent, twice = (
        covariances(poses, contact, with_errors(scale * 0.5e-3, scale * 2e-3)) for scale in (0.0, 1.0, 2.0)
    )
    for side in (0, 1):
        np.testing.assert_allclose(
            twice[side] - noise[side], 4.0 * (bent[side] - noise[side]), rtol=0.05, atol=1e-9
        )
        assert np.linalg.eigvalsh(bent[side] - noise[side])[0] > -1e-9


@each_contact
def test_errors_do_not_widen_the_prior(contact):
    """Of errors so large that the ticks say nothing, the prior is left: touching points within reach."""
    for covariance in covariances(simulated(contact), contact, with_errors(1.0, 1.0)):
        assert np.isfinite(covariance).all()
        assert np.sqrt(covariance.diagonal().max()) < 10.0 * SHIPPED.geometry.reach_m


def test_directions_without_information_and_huge_errors_are_no_fault():
    """Not even where errors are so large that rounding makes a sum singular."""
    errors = with_errors(1.0, 1.0).systematic
    zeta = np.tile(lift(np.eye(3), np.zeros(3)), (5, 1))
    by_error = np.zeros((6, 3, 5))
    by_error[:, 0] = 1e12
    information = np.diag([1e10, 1e-9, 0.0])
    added = added_covariance(information, np.diag([1.0, 1.0, 1e-4]), by_error, zeta, errors)
    assert np.isfinite(added).all()
    assert 0.5 < added[0, 0] < 1.1
    assert abs(added[2, 2]) < 1.0


def test_ticks_that_represent_a_window_count_as_many_as_it_has():
    rng, ticks = np.random.default_rng(0), 1000
    excess = np.where(np.arange(ticks)[:, None] < 100, 1.0, 0.0) * np.ones(2)
    window = Window(np.arange(ticks), rng.normal(size=(ticks, 25)), np.ones((ticks, 2)), excess)
    some, count = representatives(window)
    assert count.sum() == ticks
    assert len(some) <= MOST_TICKS
    assert (some.index < 100).sum() > 50
    assert representatives(window.cut(0, 50)).window.index.tolist() == list(range(50))


def test_online_and_offline_deviations_agree():
    """Of one contact that lasts; online the fit weighs ticks by their motion."""
    poses = simulated(Contact.VF)
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
