"""Ticks: exact averages of valid frames, on a grid that is robust to the stream."""

from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Origins
from contact_tracker.geometry.lifted_pose import ONE, T, lift
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.losses import counts_text
from contact_tracker.motion.poses import Outliers, Poses
from contact_tracker.motion.tick_averaging import TickGrid, tick_variances, with_excess
from smooth_motion import START_NS, exact_transfers, least_jerk, moving

MODEL = load_model()
TICK_NS = MODEL.tick_ns
seeds = st.integers(0, 2**32 - 1)


def averaged(poses, model=MODEL, batch=None):
    """All ticks of a stream that comes in batches."""
    grid, closed = TickGrid(model), []
    for first in range(0, len(poses), batch or len(poses)):
        closed += grid.add(poses[first : first + (batch or len(poses))])
    return [*closed, *grid.close()]


def spiked(rng, poses, share, size_m=0.05):
    """The poses with some of them displaced by ``size_m``, and their mask."""
    wrong = rng.random(len(poses)) < share
    direction = rng.normal(size=(len(poses), 3))
    direction *= size_m / np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(poses, position_m=poses.position_m + np.where(wrong[:, None], direction, 0.0)), wrong


@settings(max_examples=10, deadline=None)
@given(
    seed=seeds, batch=st.sampled_from([1, 7, 20, 333]), rate_hz=st.sampled_from([8.0, 30.0, 200.0, 1000.0])
)
def test_ticks_do_not_depend_on_how_poses_are_batched(seed, batch, rate_hz):
    """Bit-identical for single poses and chunks of a log, with outliers, held poses, drops and gaps."""
    rng = np.random.default_rng(seed)
    poses, _ = spiked(rng, moving(rng, 400 / rate_hz, rate_hz, 3e-4, 2e-3), 0.02)
    source = np.maximum.accumulate(np.where(rng.random(len(poses)) > 0.1, np.arange(len(poses)), 0))
    late = rng.choice([0, 10**9, 10**10], p=[0.996, 0.002, 0.002], size=len(poses)).cumsum()
    poses = Poses(poses.stamp_ns + late, poses.position_m[source], poses.quat_xyzw[source])
    poses = poses[np.flatnonzero(rng.random(len(poses)) > 0.1)]
    whole, portions = averaged(poses), averaged(poses, batch=batch)
    assert sum(tick.count + tick.outliers.total for tick in whole) > 0.7 * len(poses)
    for a, b in zip(whole, portions, strict=True):
        assert (a.start_ns, a.stamp_ns, a.count, a.outliers) == (b.start_ns, b.stamp_ns, b.count, b.outliers)
        assert a.innovation_excess == b.innovation_excess
        np.testing.assert_array_equal(a.zeta, b.zeta)


@settings(max_examples=5, deadline=None)
@given(seed=seeds, batch=st.sampled_from([7, 20, 333]), rate_hz=st.sampled_from([30.0, 200.0]))
def test_a_follower_with_the_same_noise_shares_the_leaders_ticks(seed, batch, rate_hz):
    """Bit-identical, with outliers, gaps, and a stream that continues after an end within a tick."""
    rng = np.random.default_rng(seed)
    poses, _ = spiked(rng, moving(rng, 600 / rate_hz, rate_hz, 3e-4, 2e-3), 0.02)
    late = rng.choice([0, 10**9, 10**10], p=[0.996, 0.002, 0.002], size=len(poses)).cumsum()
    poses = replace(poses, stamp_ns=poses.stamp_ns + late)
    grid, motion = TickGrid(MODEL), None
    ended = int(rng.integers(len(poses)))
    for first in range(0, len(poses), batch):
        closed = grid.add(poses[first : first + batch])
        closed += grid.close() if first <= ended < first + batch else []
        for expected in closed:
            motion, own = with_excess(motion, replace(expected, innovation_excess=NO_EXCESS), MODEL)
            assert own.innovation_excess == expected.innovation_excess
    assert (motion is None) == (grid.stream.free_motion is None)


