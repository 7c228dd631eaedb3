"""The tracker's results do not depend on the representation of the motion."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase

MODEL = load_model()
TICK_NS = MODEL.tick_ns
NEAR_A_CHANGE_NS = 3 * TICK_NS
"""Within this time of a change of contact probabilities may differ: it may be a tick later."""
FIRST_TICKS = 8
once = settings(max_examples=1, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


@cache
def recorded():
    """f-f, then e-f; 200 Hz, noise of motion capture."""
    return simulate(Scenario((Phase(Contact.FF, 2.2), Phase(Contact.EF, 3.0))), 2).poses


@cache
def expected():
    return segment(recorded(), MODEL)


def same_segments(done, ticks=0.0, onsets_ns=None):
    """Whether the contacts are the same, with onsets within ``ticks`` of each other."""
    assert [s.contact for s in done.segments] == [s.contact for s in expected().segments]
    onsets_ns = [s.start_ns for s in expected().segments] if onsets_ns is None else onsets_ns
    off_ns = [s.start_ns - onset for s, onset in zip(done.segments, onsets_ns, strict=True)]
    assert np.abs(off_ns[1:]).max() <= ticks * TICK_NS


def difference(done, name="beliefs", stamp_ns=None):
    """Largest difference (T,) of probabilities in each tick, at nearest stamps, away from changes."""
    stamp_ns = done.stamp_ns if stamp_ns is None else stamp_ns
    nearest = np.abs(stamp_ns[:, None] - expected().stamp_ns).argmin(axis=1)
    changes = np.array([s.start_ns for s in expected().segments[1:]])
    away = np.abs(stamp_ns[:, None] - changes).min(axis=1) > NEAR_A_CHANGE_NS
    found, before = (getattr(one, name).probability for one in (done, expected()))
    return np.abs(found - before[nearest]).max(axis=1)[away]


def same_geometry(done, world=None, world_shift=None, body=None, body_shift=None, within_m=0.004):
    """Whether the elements of e-f agree within 1 deg and ``within_m``."""
    world, body = world or Rotation.identity(), body or Rotation.identity()
    world_shift, body_shift = (np.zeros(3) if s is None else s for s in (world_shift, body_shift))
    before, after = expected().segments[1].geometry, done.segments[1].geometry
    normal = world.apply(before.environment.normal)
    sign = np.sign(normal @ after.environment.normal)
    assert degrees(normal, after.environment.normal) < 1.0
    at = recorded().position_m[-400:].mean(axis=0)
    height = before.environment.normal @ at - before.environment.offset_m
    moved = after.environment.normal @ (world.apply(at) + world_shift) - after.environment.offset_m
    assert moved * sign == pytest.approx(height, abs=within_m)
    edge, again = before.object, after.object
    assert degrees(edge.direction, body.apply(again.direction)) < 1.0
    off = body.apply(again.point_m) + body_shift - edge.point_m
    assert np.linalg.norm(off - edge.direction * (edge.direction @ off)) < within_m


def degrees(a, b):
    return np.degrees(np.arccos(min(abs(a @ b), 1.0)))


@given(seeds)
@once
def test_the_world_frame(seed):
    """Also for young hypotheses: a rotation of the world only rotates their geometry.

    In the first ticks of a contact many geometries fit equally well: rounding decides which of them is found.
    """
    rng, poses = np.random.default_rng(seed), recorded()
    world, shift = Rotation.random(random_state=rng), rng.uniform(-100.0, 100.0, 3)
    turn = world * Rotation.from_quat(poses.quat_xyzw)
    done = segment(Poses(poses.stamp_ns, world.apply(poses.position_m) + shift, turn.as_quat()), MODEL)
    same_segments(done)
    assert difference(done).max() < 0.01
    assert difference(done, "filtered")[FIRST_TICKS:].max() < 0.01
    same_geometry(done, world, shift)


@given(seeds)
@once
def test_the_body_frame(seed):
    """For any body frame, half a metre beside the object: x_body = rotation x_new + shift."""
    rng, poses = np.random.default_rng(seed), recorded()
    body, aside = Rotation.random(random_state=rng), rng.normal(size=3)
    shift = aside / np.linalg.norm(aside) * 0.5
    turn = Rotation.from_quat(poses.quat_xyzw)
    done = segment(
        Poses(poses.stamp_ns, poses.position_m + turn.apply(shift), (turn * body).as_quat()), MODEL
    )
    same_segments(done, ticks=1.0)
    assert difference(done).max() < 0.12
    assert difference(done, "filtered").mean() < 0.1
    same_geometry(done, body=body, body_shift=shift)


def test_the_clock():
    """Bit-identical: stamps are integer nanoseconds, and only their differences are converted to seconds."""
    shift_ns = 1_700_000_000_123_456_789
    done = segment(replace(recorded(), stamp_ns=recorded().stamp_ns + shift_ns), MODEL)
    np.testing.assert_array_equal(done.beliefs.probability, expected().beliefs.probability)
    np.testing.assert_array_equal(done.filtered.probability, expected().filtered.probability)
    assert [b.onset_ns - shift_ns for b in done.filtered] == [b.onset_ns for b in expected().filtered]


def test_the_frame_rate():
    """200 Hz thinned to 50 Hz: twice the noise, so that offsets of 2 and 3 mm standard deviation differ."""
    done = segment(recorded()[::4], MODEL)
    same_segments(done, ticks=1.0)
    assert difference(done).max() < 0.1
    same_geometry(done, within_m=0.02)


def test_the_direction_of_time():
    poses, stamps = recorded(), recorded().stamp_ns
    back = Poses(stamps[0] + stamps[-1] - stamps[::-1], poses.position_m[::-1], poses.quat_xyzw[::-1])
    done = segment(back, MODEL)
    assert [s.contact for s in done.segments] == [s.contact for s in expected().segments][::-1]
    change_ns = stamps[0] + stamps[-1] - expected().segments[1].start_ns
    assert abs(done.segments[1].start_ns - change_ns) <= 3 * TICK_NS
    backwards = replace(done, beliefs=done.beliefs[::-1])
    assert np.mean(difference(backwards, stamp_ns=expected().stamp_ns)) < 0.15
