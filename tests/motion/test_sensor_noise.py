"""The estimated sensor noise equals the simulated noise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.motion import sensor_noise
from contact_tracker.motion.poses import Poses
from smooth_motion import moving

# rate, sigma of position and rotation, seconds: as a camera, motion capture and a robot have them
SENSORS = [(30.0, 1.5e-3, 0.012, 60.0), (200.0, 3e-4, 2.6e-3, 10.0), (1000.0, 5e-5, 3.5e-4, 3.0)]
each_sensor = pytest.mark.parametrize(
    ("rate_hz", "sigma_m", "sigma_rad", "seconds"), SENSORS, ids=["30 Hz", "200 Hz", "1 kHz"]
)


def estimates(poses, tick, prior):
    """The number of frames and the noise estimate after each ``tick`` frames of the stream."""
    state, estimate = sensor_noise.EMPTY_BUFFER, sensor_noise.begin(*prior)
    for first in range(0, len(poses), tick):
        state, estimate = sensor_noise.advance(state, estimate, poses[first : first + tick], prior)
        yield state, estimate


def streamed(poses, tick, prior):
    return (estimate for _, estimate in estimates(poses, tick, prior))


@each_sensor
def test_noise_of_a_moving_object(rate_hz, sigma_m, sigma_rad, seconds):
    poses = moving(np.random.default_rng(1), seconds, rate_hz, sigma_m, sigma_rad)
    assert sensor_noise.estimate_noise(poses) == pytest.approx((sigma_m, sigma_rad), rel=0.1)


@each_sensor
@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_the_stream_corrects_a_wrong_model(rate_hz, sigma_m, sigma_rad, seconds, factor):
    """Within a second or two from a prior with the wrong size, and permanently."""
    poses = moving(np.random.default_rng(2), seconds, rate_hz, sigma_m, sigma_rad)
    prior = (factor * sigma_m, factor * sigma_rad)
    estimates = list(streamed(poses, max(1, round(rate_hz / 10.0)), prior))
    assert estimates[0].sigma_position_m != sigma_m
    for estimate in estimates[20 if rate_hz > 100.0 else 60 :]:
        assert estimate.sigma_position_m == pytest.approx(sigma_m, rel=0.25)
        assert estimate.sigma_rotation_rad == pytest.approx(sigma_rad, rel=0.25)
    assert estimates[-1].sigma_position_m == pytest.approx(sigma_m, rel=0.1)
    assert estimates[-1].sigma_rotation_rad == pytest.approx(sigma_rad, rel=0.1)


@pytest.mark.parametrize("tick", [1, 3, 20])
def test_long_repeats_of_a_pose_do_not_reduce_the_noise(tick):
    poses = moving(np.random.default_rng(4), 60.0, 20.0, 3e-4, 2e-3)
    source = np.arange(len(poses)) // 10 * 10
    held = Poses(poses.stamp_ns, poses.position_m[source], poses.quat_xyzw[source])
    *_, estimate = streamed(held, tick, (3e-4, 2e-3))
    assert estimate.sigma_position_m > 1e-4
    assert estimate.sigma_rotation_rad > 1e-3


def test_an_object_that_turns_in_place_is_not_held():
    poses = moving(np.random.default_rng(3), 10.0, 200.0, 0.0, 2e-3, rms_m=0.0)
    assert (np.ptp(poses.position_m, axis=0) == 0.0).all()
    assert sensor_noise.estimate_noise(poses) == pytest.approx((0.0, 2e-3), rel=0.1)


def test_held_poses_and_gaps_are_left_out():
    rng = np.random.default_rng(6)
    poses = moving(rng, 40.0, 200.0, 3e-4, 2e-3)
    kept = (rng.random(len(poses)) > 0.1) & (np.arange(len(poses)) % 900 > 300)  # drops, and gaps of 1.5 s
    assert sensor_noise.estimate_noise(poses[kept]) == pytest.approx((3e-4, 2e-3), rel=0.1)
    source = np.maximum.accumulate(np.where(rng.random(len(poses)) > 0.15, np.arange(len(poses)), 0))
    held = Poses(poses.stamp_ns, poses.position_m[source], poses.quat_xyzw[source])
    assert sensor_noise.estimate_noise(held) == pytest.approx((3e-4, 2e-3), rel=0.1)


def last(poses, prior=(5e-4, 4e-3)):
    *_, estimate = streamed(poses, 20, prior)
    return estimate


def test_each_axis_has_its_noise():
    """Position in the world's axes, orientation in the body's, for any motion of the object."""
    sigma_m, sigma_rad = np.array([2e-4, 2e-4, 1e-3]), np.array([4e-3, 1e-3, 1e-3])
    poses = moving(np.random.default_rng(11), 30.0, 100.0, sigma_m, sigma_rad, rms_rad=1.0)
    estimate, mean_square = last(poses), [np.sqrt(np.mean(sigma**2)) for sigma in (sigma_m, sigma_rad)]
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.position_m2)), sigma_m, rtol=0.2)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.rotation_rad2)), sigma_rad, rtol=0.2)
    cross = estimate.position_m2 / np.sqrt(np.outer(*2 * [np.diag(estimate.position_m2)]))
    assert np.abs(cross - np.eye(3)).max() < 0.15
    assert estimate.sigma_position_m == pytest.approx(mean_square[0], rel=0.1)
    assert sensor_noise.estimate_noise(poses) == pytest.approx(mean_square, rel=0.1)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_frames_have_no_estimate(count):
    poses = moving(np.random.default_rng(9), 1.0, 30.0, 1e-3, 1e-3)[:count]
    assert np.isnan(sensor_noise.estimate_noise(poses)).all()
    _, estimate = sensor_noise.advance(
        sensor_noise.EMPTY_BUFFER, sensor_noise.begin(1e-3, 2e-3), poses, (1e-3, 2e-3)
    )
    assert (estimate.sigma_position_m, estimate.sigma_rotation_rad) == (1e-3, 2e-3)


@pytest.mark.parametrize("rest", [0, 600])
def test_motion_without_noise_has_noise_above_zero(rest):
    """For poses of simulators, as there are divisions by variances. At rest all poses are repeated."""
    poses = moving(np.random.default_rng(10), 8.0, 200.0)
    row = np.maximum(np.arange(len(poses)) - rest, 0)
    poses = Poses(poses.stamp_ns, poses.position_m[row], poses.quat_xyzw[row])
    estimates = list(streamed(poses, 20, (1e-3, 2e-3)))
    for estimate in estimates[: rest // 20]:
        assert (estimate.sigma_position_m, estimate.sigma_rotation_rad) == (1e-3, 2e-3)
    assert 0.0 < estimates[-1].sigma_position_m < 1e-4
    assert 0.0 < estimates[-1].sigma_rotation_rad < 2e-4


@pytest.mark.parametrize("count", [20, 60, 100])
def test_the_origin_is_tracked_where_orientations_have_rounding_errors_alone(count):
    """As in a simulation of a steady turn: a point was found 10^9 m away."""
    time_s = np.arange(count) / 200.0
    turns = Rotation.from_rotvec(0.6 * time_s[:, None] * [1.0, 0.0, 0.0])
    position_m = 0.1 * np.stack([np.sin(time_s), np.cos(2.0 * time_s), 0.1 * time_s], axis=1)
    poses = Poses((time_s * 1e9).astype(np.int64), position_m, turns.as_quat())
    assert not sensor_noise.independent_point(poses).any()
