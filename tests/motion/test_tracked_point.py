"""The tracked point, and that results do not depend on where the body's origin is."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import contact_tracker as ct
from contact_tracker.geometry.elements import shifted
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.tracking.filter_bank import RATIO_POSES
from short_recordings import FACE_TO_EDGE, recorded
from smooth_motion import exact_transfers

Array = NDArray[np.float64]
POSITION_M, ROTATION_RAD, COUNT = 3e-4, 3e-3, 400


def noisy_poses(point_m: Array, rng: np.random.Generator) -> Poses:
    """Poses of a body whose point ``point_m`` has noise that is independent of the orientation's."""
    t = np.arange(COUNT) / 100.0
    angles = np.array([0.7 * np.sin(2.0 * t), 0.5 * np.cos(1.3 * t), 0.3 * t]).T
    error = Rotation.from_rotvec(rng.normal(scale=ROTATION_RAD, size=(COUNT, 3)))
    turn = Rotation.from_rotvec(angles) * error
    place_m = np.array([0.3 * np.sin(t), 0.2 * t, 0.1 * np.cos(3.0 * t)]).T
    position_m = place_m + rng.normal(scale=POSITION_M, size=(COUNT, 3)) - turn.apply(point_m)
    return Poses((1e7 * np.arange(COUNT)).astype(np.int64), position_m, turn.as_quat())


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.3, 10.0]))
def test_the_point_is_found_wherever_the_origin_is(seed: int, away_m: float) -> None:
    rng = np.random.default_rng(seed)
    point_m = away_m * Rotation.random(random_state=rng).as_matrix()[0]
    point = independent_point(noisy_poses(point_m, rng))
    np.testing.assert_allclose(point, point_m, atol=8.0 * POSITION_M / ROTATION_RAD / np.sqrt(COUNT))


@given(st.integers(0, 2**32 - 1))
def test_a_far_origin_is_found_by_the_first_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    point_m = 10.0 * Rotation.random(random_state=rng).as_matrix()[0]
    point = independent_point(noisy_poses(point_m, rng)[:RATIO_POSES])
    np.testing.assert_allclose(point, point_m, atol=0.2)


def test_it_is_the_origin_where_no_noise_shows_another() -> None:
    rng = np.random.default_rng(1)
    zero = [independent_point(noisy_poses(np.zeros(3), rng)) for _ in range(20)]
    assert np.mean([not one.any() for one in zero]) > 0.9
    clean = noisy_poses(np.array([0.5, 0.0, 0.0]), rng)
    same = Poses(clean.stamp_ns, np.ones((COUNT, 3)), np.tile(clean.quat_xyzw[0], (COUNT, 1)))
    for few in (NO_POSES, clean[:6], same):
        np.testing.assert_array_equal(independent_point(few), 0.0)


@pytest.fixture(scope="module")
def expected() -> ct.Result:
    return ct.segment(ct.Trajectory(recorded(FACE_TO_EDGE).poses))


@pytest.mark.parametrize("away_m", [pytest.param(0.3, marks=pytest.mark.long), 10.0])
def test_elements_are_in_the_users_body_frame(expected: ct.Result, away_m: float) -> None:
    """With another origin of the body the labels stay, and its elements move by as much."""
    aside = away_m * np.array([0.6, -0.48, 0.64])
    poses = recorded(FACE_TO_EDGE).poses.of_point(aside)
    result = ct.segment(ct.Trajectory(poses))
    assert [one.contact for one in result.segments] == [one.contact for one in expected.segments]
    same = result.beliefs.rows["contact"] == expected.beliefs.rows["contact"]
    assert same.mean() > 0.99
    faces, again = (one.segments[0].geometry for one in (expected, result))
    at_m = recorded(FACE_TO_EDGE).poses.position_m.mean(axis=0)
    heights_m = [pair.environment.normal @ at_m - pair.environment.offset_m for pair in (faces, again)]
    assert heights_m[0] == pytest.approx(heights_m[1], abs=0.001)
    moved = shifted(faces.object, -aside)
    assert again.object.offset_m == pytest.approx(moved.offset_m, abs=0.004)  # of 10 m, with 2.4 mm
    before, after = (one.segments[-1].geometry for one in (expected, result))
    edge = shifted(before.object, -aside)
    off = after.object.point_m - edge.point_m
    assert np.linalg.norm(off - edge.direction * (edge.direction @ off)) < 0.004
    assert abs(before.environment.normal @ after.environment.normal) > np.cos(np.radians(1.0))


def test_online_it_is_found_within_the_first_poses() -> None:
    """Also where elements of the object are given, which are in the user's body frame."""
    aside = np.array([0.5, -0.4, 0.3])
    truth = recorded(FACE_TO_EDGE).truth.intervals[-1].geometry
    labels = list[list[str]]()
    for away_m in (np.zeros(3), aside):
        edge = shifted(truth.object, -away_m)
        line = {"point_m": edge.point_m.tolist(), "direction": edge.direction.tolist()}
        tracker = ct.Tracker(known={"object": {"line": [line]}})
        poses = recorded(FACE_TO_EDGE).poses[300:1300:2].of_point(away_m)
        beliefs = [tracker.update(*pose) for pose in poses]
        known_ticks = [one for one in beliefs if one is not None]
        labels.append([one.contact.value for one in known_ticks])
        assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(known_ticks))
        last = known_ticks[-1]
        assert last.geometry.object.name == "line 1"
    assert np.mean([a == b for a, b in zip(*labels, strict=True)]) > 0.95


def test_poses_without_noise_have_no_point_far_away():
    poses = exact_transfers(np.random.default_rng(0), 20, 125.0)
    assert np.linalg.norm(independent_point(poses[:200])) < 100.0


def test_jerks_of_motion_without_noise_are_no_noise() -> None:
    """They are where the acceleration changes, of poses whose differences are those of rounding otherwise."""
    time_s = np.arange(400) / 125.0
    share = np.clip(time_s - 1.0, 0.0, 1.0)
    turn = np.where(share < 0.5, 2.0 * share**2, 1.0 - 2.0 * (1.0 - share) ** 2)
    turns = Rotation.from_rotvec(np.outer(turn, [0.0, 0.0, 0.6]))
    position_m = np.outer(turn, [0.3, 0.1, 0.0]) + 1e-5 * np.sin(3.0 * time_s)[:, None]
    poses = Poses(np.rint(1e9 * time_s).astype(np.int64), position_m, turns.as_quat())
    np.testing.assert_array_equal(independent_point(poses), 0.0)


def test_turns_about_one_axis_leave_no_point_far_along_it() -> None:
    """A machine led by hand turns about one axis: along it the centre of the errors was 25000 km away."""
    time_s = np.arange(800) / 250.0
    turns = Rotation.from_rotvec(np.outer(np.sin(2.0 * time_s), [0.48, -0.64, 0.6]))
    position_m = turns.apply([0.3, 0.1, -0.2])
    poses = Poses(np.rint(1e9 * time_s).astype(np.int64), position_m, turns.as_quat())
    assert np.linalg.norm(independent_point(poses)) < 1.0