def test_a_follower_with_other_noise_computes_its_own_innovations():
    """With white noise and without outliers: as from its own average of the frames."""
    poses = moving(np.random.default_rng(2), 20.0, 200.0, 3e-4, 2e-3)
    noisier = replace(MODEL, noise=replace(MODEL.noise, floor_position_m=1e-3, floor_rotation_rad=5e-3))
    closed, motion, ticks = TickGrid(MODEL).add(poses), None, []
    assert not sum(tick.outliers.total for tick in closed)
    for tick in closed:
        motion, own = with_excess(motion, tick, noisier)
        ticks.append(own)
    alone = TickGrid(noisier).add(poses)
    for own, expected in zip(ticks, alone, strict=True):
        assert own.innovation_excess == pytest.approx(expected.innovation_excess, rel=1e-9)
    assert ticks[-1].innovation_excess != closed[-1].innovation_excess


def test_a_tick_is_the_mean_of_its_frames():
    poses = moving(np.random.default_rng(2), 3.0, 200.0, 3e-4, 2e-3)
    ticks = averaged(poses)
    assert len(ticks) == 30
    zeta = lift(poses.rotation, poses.position_m - poses.position_m[0])
    for k, tick in enumerate(ticks):
        frames = slice(20 * k, 20 * k + 20)
        assert (tick.start_ns, tick.stamp_ns) == tuple(poses.stamp_ns[frames][[0, -1]])
        assert tick.count + tick.outliers.total == 20
        if tick.count == 20:
            np.testing.assert_allclose(tick.zeta, zeta[frames].mean(axis=0), atol=1e-12)
        assert tick.zeta[ONE] == 1.0


@pytest.mark.parametrize(
    ("rate_hz", "sigma_m", "most"),
    [(30.0, 0.0, 0.01), (50.0, 0.0, 0.003), (50.0, 1e-4, 0.01), (125.0, 0.0, 0.001), (500.0, 0.0, 0.001)],
)
def test_poses_of_a_robot_that_speeds_up_are_no_outliers(rate_hz, sigma_m, most):
    """Also the first and last frames of a tick, which have neighbours on one side; most jumps of 3 cm are."""
    rng = np.random.default_rng(0)
    poses = exact_transfers(rng, 30.0, rate_hz)
    position_m = poses.position_m + sigma_m * rng.normal(size=poses.position_m.shape)
    outliers = sum(tick.outliers.total for tick in averaged(replace(poses, position_m=position_m)))
    assert outliers <= most * len(poses)
    position_m[50 :: round(rate_hz)] += 0.03
    jumps = len(position_m[50 :: round(rate_hz)])
    found = sum(tick.outliers.total for tick in averaged(replace(poses, position_m=position_m)))
    assert found >= outliers + 0.7 * jumps


@pytest.mark.parametrize(("rate_hz", "missed"), [(30.0, 0.03), (200.0, 0.001)])
def test_spikes_are_left_out(rate_hz, missed):
    """Outliers of 5 cm in 2 % of the frames: nearly all are found, even with three frames per tick."""
    off, dropped, spikes = [], 0, 0
    for seed in range(4, 8):
        rng = np.random.default_rng(seed)
        clean = moving(rng, 40.0, rate_hz, 3e-4, 2.6e-3)
        poses, wrong = spiked(rng, clean, 0.02)
        found, late = averaged(poses), slice(10, None)
        dropped += sum(tick.outliers.total for tick in found[late])
        spikes += wrong[round(rate_hz) :].sum()
        for tick in found[late]:
            mine = (poses.stamp_ns >= tick.start_ns) & (poses.stamp_ns <= tick.stamp_ns) & ~wrong
            mean_m = clean.position_m[mine].mean(axis=0)
            off.append(np.linalg.norm(tick.zeta[T] - mean_m + poses.position_m[0]))
    assert 0.9 * spikes <= dropped <= 1.3 * spikes
    assert np.mean(np.array(off) > 0.005) < missed


