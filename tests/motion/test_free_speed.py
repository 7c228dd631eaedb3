"""The speed of free motion: evidence for it, learned from the recording."""

from itertools import groupby
from statistics import fmean, stdev

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_tracker.motion.free_speed import (
    CONTACT_SLOWER,
    CONTACT_SPREAD,
    FREE_SPREAD,
    NOT_WEIGHED,
    USUAL,
    USUAL_SPREAD,
    FreeSpeed,
)
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.states import Contact

SPEEDS = st.floats(0.0, 50.0)
STRETCH = st.lists(SPEEDS, min_size=1, max_size=30)
PROBABILITIES = st.floats(0.0, 1.0)


def after(speeds, p_free=1.0, start=None):
    """The speed of free motion after ticks with these speeds (m/s), and the evidence of each (nats)."""
    state, evidence = start or FreeSpeed(), []
    for speed in speeds:
        evidence.append(state.added_evidence(speed))
        state = state.update(speed, p_free)
    return state, evidence


@given(STRETCH, PROBABILITIES)
def test_no_speed_is_evidence_against_free_motion(speeds, p_free):
    assert min(after(speeds, p_free)[1]) >= 0.0


@given(SPEEDS, SPEEDS)
def test_faster_motion_is_no_less_evidence(a, b):
    slow, fast = sorted((a, b))
    assert FreeSpeed().added_evidence(slow) <= FreeSpeed().added_evidence(fast)


@given(st.lists(st.floats(0.6, 50.0), min_size=1, max_size=30))
def test_a_stretch_is_as_much_evidence_as_its_largest_speed_however_long_it_lasts(speeds):
    assert sum(after(speeds)[1]) == pytest.approx(FreeSpeed().added_evidence(max(speeds)), abs=1e-9)


@given(STRETCH)
def test_motion_in_contact_does_not_change_the_speed_of_free_motion(speeds):
    state, _ = after([*speeds, 0.0], p_free=0.0)
    assert (state.mean, state.variance) == pytest.approx((USUAL, USUAL_SPREAD**2))


@given(STRETCH)
def test_where_speed_is_not_weighed_none_is_evidence(speeds):
    state, evidence = after(speeds, start=NOT_WEIGHED)
    assert not any(evidence)
    assert state == NOT_WEIGHED


@pytest.mark.parametrize("usual_m_s", [0.45, 0.8, 1.5])
def test_the_speed_of_free_motion_is_learned_from_the_recording(usual_m_s):
    learned, _ = after([usual_m_s, 0.0] * 20)
    assert np.exp(learned.mean) == pytest.approx(usual_m_s, rel=0.1)
    assert learned.added_evidence(0.4 * usual_m_s) == 0.0
    assert 1.5 < learned.added_evidence(usual_m_s) < 4.0


def peak_speeds(path):
    """Log of the speed (m/s) that is exceeded for a tenth of each phase with known contact, whether it is
    free, and for free phases the mean over the recording."""
    poses, truth = Poses.collect(open_log(str(path))), read_truth(str(path))
    stamp_ns, rows = poses.stamp_ns, []
    for phase in truth.intervals:
        ticks = np.flatnonzero((stamp_ns >= phase.start_ns) & (stamp_ns < phase.end_ns))
        seconds = (phase.end_ns - phase.start_ns) * 1e-9
        ticks = ticks[:: max(round(len(ticks) / max(10.0 * seconds, 1.0)), 1)]
        if phase.contact is None or len(ticks) < 3:
            continue
        moved_m = np.linalg.norm(np.diff(poses.position_m[ticks], axis=0), axis=1)
        speed = np.percentile(moved_m / (np.diff(stamp_ns[ticks]) * 1e-9), 90.0)
        if speed > 0.02:
            rows.append((phase.contact is Contact.FREE, float(np.log(speed))))
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
