"""While the object rests, the trackers but the first wait, and catch up when it moves again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import as_values
from contact_tracker.adaptation import rest
from contact_tracker.checks import conventions
from contact_tracker.config.loading import load_model
from contact_tracker.hypotheses import compiled
from contact_tracker.map.file import map_from
from contact_tracker.motion.poses import Poses
from contact_tracker.saved_state import is_same, load, save
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.contact_filter import ContactFilter
from distortions import turned
from short_recordings import FACE_TO_EDGE, recorded

MODEL = load_model()
RATE_HZ = 200.0
needs_kernels = pytest.mark.skipif(not compiled.in_use(), reason="it takes numpy too long")


def resting(first: Poses, rest_s: float) -> Poses:
    """White noise about the first pose."""
    rng, count = np.random.default_rng(5), int(rest_s * RATE_HZ)
    still = Poses(
        np.arange(count) * int(1e9 / RATE_HZ),
        first.position_m[0] + 3e-4 * rng.normal(size=(count, 3)),
        np.tile(first.quat_xyzw[0], (count, 1)),
    )
    return replace(still, quat_xyzw=turned(still, 2.6e-3 * rng.normal(size=(count, 3))))


def then(poses: Poses, more: Poses, pause_s: float = 1.0 / RATE_HZ) -> Poses:
    """Poses, after a pause followed by more."""
    shift = poses.stamp_ns[-1] + int(1e9 * pause_s) - more.stamp_ns[0]
    return Poses.join([poses, replace(more, stamp_ns=more.stamp_ns + shift)])


def followed(poses: Poses, size: int = 50) -> tuple[list[Tracker], list[Belief]]:
    """The states after every ``size`` poses, and all beliefs."""
    state, states, beliefs = as_values.start(MODEL), list[Tracker](), list[Belief]()
    for first in range(0, len(poses), size):
        state, some = as_values.advance(state, poses[first : first + size])
        states.append(state)
        beliefs += some
    return states, beliefs


def waiting(poses: Poses) -> tuple[Tracker, int]:
    """The last state in which trackers wait, and the number of poses until then."""
    states, _ = followed(poses)
    last = max(i for i, state in enumerate(states) if waits(state))
    return states[last], 50 * (last + 1)


def waits(state: Tracker) -> bool:
    first, *others = state.filters.filters
    return any(one.state.ticks < first.state.ticks for one in others)


@needs_kernels
def test_at_rest_only_the_first_tracker_takes_in_ticks() -> None:
    states, beliefs = followed(resting(recorded(FACE_TO_EDGE).poses, 30.0))
    assert len(states[-1].filters.filters) > 3
    assert np.mean([waits(state) for state in states]) > 0.6
    stamps = np.diff([belief.stamp_ns for belief in beliefs])
    assert len(beliefs) > 290
    assert stamps.min() > 0
    assert stamps.max() < 2 * stamps.min()
    others = states[-1].filters.filters[1:]
    assert len({one.state.ticks for one in others}) == 1
    assert len(states[-1].filters.rest.kept) <= rest.KEPT_TICKS
    waiting_poses = sum(map(len, states[-1].checks.conventions.waiting))
    assert waiting_poses <= (conventions.TICKS + 2) * RATE_HZ * MODEL.tick_s


@needs_kernels
def test_labels_after_a_rest_are_those_of_trackers_that_do_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = recorded(FACE_TO_EDGE).poses
    poses = then(resting(moving, 12.0), moving)
    states, beliefs = followed(poses)
    assert any(waits(state) for state in states)
    assert not waits(states[-1])
    monkeypatch.setattr(rest, "REST_S", np.inf)
    _, expected = followed(poses)
    assert [one.stamp_ns for one in beliefs] == [one.stamp_ns for one in expected]
    off = [np.abs(a.probability - b.probability).max() for a, b in zip(beliefs, expected, strict=True)]
    assert np.mean(np.array(off) > 0.05) < 0.1
    assert max(off) < 0.3
    assert np.mean([a.contact is not b.contact for a, b in zip(beliefs, expected, strict=True)]) < 0.03


@needs_kernels
def test_in_a_gap_trackers_wait_and_then_take_in_what_follows() -> None:
    moving = recorded(FACE_TO_EDGE).poses
    half = moving[:400]
    states, _ = followed(then(half, moving[400:], pause_s=4.0))
    assert len(states[7].filters.filters) > 3
    assert not any(waits(state) for state in states[:8])
    assert waits(states[8])
    assert not any(waits(state) for state in states[12:])  # a second later: the motion is known again
    ended, _ = as_values.finish(states[8])
    assert not waits(ended)


@pytest.mark.long
@needs_kernels
def test_in_bursts_of_poses_the_noise_is_decided_as_well() -> None:
    """Most ticks are in gaps there; those with frames show the motion."""
    rng, time_s = np.random.default_rng(3), np.cumsum(np.tile([0.05, 0.05, 1.0], 220))
    still = np.zeros_like(time_s)
    place = 0.1 * np.array([np.sin(0.5 * time_s), np.cos(0.3 * time_s), 0.2 * np.sin(0.2 * time_s)]).T
    turn = np.array([still, 0.2 * np.sin(0.4 * time_s), 0.3 * np.sin(0.3 * time_s)]).T
    off = 2e-4 * rng.normal(size=(2, len(time_s), 3))
    quat = Rotation.from_rotvec(turn) * Rotation.from_rotvec(off[1])
    states, _ = followed(Poses((time_s * 1e9).astype(np.int64), place + off[0], quat.as_quat()))
    assert len(states[1].filters.filters) > 3
    assert len(states[-1].filters.filters) < 3
    assert states[-1].filters.moved_s > 5.0


@needs_kernels
@pytest.mark.parametrize("size", [7])
def test_however_poses_come_trackers_wait_alike(size: int) -> None:
    moving = recorded(FACE_TO_EDGE).poses
    poses = then(then(resting(moving, 6.0), moving[:300]), moving[300:500], pause_s=3.0)
    states, expected = followed(poses)
    assert any(waits(state) for state in states)
    _, beliefs = followed(poses, size)
    assert [one.stamp_ns for one in beliefs] == [one.stamp_ns for one in expected]
    for one, other in zip(beliefs, expected, strict=True):
        assert one.contact is other.contact
        assert one.probability == pytest.approx(other.probability, abs=1e-12)


@needs_kernels
@pytest.mark.parametrize("size", [1])
def test_however_poses_come_a_gap_during_which_trackers_begin_to_wait_is_the_same(size: int) -> None:
    """One pose a tick or so; the gap is shorter than free-motion filters coast."""
    moving = recorded(FACE_TO_EDGE).poses[::6]
    still = resting(moving[70:], 1.0)[::6]
    poses = then(then(then(moving[:70], still, 0.03), moving[70:100], pause_s=1.6), moving[100:160], 0.03)
    states, expected = followed(poses)
    assert len(states[1].filters.filters) > 3
    _, beliefs = followed(poses, size)
    for one, other in zip(beliefs, expected, strict=True):
        assert one.probability == pytest.approx(other.probability, abs=1e-12)


@needs_kernels
def test_a_state_that_is_saved_while_trackers_wait_continues_alike(tmp_path: Path) -> None:
    moving = recorded(FACE_TO_EDGE).poses
    poses = then(resting(moving, 5.0), moving[:200])
    state, cut = waiting(poses[:1000])
    save(tmp_path / "state", state)
    restored, beliefs = as_values.advance(load(tmp_path / "state"), poses[cut:])
    expected, same = as_values.advance(state, poses[cut:])
    assert not waits(expected)
    assert [one.to_json() for one in beliefs] == [one.to_json() for one in same]
    assert is_same(restored.filters.log_weight, expected.filters.log_weight)
    for one, other in zip(restored.filters.filters, expected.filters.filters, strict=True):
        assert is_same(one.state.banks, other.state.banks)


@needs_kernels
def test_a_stream_that_ends_while_trackers_wait_may_continue() -> None:
    moving = recorded(FACE_TO_EDGE).poses
    poses = then(resting(moving, 5.0), moving[:400])
    state, cut = waiting(poses[:1000])
    state, _ = as_values.finish(state)
    state, beliefs = as_values.advance(state, poses[cut:])
    assert len(beliefs) > 15
    first, *others = (one.state for one in state.filters.filters)
    assert others
    assert {one.ticks for one in others} == {first.ticks}
    for one in others:
        np.testing.assert_array_equal(one.window.index, first.window.index)
        np.testing.assert_array_equal(one.window.zeta[-15:], first.window.zeta[-15:])
        assert one.outliers == first.outliers


def test_with_known_elements_or_a_lag_no_tracker_waits() -> None:
    given = map_from({"environment": {"plane": [{"normal": [0, 0, 1], "offset_m": 0.0}]}})
    poses = resting(recorded(FACE_TO_EDGE).poses, 6.0)
    for start in (as_values.start(MODEL, 0.5), as_values.start(MODEL, known_map=given)):
        state, _ = as_values.advance(start, poses)
        assert len(state.filters.filters) > 3
        assert not waits(state)


def updates_of(poses: Poses, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Number of ticks reported, and of updates of all trackers side by side."""
    count = 0

    def counting(*args: Any, **kwargs: Any) -> Belief:
        nonlocal count
        count += 1
        return update(*args, **kwargs)

    update = ContactFilter.update
    monkeypatch.setattr(ContactFilter, "update", counting)
    state, beliefs = as_values.advance(as_values.start(MODEL), poses)
    assert len(state.filters.filters) > 3
    return len(beliefs), count


