"""The load is estimated from free motion, also if contact is partly misclassified as free."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.pressed_objects import CENTRE_M, MASS_KG, WEIGHT_N, Pressed, carried, pressed

from contact_tracker.segmenting import NoLoad, require_load
from contact_tracker.states import Contact
from contact_tracker.wrenches.load import Load, estimate_load
from contact_tracker.wrenches.wrenches import Wrenches, about_parent, average, reversed_wrenches


def load_of(made: Pressed, free: np.ndarray | None = None) -> Load | None:
    ticks = average(made.poses, made.wrenches.valid, made.tick_ns)
    is_free = made.is_free if free is None else free
    return estimate_load(ticks, is_free, is_free.astype(float))


@pytest.mark.parametrize("seed", range(3))
def test_weight_and_centre_of_mass_are_estimated(seed: int) -> None:
    load = load_of(pressed(Contact.VF, seed, noise=True, bias=True))
    sd = np.sqrt(np.diag(load.force_covariance))
    assert (np.abs(load.weight_n - WEIGHT_N) < 4 * sd[:3] + 0.1).all()
    assert (np.abs(load.centre_m - CENTRE_M) < 4 * np.sqrt(np.diag(load.moment_covariance))[:3] + 0.002).all()
    assert load.mass_kg == pytest.approx(MASS_KG, rel=0.05)


@pytest.mark.parametrize(
    ("runs", "contact", "seed", "is_noisy"),
    [
        # two runs of free motion, and a longer one of contact
        (((-60, -30), (-25, 0), (5, 50)), Contact.FV, 0, False),
        # as many ticks of contact: an estimate that starts at one of their forces ends at the few like it
        *(
            (((-55, -40), (5, 15), (30, 40)), contact, seed, True)
            for contact in (Contact.VF, Contact.FV, Contact.EF)
            for seed in (2, 3)
        ),
    ],
)
def test_contact_misclassified_as_free_is_an_outlier(
    runs: tuple[tuple[int, int], ...], contact: Contact, seed: int, is_noisy: bool
) -> None:
    """``runs`` of ticks from the touch on."""
    made = pressed(contact, seed, noise=is_noisy, bias=is_noisy)
    touch, free = int(np.flatnonzero(~made.is_free)[0]), np.zeros(len(made.tick_ns), bool)
    for first, end in runs:
        free[touch + first : touch + end] = True
    load = load_of(made, free)
    assert load is not None
    assert load.mass_kg == pytest.approx(MASS_KG, rel=0.02)
    np.testing.assert_allclose(load.weight_n, WEIGHT_N, atol=0.5)


def test_without_free_motion_there_is_no_load() -> None:
    made = pressed(Contact.FV)
    assert load_of(made, np.zeros(len(made.tick_ns), bool)) is None


def turned(made: Pressed, *by: float) -> Wrenches:
    """As of a sensor whose frame is turned by an unknown rotation vector (rad)."""
    rotation, wrenches = Rotation.from_rotvec(by), made.wrenches
    return Wrenches(wrenches.stamp_ns, rotation.apply(wrenches.force_n), rotation.apply(wrenches.moment_nm))


def with_moments(made: Pressed, moment_nm: np.ndarray) -> Wrenches:
    return replace(made.wrenches, moment_nm=moment_nm)


def in_axes_of_world(made: Pressed) -> Wrenches:
    about_world = about_parent(made.wrenches, made.poses)
    shift = np.cross(made.poses.position_m, about_world.force_n)
    return Wrenches(about_world.stamp_ns, about_world.force_n, about_world.moment_nm - shift)


@pytest.mark.parametrize(
    ("read", "expected"),
    [
        (lambda made: reversed_wrenches(made.wrenches), "They fit with the opposite sign"),
        (lambda made: about_parent(made.wrenches, made.poses), "They fit in the frame of the poses"),
        (in_axes_of_world, "They fit in the axes of the poses' frame, about the object's origin"),
        (lambda made: turned(made, 1.0, -1.5, 0.5), "Check their sign, their frame"),
        (lambda made: turned(made, 0.2, 0.1, 0.15), "axes were turned by 1[456] deg"),
        (
            lambda made: replace(made.wrenches, force_n=-made.wrenches.force_n),
            "opposite sign of the forces only",
        ),
        (
            lambda made: with_moments(made, -made.wrenches.moment_nm),
            "the moments are .* They fit with the opposite sign of the moments only",
        ),
        (
            lambda made: with_moments(made, made.wrenches.moment_nm * [1.0, 1.0, -1.0]),
            "moment of .* N m turns|inertia were negative. Check",
        ),
        (
            lambda made: with_moments(
                made, made.wrenches.moment_nm + np.cross([0.0, 0.1, 0.0], made.wrenches.force_n)
            ),
            "not about the object's origin",
        ),
    ],
)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_wrenches_of_a_wrong_sign_or_frame_are_not_used(seed: int, read: Any, expected: str) -> None:
    made = used(seed)
    with pytest.raises(NoLoad, match=expected) as raised:
        require_load(made.poses, read(made), made.tick_ns, made.is_free, made.is_free.astype(float))
    assert "free motion" in str(raised.value)


@cache
def used(seed: int) -> Pressed:
    """An object whose wrenches are used as they are."""
    made = pressed(Contact.VF, seed, noise=True, bias=True)
    require_load(made.poses, made.wrenches, made.tick_ns, made.is_free, made.is_free.astype(float))
    return made


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("turn_rad", "most_hz"), [(0.0, 0.5), (0.02, 1.8), (0.05, 1.8)])
def test_right_wrenches_are_used_where_the_object_hardly_turns(
    turn_rad: float, most_hz: float, seed: int
) -> None:
    made = carried(turn_rad, most_hz, seed)
    require_load(made.poses, made.wrenches, made.tick_ns, made.is_free, made.is_free.astype(float))


@pytest.mark.parametrize("noise_rad", [0.005, 0.05])
def test_noise_of_the_poses_is_no_wrong_frame(noise_rad: float) -> None:
    """It makes accelerations too large: the mass, the centre and the inertia that they show, too small."""
    made, rng = pressed(Contact.VF, 2, noise=True, bias=True), np.random.default_rng(0)
    noise = Rotation.from_rotvec(noise_rad * rng.normal(size=(len(made.poses), 3)))
    quat_xyzw = (Rotation.from_quat(made.poses.quat_xyzw) * noise).as_quat()
    load = load_of(replace(made, poses=replace(made.poses, quat_xyzw=quat_xyzw)))
    assert load.doubt == ""


def test_wrenches_that_explain_more_free_motion_otherwise_are_not_used() -> None:
    """Of the ticks that motion takes for free two in three are none, whose forces no reading explains."""
    made = pressed(Contact.VF, 5, noise=True, bias=True)
    is_free = made.is_free.copy()
    free, other = np.flatnonzero(is_free), np.flatnonzero(~is_free)
    is_free[free[int(0.3 * len(free)) :]], is_free[other[:40]] = False, True
    wrong = about_parent(made.wrenches, made.poses)
    with pytest.raises(NoLoad, match="They fit in the frame of the poses"):
        require_load(made.poses, wrong, made.tick_ns, is_free, is_free.astype(float))
