"""What kernels average of a stream, and hear of its noise, is what the numpy code does."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker import averaging, free_motion, noise, ticks
from contact_tracker.averaging import Run
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
    shown = np.maximum.accumulate(np.where(rng.random(many) > 0.2, np.arange(many), 0))
    poses = Poses(poses.stamp_ns, (poses.position_m + spikes)[shown], quat[shown])
    return poses[np.sort(rng.choice(many, round(0.95 * many), replace=False))]


def averaged(poses):
    """The ticks of a stream, of which so many poses come at once, and what is learnt after each portion."""
    state, closed, learnt = ticks.begin(MODEL, poses), [], []
    for some in (poses[first : first + 70] for first in range(0, len(poses), 70)):
        state, more = ticks.advance(state, some, MODEL)
        closed += more
        learnt.append(state.learnt)
    state, last = ticks.close(state, MODEL)
    return [*closed, last], [*learnt, state.learnt]


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
    (numpy, numpy_learnt), (kernel, kernel_learnt) = both(averaged, streamed(seed, rate_hz))
    assert len(numpy) > 30
    assert [(t.count, t.outliers) for t in kernel] == [(t.count, t.outliers) for t in numpy]
    if rate_hz >= 30.0:
        assert sum(t.outliers for t in numpy) > 0
    for found, expected in zip(kernel, numpy, strict=True):
        np.testing.assert_allclose(found.zeta, expected.zeta, atol=1e-12)
        np.testing.assert_allclose(found.excess, expected.excess, rtol=1e-5, atol=1e-12)
        assert_same_noise(found.noise, expected.noise)
    assert any(t.excess.position_m2 > 0.0 and t.excess.rotation_rad2 > 0.0 for t in numpy)
    for found, expected in zip(kernel_learnt, numpy_learnt, strict=True):
        if expected.motion is None:
            assert found.motion is None
        else:
            assert_same_motion(
                found.motion, expected.motion, 1e-5
            )  # directions of errors are small differences
        assert_same_noise(found.noise, expected.noise)
        assert_close(found.heard.differences, expected.heard.differences, 1e-9)
        np.testing.assert_array_equal(found.heard.frames.stamp_ns, expected.heard.frames.stamp_ns)
        np.testing.assert_array_equal(found.heard.frames.quat_xyzw, expected.heard.frames.quat_xyzw)


def assert_same_noise(found, expected):
    for name in ("position_m2", "rotation_rad2", "centre_m", "shape"):
        assert_close(getattr(found, name), getattr(expected, name), 1e-8)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9])
@pytest.mark.parametrize("begun", [0, 3, 8])
@pytest.mark.parametrize("is_rest", [False, True])
def test_few_frames_are_averaged_alike(count, begun, is_rest):
    """Of a tick with so many frames, of which one stands out, after so many ticks."""
    for seed in range(8):
        frames = streamed(seed, 1000.0, 0.1)[:count]
        learnt = ticks.begin(MODEL, frames).learnt
        if begun:
            learnt = averaged(moving(np.random.default_rng(seed), 0.1 * begun, 200.0, 3e-4, 2e-3))[1][-1]
        far = frames.position_m + np.where(np.arange(count)[:, None] == count // 2, 0.3, 0.0)
        for some in (frames, replace(frames, position_m=far)):
            run = Run(some, np.array([count]), int(frames.stamp_ns[0]), np.full(3, 0.1), is_rest)
            (numpy, (one,)), (kernel, (other,)) = both(averaging.averaged, learnt, run, MODEL)
            assert (other.count, other.outliers) == (one.count, one.outliers)
            np.testing.assert_allclose(other.zeta, one.zeta, atol=1e-12)
            np.testing.assert_allclose(other.excess, one.excess, rtol=1e-5, atol=1e-12)
            assert (kernel.motion is None) == (numpy.motion is None) == is_rest


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
    """Of frames at uneven times, until memory is full."""
    (_, numpy), (_, kernel) = both(averaged, streamed(2, rate_hz, 9000.0 / rate_hz))
    assert numpy[-1].heard.differences.shape[1] == noise.MEMORY
    assert_close(kernel[-1].heard.differences, numpy[-1].heard.differences, 1e-9)
    assert_same_noise(kernel[-1].noise, numpy[-1].noise)


def test_what_is_no_state_is_refused():
    """Kernels read arrays: what has another shape would be read beyond its end."""
    kernels = pytest.importorskip("contact_tracker.compiled.kernels")
    poses = streamed(0, 200.0, 1.0)
    learnt, run = averaged(poses)[1][-1], Run(poses[:20], np.array([8, 20]), 0, np.zeros(3), False)
    averaging._compiled(learnt, run, MODEL)
    motion = learnt.motion
    for name, value in motion._asdict().items():
        if isinstance(value, np.ndarray) and name != "latest":
            less = learnt._replace(motion=motion._replace(**{name: value[:-1]}))
            with pytest.raises(ValueError, match="a state does not have its fields"):
                averaging._compiled(less, run, MODEL)
    refused = {
        "too many latest errors": learnt._replace(motion=motion._replace(latest=np.zeros((9, 2, 2)))),
        "differences have their rows": learnt._replace(heard=learnt.heard._replace(differences=np.eye(14))),
        "a shape is that of two vectors": learnt._replace(noise=replace(learnt.noise, shape=np.eye(5))),
    }
    for message, other in refused.items():
        with pytest.raises(ValueError, match=message):
            averaging._compiled(other, run, MODEL)
    for ends in ([8, 8], [0, 20], [8, 21]):
        with pytest.raises(ValueError, match="a tick has frames"):
            averaging._compiled(learnt, run._replace(ends=np.array(ends)), MODEL)
    bad = replace(poses[:20], quat_xyzw=np.zeros((20, 3)))
    with pytest.raises(ValueError, match="a quaternion has four numbers"):
        averaging._compiled(learnt, run._replace(frames=bad), MODEL)
    onward = free_motion.onward(0.1, 1.0)
    with pytest.raises(ValueError, match="what jerk does"):
        kernels.Averaging(10**8, (1.0, 1.0), (0.0, 0.0), 5.0, True, onward.onward, np.eye(5), 0.9, 0.9)


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_windows_slide_on_alike_whichever_ways_lead_on_from_them(seed):
    rng = np.random.default_rng(seed)
    closed, _ = averaged(streamed(seed, 100.0))
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
            made[i] = slid(from_, i, closed[ticks[i]], model)
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
    closed, _ = averaged(streamed(3, 100.0))
    model = replace(MODEL, search=replace(MODEL.search, window_s=1e9))
    sliding, trails = NOTHING_SEEN, {}
    for number in range(500):
        sliding = slid(sliding, number, closed[number % 30], model)
        trails[id(sliding.trail)] = sliding.trail  # kept, or another could have the same id
    assert len(sliding.window) == 500
    assert len(trails) < 6


def test_a_window_that_does_not_fit_its_ticks_is_refused():
    (tick, *_), _ = averaged(streamed(1, 100.0))
    sliding = slid(NOTHING_SEEN, 0, tick, MODEL)
    with pytest.raises(ValueError, match="number of frames"):
        slid(sliding._replace(trail=None, frames=np.zeros((1, 3))), 1, tick, MODEL)
    with pytest.raises(ValueError, match="one lifted pose"):
        slid(sliding, 1, replace(tick, zeta=tick.zeta[1:]), MODEL)
