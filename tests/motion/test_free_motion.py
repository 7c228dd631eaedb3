"""Excess of free motion: zero at rest, small for predictable motion, else that of the motion."""

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.motion import free_motion
from smooth_motion import smooth

TICK_S, MEMORY_S = 0.1, 0.8
VARIANCES = np.array([0.5e-4**2, 0.5e-3**2])


def follow(position, turn):
    """States and excesses (N, 2) of variances over a motion (N, 3) and Rotation of N ticks."""
    rotation = turn.as_matrix()
    state, tick_ns = free_motion.begin(rotation[0], position[0], 0), round(TICK_S * 1e9)
    states, excess = [], []
    for i, (r, p) in enumerate(zip(rotation[1:], position[1:], strict=True), 1):
        state, surprise = free_motion.advance(
            state, r, p, VARIANCES, VARIANCES, i * tick_ns, TICK_S, MEMORY_S
        )
        states.append(state)
        excess.append(surprise)
    return states, np.array(excess)


def noisy(rng, position, turn):
    """Noisy measurements of a motion."""
    shape = position.shape
    off = Rotation.from_rotvec(rng.normal(size=shape) * np.sqrt(VARIANCES[1]))
    return position + rng.normal(size=shape) * np.sqrt(VARIANCES[0]), turn * off


def still(ticks):
    return np.tile([0.3, -2.0, 1.0], (ticks, 1)), Rotation.from_rotvec(np.tile([0.3, 1.0, -2.0], (ticks, 1)))


def by_hand(rng, ticks, bandwidth_hz=2.0):
    time_s = np.arange(ticks) * TICK_S
    turn = Rotation.from_rotvec(smooth(rng, time_s, 0.4, bandwidth_hz))
    return smooth(rng, time_s, 0.05, bandwidth_hz), turn


def test_rest_without_noise_has_exactly_zero_excess():
    """Tests for motion compare with exactly zero."""
    assert (follow(*still(50))[1] == 0.0).all()


def test_motion_that_stops_is_known_as_rest_soon():
    rng = np.random.default_rng(0)
    position, turn = by_hand(rng, 200)
    stopped = np.minimum(np.arange(200), 100)
    excess = follow(*noisy(rng, position[stopped], turn[stopped]))[1]
    assert (np.median(excess[60:100], axis=0) > 10.0 * np.array(VARIANCES)).all()
    assert np.mean(excess[110:] / VARIANCES < 1e-9) > 0.9


def uniform(rng):
    time_s = np.arange(200) * TICK_S
    motion = np.outer(time_s, [0.02, 0.01, -0.03]), Rotation.from_rotvec(np.outer(time_s, [0.5, -1.0, 0.3]))
    return follow(*noisy(rng, *motion))[1][100:] / VARIANCES


def test_uniform_motion_has_less_excess_than_noise_and_hand_motion_much_more():
    """It is as predictable as rest; with excess, straight transport would have evidence for contacts."""
    rng = np.random.default_rng(1)
    hand = follow(*noisy(rng, *by_hand(rng, 200)))[1][100:] / VARIANCES
    assert (np.median(hand, axis=0) > 5.0 * np.mean(uniform(rng), axis=0)).all()
    assert (np.mean(uniform(np.random.default_rng(1)), axis=0) < 1.0).all()


def test_spread_is_the_variance_that_cannot_be_predicted():
    """For white jerk: the mean error of the predictor, within a factor of two.

    The excess is the innovation in each tick: no larger, and not much smaller.
    """
    rng = np.random.default_rng(2)
    ticks, fine = 400, 20
    step = TICK_S / fine
    jerk = rng.normal(size=(ticks * fine, 3)) / np.sqrt(step)
    acceleration = np.cumsum(jerk, axis=0) * step
    rate = np.cumsum(acceleration, axis=0) * step
    signal = np.cumsum(rate, axis=0)[::fine] * step
    # the variance that one tick of white jerk adds, T^5 / 20, is the least error that any predictor makes
    least = TICK_S**5 / 20.0
    for scale in (0.5, 2.0):
        excess = follow(signal * scale, Rotation.identity(ticks))[1][50:, 0]
        states = follow(signal * scale, Rotation.identity(ticks))[0]
        ahead = [free_motion.predicted(s, np.array([TICK_S]))[0][0] for s in states[:-1]]
        actual = np.mean(np.square(np.array(ahead)[50:] - scale * signal[52:]))
        assert actual > 0.9 * scale**2 * least
        spread = np.exp(np.mean(np.log([s.spread[0] for s in states[50:]])))
        assert 0.5 < spread / actual < 2.0
        assert 0.1 < np.exp(np.mean(np.log(excess))) / actual < 1.2


def test_many_turns_are_one_motion():
    time_s = np.arange(150) * TICK_S
    spin = Rotation.from_rotvec(np.outer(time_s, [0.0, 0.0, 2.0]))
    excess = follow(*noisy(np.random.default_rng(3), np.zeros((150, 3)), spin))[1][40:]
    assert (excess[:, 1] < 100.0 * VARIANCES[1]).all()


def test_predictions_continue_the_motion():
    """At the last tick it is the filter's estimate; a tick ahead, the place of smooth motion."""
    rng = np.random.default_rng(4)
    position, turn = by_hand(rng, 80, bandwidth_hz=1.0)
    states, _ = follow(position, turn)
    ahead_s = np.array([0.0, 0.5 * TICK_S, TICK_S])
    for k in range(40, 79):
        state = states[k - 1]  # after ticks 0 .. k
        at, quat = free_motion.predicted(state, ahead_s)
        assert np.linalg.norm(at[0] - position[k]) < 1e-3
        assert np.linalg.norm(at[2] - position[k + 1]) < 0.02
        facing = Rotation.from_quat(quat)
        off = (facing.inv() * Rotation.concatenate([turn[k], turn[k], turn[k + 1]])).magnitude()
        assert off[0] < 0.01
        assert off[2] < 0.15
    assert np.linalg.norm(at[1] - 0.5 * (at[0] + at[2])) < 0.01


def test_a_jump_has_no_lasting_effect():
    """One jump of a metre must not count as motion forever."""
    rng = np.random.default_rng(6)
    position, turn = still(120)
    position[60:] += 1.0
    excess = follow(*noisy(rng, position, turn))[1]
    assert np.isfinite(excess).all()
    assert np.mean(excess[75:, 0] < 1e-9 * VARIANCES[0]) > 0.9
