"""What kernels average of a stream, and hear of its noise, is what the numpy code does."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker import free_motion, noise, ticks
from contact_tracker.poses import Poses
from contact_tracker.presets import load_model
from contact_tracker.sliding import NOTHING_SEEN, slid
from moving import moving

both = pytest.importorskip("kernels").both
MODEL = load_model()
seeds = st.integers(0, 2**32 - 1)
each_rate = pytest.mark.parametrize("rate_hz", [15.0, 30.0, 200.0, 1000.0])


def streamed(seed, rate_hz, seconds=4.0):
    """Motion with noise, spikes, poses that are held, lost frames and quaternions of either sign."""
    rng = np.random.default_rng(seed)
    poses = moving(rng, seconds, rate_hz, 3e-4, 2e-3)
    many = len(poses)
    spikes = (rng.random((many, 1)) < 0.03) * rng.normal(size=(many, 3)) * 0.05
    turned = Rotation.from_rotvec((rng.random((many, 1)) < 0.03) * rng.normal(size=(many, 3)))
    quat = (Rotation.from_quat(poses.quat_xyzw) * turned).as_quat() * rng.choice([-1.0, 1.0], (many, 1))
    poses = replace(poses, position_m=poses.position_m + spikes, quat_xyzw=quat)
    return poses[np.sort(rng.choice(many, round(0.95 * many), replace=False))]


def averaged(poses):
    """The ticks of a stream, and how the averaging stands after each."""
    state, closed, states, left = ticks.begin(MODEL, poses), [], [], poses
    while len(left):
        state, more, left = ticks.advance(state, left, MODEL)
        closed += more
        states += [state] * len(more)
    state, last = ticks.close(state, MODEL)
    return [*closed, last], [*states, state]


def assert_close(found, expected, rel):
    np.testing.assert_allclose(
        found, expected, rtol=rel, atol=rel * max(np.abs(expected).max(initial=0.0), 1e-300)
    )


def assert_same_motion(found, expected, rel):
    for name, value in expected._asdict().items():
        if name == "orientation":  # of either sign
            found_quat = found.orientation * np.sign(found.orientation @ value)
            np.testing.assert_allclose(found_quat, value, atol=rel)
        else:
            np.testing.assert_allclose(getattr(found, name), value, rtol=rel, atol=rel, err_msg=name)


@each_rate
@settings(max_examples=8, deadline=None)
@given(seed=seeds)
def test_streams_are_averaged_alike(rate_hz, seed):
    """The same frames are left out, and rounding is all that differs, however long it goes on."""
    (numpy, numpy_states), (kernel, kernel_states) = both(averaged, streamed(seed, rate_hz))
    assert len(numpy) > 30
    assert [(t.count, t.outliers) for t in kernel] == [(t.count, t.outliers) for t in numpy]
    if rate_hz >= 30.0:
        assert sum(t.outliers for t in numpy) > 0
    for found, expected in zip(kernel, numpy, strict=True):
        np.testing.assert_allclose(found.zeta, expected.zeta, atol=1e-12)
        np.testing.assert_allclose(found.excess, expected.excess, rtol=1e-5, atol=1e-12)
    assert any(t.excess.position_m2 > 0.0 and t.excess.rotation_rad2 > 0.0 for t in numpy)
    for found, expected in zip(kernel_states, numpy_states, strict=True):
        if expected.motion is None:
            assert found.motion is None
        else:
            assert_same_motion(
                found.motion, expected.motion, 1e-5
            )  # directions of errors are small differences
        assert_same_noise(found.noise, expected.noise)
        assert_close(found.heard.differences, expected.heard.differences, 1e-9)


def assert_same_noise(found, expected):
    for name in ("position_m2", "rotation_rad2", "centre_m", "shape"):
        assert_close(getattr(found, name), getattr(expected, name), 1e-8)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9])
@pytest.mark.parametrize("begun", [0, 3, 8])
def test_few_frames_are_averaged_alike(count, begun):
    """Of a tick with so many frames, of which one stands out, after so many ticks."""
    for seed in range(8):
        poses = streamed(seed, 1000.0, 0.1)
        state = ticks.begin(MODEL, poses)
        if begun:
            closed = averaged(moving(np.random.default_rng(seed), 0.1 * begun, 200.0, 3e-4, 2e-3))
            state = closed[1][-1]
        frames = poses[:count]
        far = frames.position_m + np.where(np.arange(count)[:, None] == count // 2, 0.3, 0.0)
        for some in (frames, replace(frames, position_m=far)):
            numpy, kernel = both(ticks._averaged, state, some, state.noise, MODEL)
            np.testing.assert_array_equal(kernel[0], numpy[0])
            np.testing.assert_allclose(kernel[1], numpy[1], atol=1e-12)


def test_an_object_at_rest_is_averaged_alike():
    """Without any noise: nothing is divided by what is zero."""
    many = 100
    still = Poses(
        10**9 + 5_000_000 * np.arange(many),
        np.full((many, 3), 0.3) + 1e-9 * (np.arange(many)[:, None] % 2),
        np.tile(Rotation.random(random_state=1).as_quat(), (many, 1)),
    )
    (numpy, _), (kernel, states) = both(averaged, still)
    for found, expected in zip(kernel, numpy, strict=True):
        np.testing.assert_allclose(found.zeta, expected.zeta, atol=1e-12)
        np.testing.assert_allclose(found.excess, expected.excess, atol=1e-15)
    assert np.isfinite(states[-1].noise.shape).all()


@each_rate
def test_noise_is_heard_alike(rate_hz):
    """Of frames at uneven times, with memory that is full."""
    poses = streamed(2, rate_hz, 3000.0 / rate_hz)
    estimate = noise.begin(3e-4, 2e-3)
    numpy, kernel = both(noise._third_differences, poses)
    assert numpy.shape[1] > noise.MEMORY
    assert_close(kernel, numpy, 1e-9)
    for columns in (numpy[:, -noise.MEMORY :], numpy[:, :7]):
        assert_same_noise(*both(noise._told, estimate, columns, (1e-3, 5e-3))[::-1])


def test_what_is_no_state_is_refused():
    """Kernels read arrays: what has another shape would be read beyond its end."""
    kernels = pytest.importorskip("contact_tracker.compiled.kernels")
    motion, tick = free_motion.begin(np.eye(3), np.zeros(3)), free_motion._tick(0.1)
    step = np.eye(3), np.zeros(3), np.ones(2), tick.onward, tick.jerk, 0.9, 0.9
    kernels.moved(motion, *step)
    for name, value in motion._asdict().items():
        if isinstance(value, np.ndarray) and value.size:
            with pytest.raises(ValueError, match="a state does not have its fields"):
                kernels.moved(motion._replace(**{name: value[:-1]}), *step)
    with pytest.raises(ValueError, match="too many latest errors"):
        kernels.moved(motion._replace(latest=np.zeros((9, 2, 2))), *step)
    with pytest.raises(ValueError, match="no frames"):
        kernels.averaged(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0), None, np.zeros(3), np.ones(2), 5.0)
    with pytest.raises(ValueError, match="a quaternion has four numbers"):
        kernels.third_differences(np.zeros(4, int), np.zeros((4, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="no differences"):
        kernels.told(np.eye(3), np.eye(3), np.eye(6), np.zeros((14, 5)), np.ones(2), np.ones(2))


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_windows_slide_on_alike_whichever_ways_lead_on_from_them(seed):
    rng = np.random.default_rng(seed)
    closed, states = averaged(streamed(seed, 100.0))
    before, ticks, spans = [], [], []
    for i in range(120):  # mostly on from the last one, else from any
        before.append(rng.integers(i) if i and rng.random() < 0.2 else i - 1)
        ticks.append(rng.integers(len(closed)))
        spans.append(rng.choice([0.1, 0.5, 1.0, 1.0, 1.0, 3.0]))

    def windows():
        made = {-1: NOTHING_SEEN}
        for i, k in enumerate(before):
            model = replace(MODEL, search=replace(MODEL.search, window_s=spans[i]))
            from_ = pickle.loads(pickle.dumps(made[k])) if i % 17 == 5 else made[k]
            made[i] = slid(from_, i, closed[ticks[i]], states[ticks[i]].noise, model)
        return made

    expected, found = both(windows)  # all are compared when all are made: none has changed since
    for one, other in zip(found.values(), expected.values(), strict=True):
        np.testing.assert_array_equal(one.frames, other.frames)
        for name in ("index", "zeta", "variance", "excess", "uneven", "inverse", "unheld", "before"):
            new, reference = getattr(one.window, name), getattr(other.window, name)
            assert (new is None) == (reference is None)
            if new is not None:
                assert_close(new, reference, 1e-14)


def test_ticks_are_copied_seldom_and_room_grows_with_them():
    closed, states = averaged(streamed(3, 100.0))
    model = replace(MODEL, search=replace(MODEL.search, window_s=1e9))
    sliding, trails = NOTHING_SEEN, {}
    for number in range(500):
        sliding = slid(sliding, number, closed[number % 30], states[number % 30].noise, model)
        trails[id(sliding.trail)] = sliding.trail  # kept, or another could have the same id
    assert len(sliding.window) == 500
    assert len(trails) < 6


def test_a_window_that_does_not_fit_its_ticks_is_refused():
    (tick, *_), (state, *_) = averaged(streamed(1, 100.0))
    sliding = slid(NOTHING_SEEN, 0, tick, state.noise, MODEL)
    with pytest.raises(ValueError, match="number of frames"):
        slid(sliding._replace(trail=None, frames=np.zeros((1, 3))), 1, tick, state.noise, MODEL)
    with pytest.raises(ValueError, match="one lifted pose"):
        slid(sliding, 1, replace(tick, zeta=tick.zeta[1:]), state.noise, MODEL)