def test_outliers_do_not_raise_the_noise():
    """Outliers in a tenth of the frames; then a sensor whose noise increases tenfold."""
    rng = np.random.default_rng(6)
    clean = moving(rng, 20.0, 200.0, 3e-4, 2.6e-3)
    poses, _ = spiked(rng, clean, 0.1)
    alike = averaged(clean)[-1].noise
    assert averaged(poses)[-1].noise.sigma_position_m == pytest.approx(alike.sigma_position_m, rel=0.1)
    worse = moving(rng, 20.0, 200.0, 3e-3, 2.6e-2)
    late = replace(worse, stamp_ns=worse.stamp_ns - worse.stamp_ns[0] + clean.stamp_ns[-1] + 5_000_000)
    grown = averaged(Poses.join([clean, late]))[-1].noise
    assert grown.sigma_position_m == pytest.approx(3e-3, rel=0.2)


def test_flips_of_a_robot_stand_out_of_three_frames():
    """A wrong frame between two others does not widen its own gate."""
    poses = exact_transfers(np.random.default_rng(0), 60.0, 30.0)
    at = np.arange(40, len(poses), 50)
    quat = poses.quat_xyzw.copy()
    quat[at] = (Rotation.from_quat(quat[at]) * Rotation.from_rotvec([np.pi, 0.0, 0.0])).as_quat()
    found = sum(tick.outliers.total for tick in averaged(replace(poses, quat_xyzw=quat)))
    assert found >= 0.9 * len(at)


def test_spikes_of_a_camera_stand_out_of_three_frames():
    rng = np.random.default_rng(4)
    clean = moving(rng, 60.0, 30.0, 1.5e-3, 1.2e-2)
    poses, wrong = spiked(rng, clean, 0.02, size_m=0.03)
    assert sum(tick.outliers.total for tick in averaged(poses)) >= 0.3 * wrong.sum()
    assert sum(tick.outliers.total for tick in averaged(clean)) <= 0.005 * len(clean)


@pytest.mark.parametrize("start", ["stream", "gap"])
def test_spikes_are_left_out_from_the_beginning(start):
    """The other frames of a tick reveal an outlier as well as the motion does."""
    clean = moving(np.random.default_rng(5), 6.0, 200.0, 3e-4, 2.6e-3)
    if start == "gap":
        clean = clean[np.abs(np.arange(1200) - 600) > 50]
    row = 7 if start == "stream" else int(np.flatnonzero(np.diff(clean.stamp_ns) > 1e8)[0]) + 8
    position = clean.position_m.copy()
    position[row] += 0.05
    ticks = averaged(replace(clean, position_m=position))
    spoiled = next(tick for tick in ticks if tick.start_ns <= clean.stamp_ns[row] <= tick.stamp_ns)
    stamp_ns = int(clean.stamp_ns[row])
    assert spoiled.outliers == (1, (stamp_ns,))
    several = reduce(Outliers.joined, [spoiled.outliers] * 4)
    text = counts_text({"gap": 0, "outlier": 4}, several, stamp_ns - 1_250_000_000)
    assert text == "outlier 4 (at 1.25, 1.25, 1.25 s, ...)"
    assert several.joined(spoiled.outliers).since(several) == (1, ())


def test_an_object_that_jumps_is_followed():
    """If all frames of a tick are implausible they are accepted, and later ones are not lost."""
    poses = moving(np.random.default_rng(6), 10.0, 200.0, 3e-4, 2e-3)
    position = poses.position_m + np.where(np.arange(2000) >= 1000, 1.0, 0.0)[:, None]
    ticks = averaged(replace(poses, position_m=position))
    assert all(tick.count > 0 for tick in ticks)
    np.testing.assert_allclose(ticks[-1].zeta[T], position[-20:].mean(axis=0) - position[0], atol=1e-3)


