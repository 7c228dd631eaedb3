"""Learned floors and searched parameters, on data and losses with a known result."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_motions import touching
from contact_tracker.config.loading import load_model
from contact_tracker.errors import UsageError
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.calibration.parameters import (
    EVALUATIONS,
    How,
    coordinate_search,
    select,
    value_of,
    with_value,
)
from contact_tracker_lab.calibration.residuals import (
    POSITION,
    ROTATION,
    SHORTEST_TICKS,
    Observed,
    fit_contact_segments,
    learn_contact_errors,
    learn_floors,
)

MODEL = load_model()
SENSOR_M, SENSOR_RAD = 0.05e-3, 0.4e-3


def with_floors(position_m, rotation_rad):
    noise = replace(MODEL.noise, floor_position_m=position_m, floor_rotation_rad=rotation_rad)
    return replace(MODEL, noise=noise)


def contact_segments(contact, floor_m, floor_rad, ticks=120, bounced=0.0, seed=0):
    """Segments of ticks of a true contact, with errors of the sensor's noise and the floors."""
    rng = np.random.default_rng(seed)
    true = touching(contact, rng, ticks)
    position = true.position_m - true.position_m[0]
    off_m, off_rad = np.hypot(SENSOR_M, floor_m), np.hypot(SENSOR_RAD, floor_rad)
    position = position + rng.normal(size=position.shape) * off_m
    position += 5e-3 * (rng.random((ticks, 1)) < bounced)
    turn = Rotation.from_rotvec(rng.normal(size=(ticks, 3)) * off_rad).as_matrix()
    window = Window(
        np.arange(ticks),
        lift(true.rotation @ turn, position),
        np.tile([SENSOR_M**2, SENSOR_RAD**2], (ticks, 1)),
        np.tile([0.02**2, 0.2**2], (ticks, 1)),
    )
    observed = Observed(np.arange(ticks), window, np.ones(ticks), SENSOR_M, SENSOR_RAD)
    return fit_contact_segments(observed, np.full(ticks, contact.column), MODEL)


@cache
def of_all_contacts(floor_m, floor_rad, **options):
    made = [contact_segments(c, floor_m, floor_rad, seed=s, **options) for c in CONTACTS for s in range(3)]
    return [segment for some in made for segment in some]


def floors_of(model, segments):
    learned, _ = learn_floors(model, segments, [POSITION, ROTATION])
    return learned.noise.floor_position_m, learned.noise.floor_rotation_rad


@pytest.mark.parametrize("bounced", [0.0, 0.01])
def test_floors_of_simulated_contacts_are_recovered(bounced):
    segments = of_all_contacts(0.2e-3, 1e-3, bounced=bounced)
    assert len(segments) == 18
    position, rotation = floors_of(MODEL, segments)
    assert position == pytest.approx(0.2e-3, rel=0.15 if bounced else 0.06)
    assert rotation == pytest.approx(1e-3, rel=0.15 if bounced else 0.06)


def test_a_floor_is_learned_alone_and_reported_by_contact():
    segments = of_all_contacts(0.2e-3, 0.0)
    model, learned = learn_floors(with_floors(1e-4, 1e-5), segments, [POSITION])
    assert model.noise.floor_rotation_rad == 1e-5
    assert [f.contacts for f in learned] == ["all", *CONTACTS]
    assert all(f.key == POSITION for f in learned)
    assert all(f.value == pytest.approx(0.2e-3, rel=0.2) for f in learned)


def test_an_error_of_one_contact_is_learned_for_it_alone():
    keys = ["noise.contact_position_m", "noise.contact_rotation_rad"]
    loose = [s for seed in range(3) for s in contact_segments(Contact.EF, 0.6e-3, 4e-3, seed=seed)]
    segments = loose + [s for s in of_all_contacts(0.05e-3, 0.5e-3) if s.column != Contact.EF.column]
    start = with_value(with_floors(0.05e-3, 0.5e-3), keys[0], (1e-3, *(0.0,) * 6))  # forgotten
    noise = learn_contact_errors(start, segments, keys).noise
    own = noise.contact_position_m[Contact.EF.column], noise.contact_rotation_rad[Contact.EF.column]
    assert own == pytest.approx((0.6e-3, 4e-3), rel=0.2)
    assert sum(noise.contact_position_m) == own[0]
    assert sum(noise.contact_rotation_rad) == own[1]
    # with it, the floor of all is that of the others
    position, rotation = floors_of(replace(MODEL, noise=noise), segments)
    assert (position, rotation) == pytest.approx((0.05e-3, 0.5e-3), rel=0.3)
    assert learn_contact_errors(start, loose[:0], keys).noise.contact_position_m == (0.0,) * 7


def test_too_few_residuals_leave_the_floor_unchanged():
    few = contact_segments(Contact.VF, 0.2e-3, 1e-3, ticks=40)
    for segments in ([], few):
        model, learned = learn_floors(MODEL, segments, [POSITION, ROTATION])
        assert model == MODEL
        assert all(f.value is None for f in learned)
    assert contact_segments(Contact.VF, 0.0, 0.0, ticks=SHORTEST_TICKS) == []


def test_a_search_finds_the_least_loss_along_each_parameter():
    wanted = {"motion.body_radius_m": 0.13, "geometry.reach_m": 0.55}
    asked = []

    def loss(model):
        asked.append(model)
        return 1.0 + sum(np.log(value_of(model, key) / value) ** 2 for key, value in wanted.items())

    model, learned = coordinate_search(MODEL, list(wanted), loss)
    for key, value in wanted.items():
        assert value_of(model, key) == pytest.approx(value, rel=0.2)
    expected = MODEL
    for key in wanted:
        expected = with_value(expected, key, value_of(model, key))
    assert model == expected
    assert len(asked) <= 1 + 2 * (EVALUATIONS + 1)
    assert learned[0].before == loss(MODEL)
    assert learned[0].after == learned[1].before
    assert learned[1].after == loss(model) < learned[1].before


def test_parameters_are_chosen_by_key_or_by_table():
    assert set(select([]).values()) == set(How) - {How.SEARCH, How.CONTACTS}
    keys = list(select(["transitions", "geometry.reach_m"]))
    assert keys == ["transitions.counts", "geometry.reach_m"]
    assert {key.partition(".")[0] for key in select(["noise", "motion"])} == {"noise", "motion"}
    for wrong in ("nose", "noise.", "noise.outlier_sigmas", "", "tick_s"):
        with pytest.raises(UsageError, match="is not learned"):
            select(["transitions", wrong])
