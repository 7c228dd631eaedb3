"""While the object rests, the trackers but the first wait, and catch up when it moves again."""

from dataclasses import replace

import numpy as np
import pytest

from contact_tracker import adaptation
from contact_tracker.adaptation import rest
from contact_tracker.adaptation.online import AdaptiveState
from contact_tracker.config.loading import load_model
from contact_tracker.hypotheses import compiled
from contact_tracker.motion.poses import Poses
from contact_tracker.prior_map_files import knowledge_from
from contact_tracker.tracking.belief import Belief
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


def followed(poses: Poses, size: int = 50) -> tuple[list[AdaptiveState], list[Belief]]:
    """The states after every ``size`` poses, and all beliefs."""
    state, states, beliefs = adaptation.start(MODEL), list[AdaptiveState](), list[Belief]()
    for first in range(0, len(poses), size):
        state, some = adaptation.advance(state, poses[first : first + size])
        states.append(state)
        beliefs += some
    return states, beliefs


def waits(state: AdaptiveState) -> bool:
    first, *others = state.trackers.trackers
    assert all(one.averaging is not None for one in others)
    return any(one.ticks < first.ticks for one in others)


@needs_kernels
def test_at_rest_only_the_first_tracker_takes_in_ticks() -> None:
    states, beliefs = followed(resting(recorded(FACE_TO_EDGE).poses, 30.0))
    assert len(states[-1].trackers.trackers) > 3
    assert np.mean([waits(state) for state in states]) > 0.6
    stamps = np.diff([belief.stamp_ns for belief in beliefs])
    assert len(beliefs) > 290
    assert stamps.min() > 0
    assert stamps.max() < 2 * stamps.min()
    others = states[-1].trackers.trackers[1:]
    assert len({one.ticks for one in others}) == 1
    assert len(states[-1].trackers.rest.kept) <= rest.KEPT_TICKS
    assert len(states[-1].conventions.waiting) <= (rest.KEPT_TICKS + 1) * RATE_HZ * MODEL.tick_s


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
    assert len(states[7].trackers.trackers) > 3
    assert not any(waits(state) for state in states[:8])
    assert waits(states[8])
    assert not any(waits(state) for state in states[12:])  # a second later: the motion is known again
    ended, _ = adaptation.finish(states[8])
    assert not waits(ended)


@needs_kernels
@pytest.mark.parametrize("size", [1, 7, 400])
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


def test_with_known_elements_or_a_lag_no_tracker_waits() -> None:
    given = knowledge_from({"environment": {"plane": [{"normal": [0, 0, 1], "offset_m": 0.0}]}})
    poses = resting(recorded(FACE_TO_EDGE).poses, 6.0)
    for start in (adaptation.start(MODEL, 0.5), adaptation.start(MODEL, knowledge=given)):
        state, _ = adaptation.advance(start, poses)
        assert len(state.trackers.trackers) > 3
        assert not waits(state)
