"""The speed of free motion: evidence for it, learned from the recording."""

from itertools import groupby
from statistics import fmean, stdev

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.motion.free_speed import (
    CONTACT_SLOWER,
    CONTACT_SPREAD,
    FREE_SPREAD,
    USUAL,
    USUAL_SPREAD,
    FreeSpeed,
)
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import Contact
from contact_tracker.tracker import Tracker
from smooth_motion import with_noise

LOG_SPEEDS = st.floats(-10.0, 4.0)
STRETCH = st.lists(LOG_SPEEDS, min_size=1, max_size=30)
PROBABILITIES = st.floats(0.0, 1.0)
SLOW = -10.0


def after(log_speeds, p_free=1.0):
    """The speed of free motion after ticks with these speeds, and the evidence (nats) of each."""
    state, evidence = FreeSpeed(), []
    for log_speed in log_speeds:
        evidence.append(state.added_evidence(log_speed))
        state = state.update(log_speed, p_free)
    return state, evidence


@given(STRETCH, PROBABILITIES)
def test_no_speed_is_evidence_against_free_motion(log_speeds, p_free):
    assert min(after(log_speeds, p_free)[1]) >= 0.0


@given(LOG_SPEEDS, LOG_SPEEDS)
def test_faster_motion_is_no_less_evidence(a, b):
    slow, fast = sorted((a, b))
    assert FreeSpeed().evidence(slow) <= FreeSpeed().evidence(fast) + 1e-12


@given(STRETCH, st.floats(0.0, 0.49))
def test_a_contact_counts_its_largest_speed_once_however_often_it_is_reached(log_speeds, p_free):
    strokes = [speed for log_speed in log_speeds for speed in (log_speed, SLOW)]
    state, evidence = after(strokes, p_free)
    assert sum(evidence) == pytest.approx(FreeSpeed().evidence(max(log_speeds)), abs=1e-9)
    assert (state.mean, state.variance) == (USUAL, USUAL_SPREAD**2)  # of free motion nothing is learned


def test_each_stretch_of_free_motion_counts():
    _, evidence = after([0.0, SLOW, 0.0])
    assert min(evidence[0], evidence[2]) > 1.0


@pytest.mark.parametrize("usual_m_s", [0.45, 0.8, 1.5])
def test_the_speed_of_free_motion_is_learned_from_the_recording(usual_m_s):
    learned, _ = after([np.log(usual_m_s), SLOW] * 20)
    assert np.exp(learned.mean) == pytest.approx(usual_m_s, rel=0.1)
    assert learned.evidence(np.log(0.4 * usual_m_s)) == 0.0
    assert 1.5 < learned.evidence(np.log(usual_m_s)) < 4.0


def strokes(tip_m):
    """Poses of a body that is swung to and fro at up to 1 m/s about its point ``tip_m`` (3,), which moves on
    the plane z = 0, and is turned about all axes."""
    rng, time_s, rate = np.random.default_rng(0), np.arange(0.0, 14.0, 1.0 / 120.0), 5.0
    yaw, pitch = 0.5 * np.sin(0.5 * rate * time_s), 0.3 + 0.15 * np.sin(0.8 * rate * time_s)
    turn = Rotation.from_euler("zyx", np.column_stack([yaw, pitch, 0.1 * np.sin(0.6 * rate * time_s + 2.0)]))
    across = 0.1 * np.sin(0.37 * rate * time_s)
    place_m = np.column_stack([0.2 * np.sin(rate * time_s), across, np.zeros_like(time_s)])
    return with_noise(rng, time_s, place_m - turn.apply(tip_m), turn, 3e-4, 2e-3)


def test_a_vertex_that_wipes_as_fast_as_objects_are_carried_stays_a_vertex_on_a_face():
    tracker = Tracker.start(load_model())
    beliefs = [belief for pose in strokes([0.0, 0.0, -0.15]) for belief in tracker.add(pose)]
    later = np.array([belief.probability for belief in beliefs[len(beliefs) // 2 :]])
    assert later[:, Contact.VF.column].mean() > 0.8


def peak_speeds(path):
    """For each phase with known contact in which the object moves: whether it is free motion, and the log of
    its largest speed (m/s) over 0.1 s."""
    poses, truth = Poses.collect(open_log(str(path))), read_truth(str(path))
    stamp_ns, rows = poses.stamp_ns, []
    for phase in truth.intervals:
        ticks = np.flatnonzero((stamp_ns >= phase.start_ns) & (stamp_ns < phase.end_ns))
        seconds = (phase.end_ns - phase.start_ns) * 1e-9
        ticks = ticks[:: max(round(len(ticks) / max(10.0 * seconds, 1.0)), 1)]
        if phase.contact is None or len(ticks) < 3:
            continue
        moved_m = np.linalg.norm(np.diff(poses.position_m[ticks], axis=0), axis=1)
        speed = moved_m / (np.diff(stamp_ns[ticks]) * 1e-9)
        if np.percentile(speed, 90.0) > 0.02:
            rows.append((phase.contact is Contact.FREE, float(np.log(speed.max()))))
    return rows


@pytest.mark.long
def test_speeds_in_contact_and_in_free_motion_are_as_recordings_with_truth_show(shared_recordings):
    recordings = [
        {
            is_free: [speed for _, speed in rows]
            for is_free, rows in groupby(sorted(peak_speeds(path)), lambda row: row[0])
        }
        for path in (*shared_recordings.glob("everyday/*.mcap"), *shared_recordings.glob("physics/*/*.mcap"))
    ]
    known = [speeds for speeds in recordings if len(speeds.get(True, [])) > 1 and False in speeds]
    means = [fmean(speeds[True]) for speeds in known]
    slower = [speed - mean for speeds, mean in zip(known, means, strict=True) for speed in speeds[False]]
    within = [speed - mean for speeds, mean in zip(known, means, strict=True) for speed in speeds[True]]
    assert len(known) > 30
    assert fmean(means) == pytest.approx(USUAL, abs=0.05)
    assert stdev(means) < USUAL_SPREAD
    assert stdev(within) == pytest.approx(FREE_SPREAD, abs=0.02)
    assert -fmean(slower) == pytest.approx(CONTACT_SLOWER, abs=0.05)
    assert stdev(slower) == pytest.approx(CONTACT_SPREAD, abs=0.02)