def slow(position_m: np.ndarray[Any, Any], rate_hz: float) -> Poses:
    """Poses of an object that does not turn."""
    count = len(position_m)
    stamp_ns = np.arange(count) * int(1e9 / rate_hz)
    return Poses(stamp_ns, position_m, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))


@needs_kernels
@pytest.mark.parametrize("kind", ["noisy", "jumping"])
def test_in_slow_streams_trackers_wait_where_the_object_goes_nowhere(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There some trackers have less noise than the first, and would find motion in any rest."""
    count = 1000
    jumps = {"noisy": 1e-3, "jumping": 1.0}[kind]
    poses = slow(jumps * np.random.default_rng(2).normal(size=(count, 3)), 10.0)
    ticks, updates = updates_of(poses, monkeypatch)
    assert ticks > 0.6 * count
    assert updates < 4 * ticks


@needs_kernels
def test_after_a_long_rest_in_a_slow_stream_all_trackers_go_on() -> None:
    moving = recorded(FACE_TO_EDGE).poses[::20]
    still = slow(np.zeros((300, 3)), 10.0)
    still = replace(still, position_m=still.position_m + moving.position_m[0])
    states, _ = followed(then(still, moving, pause_s=0.1), size=10)
    assert waits(states[29])
    assert not waits(states[-1])


@needs_kernels
def test_poses_too_far_apart_for_any_evidence_are_followed_by_one_tracker() -> None:
    """Hours of poses five seconds apart fit in a small file; none of them decides between trackers."""
    steps = np.random.default_rng(4).normal(size=(300, 3))
    poses = slow(0.01 * np.cumsum(steps, axis=0), 0.2)
    state, _ = as_values.advance(as_values.start(MODEL), poses)
    assert state.is_decided
    assert not state.checks.conventions.found
    state, _ = as_values.advance(as_values.start(MODEL), slow(np.zeros((100, 3)), 0.8))
    assert len(state.filters.filters) > 3
