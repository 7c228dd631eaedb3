"""Kinds of motion at a contact, by motions of known speed."""

from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.contacts.contact_motion import STICK_SLIP, ContactMotion, contact_motion, smooth_rates
from contact_tracker.geometry.elements import Array, ContactGeometry, Line, Plane, Point
from contact_tracker.tracking.offline_smoother import segment
from short_recordings import FACE_TO_EDGE, MODEL, recorded

TICKS: Final = 120
TIME_S: Final = np.arange(TICKS) * 0.1
SIGMA_M, SIGMA_RAD = 1e-4, 5e-4
CORNER_M: Final = np.array([0.05, 0.03, -0.04])
UP, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
START: Final = Rotation.from_rotvec([0.3, 0.2, 0.1])
STILL: Final = Rotation.concatenate([START] * TICKS)
SPEED, TURN = 0.02, 0.1  # m/s, rad/s
ON_BODY: Final = {
    name: START.inv().apply(axis) for name, axis in (("up", UP), ("x", ALONG), ("y", [0, 1, 0]))
}
GEOMETRY: Final = {
    "v-f": ContactGeometry(Point(CORNER_M, 1e-8 * np.eye(3)), Plane(UP, 0.0)),
    "e-f": ContactGeometry(Line(ON_BODY["x"], CORNER_M), Plane(UP, 0.0)),
    "f-v": ContactGeometry(Plane(ON_BODY["up"], 0.0), Point(np.zeros(3), 1e-8 * np.eye(3))),
    "f-e": ContactGeometry(Plane(ON_BODY["up"], 0.0), Line(ALONG, np.zeros(3))),
    "f-f": ContactGeometry(Plane(ON_BODY["up"], 0.0), Plane(UP, 0.0)),
    "e-e": ContactGeometry(Line(ON_BODY["y"], np.zeros(3)), Line(ALONG, np.zeros(3))),
}
WAYS: Final = {
    "rests": (0.0 * ALONG, None),
    "slides": (SPEED * ALONG, None),
    "rolls": (0.0 * ALONG, ALONG),
    "pivots": (0.0 * ALONG, UP),
}


def poses(contact: str, slip_m: Array, turns: Rotation) -> tuple[Rotation, Array]:
    """Poses whose touching point slips by (T, 3), while the object turns about it."""
    rotation = turns * START
    arm = CORNER_M if contact in ("v-f", "e-f") else np.zeros(3)
    return rotation, slip_m - rotation.apply(arm)


def measured(
    geometry: ContactGeometry, rotation: Rotation, position_m: Array, seed: int = 0, noise: float = 1.0
) -> ContactMotion:
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(noise * SIGMA_RAD * rng.normal(size=(TICKS, 3))) * rotation
    place = position_m + noise * SIGMA_M * rng.normal(size=(TICKS, 3))
    variance = noise**2 * np.tile([SIGMA_M**2, SIGMA_RAD**2], (TICKS, 1))
    stamps = np.arange(TICKS, dtype=np.int64) * 10**8
    motion = contact_motion(geometry, stamps, TIME_S, turned.as_quat(), place, variance)
    assert motion is not None
    return motion


def motion_of(contact: str, way: str) -> tuple[Rotation, Array]:
    """Poses without noise."""
    velocity, axis = WAYS[way]
    angle = np.outer(TURN * TIME_S, np.zeros(3) if axis is None else axis)
    return poses(contact, np.outer(TIME_S, velocity), Rotation.from_rotvec(angle))


def moving(contact: str, way: str, seed: int = 0) -> ContactMotion:
    return measured(GEOMETRY[contact], *motion_of(contact, way), seed)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("contact", GEOMETRY)
def test_the_kind_and_the_speed_are_those_of_the_motion(contact: str, way: str) -> None:
    if (contact, way) == ("f-f", "rolls"):
        pytest.skip("faces that touch cannot")
    result = moving(contact, way)
    assert result.kinds == (way,)
    speeds = {
        "slides": (result.speed_m_per_s, result.slip_sd_m_per_s, SPEED),
        "rolls": (result.roll_rad_per_s, result.turn_sd_rad_per_s, TURN),
        "pivots": (result.spin_rad_per_s, result.turn_sd_rad_per_s, TURN),
    }
    for name, (speed, sd, true) in speeds.items():
        np.testing.assert_array_less(np.abs(speed - (true if name == way else 0.0)), 5.0 * sd + 1e-3 * true)
    expected = {"v-f": (0, 1), "e-f": (0, 1), "f-f": (0, 1), "f-v": (1, 0), "f-e": (1, 0), "e-e": (0, 1)}
    if way == "slides":  # e-e along the surroundings' edge
        over = np.sqrt(np.mean(result.over_m_per_s**2, axis=0))
        np.testing.assert_allclose(over, SPEED * np.array(expected[contact]), atol=1e-4)


def test_two_edges_slide_over_each_of_both() -> None:
    slip = np.outer(TIME_S, [0.02, 0.03, 0.0])
    found = measured(GEOMETRY["e-e"], *poses("e-e", slip, STILL * START.inv()))
    np.testing.assert_allclose(np.median(found.over_m_per_s, axis=0), [0.03, 0.02], atol=1e-4)


@pytest.mark.parametrize(
    ("contact", "way"), [("v-f", "rests"), ("v-f", "rolls"), ("f-e", "rolls"), ("f-v", "pivots")]
)
def test_noise_alone_is_no_motion(contact: str, way: str) -> None:
    """The level is 1 % for each kind; two of 60 would be rare."""
    wrong = sum(moving(contact, way, seed).kinds != (way,) for seed in range(60))
    assert wrong <= 2