def test_held_poses_are_counted_once_and_one_frame_per_tick_is_enough():
    poses = moving(np.random.default_rng(7), 2.0, 200.0, 3e-4, 2e-3)
    source = np.arange(400) // 4 * 4  # each pose four times
    held = averaged(Poses(poses.stamp_ns, poses.position_m[source], poses.quat_xyzw[source]))
    assert [tick.count + tick.outliers.total for tick in held] == [5] * 20
    single = averaged(moving(np.random.default_rng(9), 20.0, 10.0, 3e-4, 2e-3))
    assert [tick.count for tick in single] == [1] * 200
    assert any(tick.innovation_excess[0] > 0 for tick in single)


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_missing_frames_are_not_motion(share):
    """A tick has the mean time of its frames: uniform motion is as predictable with half of them."""
    poses = moving(np.random.default_rng(17), 30.0, 200.0, 3e-4, 2e-3)
    kept = np.random.default_rng(18).random(len(poses)) > share
    whole, thinned = (
        np.median([tick.innovation_excess for tick in averaged(stream)][20:], axis=0)
        for stream in (poses, poses[kept])
    )
    assert (np.maximum(whole, thinned) < 4.0 * np.minimum(whole, thinned)).all()
    noise = averaged(poses[kept])[-1].noise
    assert noise.sigma_position_m == pytest.approx(3e-4, rel=0.15)


def test_ticks_of_a_pose_that_got_stuck_are_empty():
    """A sensor with noise never measures the same pose twice; without noise, at rest, it does."""
    poses = moving(np.random.default_rng(19), 6.0, 200.0, 3e-4, 2e-3)
    at = np.where((np.arange(1200) > 600) & (np.arange(1200) < 700), 600, np.arange(1200))
    stuck = Poses(poses.stamp_ns, poses.position_m[at], poses.quat_xyzw[at])
    assert [k for k, tick in enumerate(averaged(stuck)) if not tick.count] == [31, 32, 33, 34]
    moved = moving(np.random.default_rng(19), 6.0, 200.0, 0.0, 0.0)
    at = np.minimum(np.arange(1200), 600)
    stopped = Poses(moved.stamp_ns, moved.position_m[at], moved.quat_xyzw[at])
    assert all(tick.count for tick in averaged(stopped)[-5:])


@pytest.mark.parametrize("rate_hz", [30.0, 125.0, 500.0])
def test_a_robot_that_stops_rests(rate_hz):
    time_s = np.arange(0.0, 4.0, 1.0 / rate_hz)
    place_m = np.outer(0.3 * least_jerk((time_s - 1.0) / 1.5), [1.0, 0.5, 0.2])
    turn = Rotation.from_rotvec(place_m * [1.0, -2.0, 1.0]).as_quat()
    stopped = Poses(START_NS + np.rint(time_s * 1e9).astype(np.int64), place_m, turn)
    assert all(tick.count for tick in averaged(stopped)[1:])
    at = np.where(time_s > 1.75, np.argmax(time_s > 1.7), np.arange(len(time_s)))
    stuck = averaged(Poses(stopped.stamp_ns, place_m[at], turn[at]))
    assert not any(tick.count for tick in stuck[19:24])


def test_a_gap_is_followed_tick_by_tick():
    poses = moving(np.random.default_rng(10), 6.0, 200.0, 3e-4, 2e-3)
    present = (poses.stamp_ns < START_NS + 2_030_000_000) | (poses.stamp_ns >= START_NS + 3_560_000_000)
    ticks = averaged(poses[present])
    assert len(ticks) == 60
    empty = [k for k, tick in enumerate(ticks) if tick.count == 0]
    assert empty == list(range(21, 35))
    assert all(ticks[k].innovation_excess == NO_EXCESS for k in empty)
    assert (ticks[20].count, ticks[35].count) == (6, 8)
    # the grid is the same after the gap
    assert ticks[36].start_ns == START_NS + 36 * TICK_NS


@settings(max_examples=40, deadline=None)
@given(
    seed=seeds,
    gaps=st.lists(
        st.sampled_from([1_000_000, 5_000_000, 99_999_999, TICK_NS, 350_000_000, 10**11]), max_size=30
    ),
    tick_s=st.sampled_from([0.1, 1 / 30, 0.07, 0.5]),
)
def test_no_frame_is_lost_and_time_runs_forward_whatever_the_stamps(seed, gaps, tick_s):
    rng = np.random.default_rng(seed)
    stamp_ns = START_NS + np.cumsum([0, *gaps]).astype(np.int64)
    poses = replace(moving(rng, len(stamp_ns) / 30.0, 30.0, 3e-4, 2e-3), stamp_ns=stamp_ns)
    ticks = averaged(poses, replace(MODEL, tick_s=tick_s))
    assert sum(tick.count + tick.outliers.total for tick in ticks) == len(poses)
    assert ticks[0].start_ns == stamp_ns[0]
    assert ticks[-1].stamp_ns == stamp_ns[-1]
    for tick, after in pairwise(ticks):
        assert tick.start_ns <= tick.stamp_ns < after.start_ns
    assert all(np.isfinite(tick.zeta).all() for tick in ticks)
    assert all(tick.stamp_ns - tick.start_ns <= tick_s * 1e9 for tick in ticks)


@pytest.mark.parametrize("batch", [7])
@pytest.mark.parametrize("late", [(205, 100), (100, 120), (3, -20), (399, 0)], ids=str)
def test_stamps_that_run_backward_close_no_tick_again(late, batch):
    """The gate drops them; without the gate they are ignored."""
    poses = moving(np.random.default_rng(13), 2.0, 200.0, 3e-4, 2e-3)
    stamp_ns, (row, like) = poses.stamp_ns.copy(), late
    stamp_ns[row] = START_NS + like * 5_000_000
    ticks = averaged(replace(poses, stamp_ns=stamp_ns), batch=batch)
    assert sum(tick.count + tick.outliers.total for tick in ticks) == len(poses)
    assert 19 <= len(ticks) <= 21


@pytest.mark.parametrize(("gap_s", "without_excess"), [(0.5, 0), (1.8, 0), (2.5, 5)])
def test_after_a_gap_motion_goes_on_unless_it_was_long(gap_s, without_excess):
    """The strength of the motion is kept; errors of long predictions do not count."""
    poses = moving(np.random.default_rng(14), 6.0, 200.0, 3e-4, 2e-3)
    at_s = (poses.stamp_ns - START_NS) * 1e-9
    present = poses[(at_s < 2.0) | (at_s >= 2.0 + gap_s)]
    found = [t for t in averaged(present) if t.start_ns - START_NS >= (2.0 + gap_s) * 1e9]
    without = [tick.innovation_excess == NO_EXCESS for tick in found[: without_excess + 5]]
    assert without == [True] * without_excess + [False] * 5
    anew = averaged(poses[at_s >= 2.0 + gap_s])
    if not without_excess:  # better than a new start of the filter
        kept, new = (np.mean([tick.innovation_excess for tick in ticks[5:15]]) for ticks in (found, anew))
        assert kept < new


def test_noise_of_means_falls_with_their_frames_to_the_floor():
    noise = TickGrid.start(MODEL, 0, Origins.zero()).stream.noise
    position, rotation = tick_variances(noise, np.array([0.0, 1.0, 100.0, 1e12]), MODEL).T
    floor = MODEL.noise.floor_position_m**2
    assert position[0] == position[1] == pytest.approx(MODEL.noise.sigma_position_m**2 + floor)
    assert position[2] - floor == pytest.approx(MODEL.noise.sigma_position_m**2 / 100.0)
    assert position[3] == pytest.approx(floor)
    assert rotation[3] == pytest.approx(MODEL.noise.floor_rotation_rad**2)