def test_slow_motion_is_found_where_the_noise_allows_it() -> None:
    """No speed is tuned: the same slip is significant at a tenth of the noise, not at ten times."""
    exact = poses("v-f", np.outer(np.sin(0.5 * TIME_S), [5e-4, 0.0, 0.0]), STILL * START.inv())
    kinds = [measured(GEOMETRY["v-f"], *exact, noise=noise).kinds for noise in (0.1, 10.0)]
    assert kinds == [("slides",), ("rests",)]


def test_sticking_between_slips_is_told_from_turning_round() -> None:
    jumps = 0.05 * (np.floor(TIME_S / 4.0) + np.clip(TIME_S % 4.0 - 3.0, 0.0, 1.0))
    still = STILL * START.inv()
    assert measured(GEOMETRY["v-f"], *poses("v-f", np.outer(jumps, ALONG), still)).kinds == (STICK_SLIP,)
    for per_s in (0.7, 1.5, 3.0):
        swings = np.outer(0.1 * np.sin(per_s * TIME_S), ALONG)
        assert measured(GEOMETRY["v-f"], *poses("v-f", swings, still)).kinds == ("slides",)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(sorted(GEOMETRY)), st.sampled_from(sorted(WAYS)), st.integers(0, 2**32 - 1))
def test_the_result_does_not_depend_on_the_frames(contact: str, way: str, seed: int) -> None:
    """The world may be anywhere, and the body's axes any; the origin of the body is the tracked point."""
    rng = np.random.default_rng(seed)
    turn, axes = Rotation.random(random_state=rng), Rotation.random(random_state=rng)
    shift_m, (rotation, position_m) = rng.normal(size=3), motion_of(contact, way)
    noisy = Rotation.from_rotvec(SIGMA_RAD * rng.normal(size=(TICKS, 3))) * rotation
    place = position_m + SIGMA_M * rng.normal(size=(TICKS, 3))
    variance, stamps = np.tile([SIGMA_M**2, SIGMA_RAD**2], (TICKS, 1)), np.arange(TICKS, dtype=np.int64)
    ours, theirs = GEOMETRY[contact].object, GEOMETRY[contact].environment
    moved = ContactGeometry(in_frame(ours, axes, np.zeros(3)), in_frame(theirs, turn, shift_m))
    here = contact_motion(GEOMETRY[contact], stamps, TIME_S, noisy.as_quat(), place, variance)
    there_turned, there = turn * noisy * axes.inv(), turn.apply(place) + shift_m
    other = contact_motion(moved, stamps, TIME_S, there_turned.as_quat(), there, variance)
    assert here.kinds == other.kinds  # and to what the search for the jerk's strength leaves
    slip_off = np.abs(turn.apply(here.slip_m_per_s) - other.slip_m_per_s)
    assert (slip_off < 0.2 * here.slip_sd_m_per_s[:, None]).all()
    for name in ("roll_rad_per_s", "spin_rad_per_s"):
        off = np.abs(getattr(here, name) - getattr(other, name))
        assert (off < 0.2 * here.turn_sd_rad_per_s).all()


def in_frame(element: Any, turn: Rotation, shift_m: Array) -> Any:
    match element:
        case Plane(normal, offset_m):
            return Plane(turn.apply(normal), float(offset_m + turn.apply(normal) @ shift_m))
        case Line(direction, point_m):
            return Line(turn.apply(direction), turn.apply(point_m) + shift_m)
        case Point(point_m, covariance):
            return Point(turn.apply(point_m) + shift_m, covariance)


def test_few_ticks_and_parallel_edges_say_nothing() -> None:
    variance = np.ones((TICKS, 2))
    stamps, quat_xyzw, place = np.arange(TICKS), STILL.as_quat(), np.zeros((TICKS, 3))
    parallel = ContactGeometry(Line(ON_BODY["x"], np.zeros(3)), Line(ALONG, np.zeros(3)))
    assert contact_motion(parallel, stamps, TIME_S, quat_xyzw, place, variance) is None
    few = (one[:3] for one in (stamps, TIME_S, quat_xyzw, place, variance))
    assert contact_motion(GEOMETRY["v-f"], *few) is None


def test_rates_are_as_far_off_as_their_deviations_say() -> None:
    rng = np.random.default_rng(0)
    for amplitude, frequency in ((0.0, 1.0), (0.02, 1.7), (0.3, 1.0)):
        off = []
        for _ in range(20):
            phase = rng.uniform(0, 2 * np.pi, 3)
            value = amplitude * np.sin(np.outer(TIME_S, np.full(3, frequency)) + phase)
            true = amplitude * frequency * np.cos(np.outer(TIME_S, np.full(3, frequency)) + phase)
            value += SIGMA_M * rng.normal(size=value.shape)
            rate, variance = smooth_rates(TIME_S, value, np.full(TICKS, SIGMA_M**2))
            off.append((rate - true) / np.sqrt(variance)[:, None])
        assert 0.4 < np.sqrt(np.mean(np.square(off))) < 1.2


def test_ticks_without_frames_are_no_motion_and_no_rest() -> None:
    """The pose of a tick in a gap is that of the last one: it would stick, and then jump."""
    poses = recorded(FACE_TO_EDGE).poses
    second = (poses.stamp_ns - poses.stamp_ns[0]) * 1e-9
    hidden = ((second > 1.0) & (second < 1.6)) | ((second > 2.2) & (second < 2.8))
    segmentation = segment(poses[~hidden], MODEL)
    assert any(one.motion for one in segmentation.segments)
    for one in segmentation.segments:
        if one.motion is not None:
            at = (one.motion.stamp_ns - poses.stamp_ns[0]) * 1e-9
            assert not (((at > 1.15) & (at < 1.55)) | ((at > 2.35) & (at < 2.75))).any()
            assert STICK_SLIP not in one.motion.kinds
