"""The online tracker: beliefs from past poses, in bounded memory and without side effects."""

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from contact_tracker.geometry.elements import Line, Plane, Point
from contact_tracker.motion.free_motion import SETTLING_TICKS
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.tick_grid import TickGrid
from contact_tracker.motion.window import rest_ticks
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.transition_model import REST_EXPOSURE, log_initial, tick_transitions
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import PoseFilter, after, forward
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, MODEL, age_s, recorded, segmented, true_contacts
from smooth_motion import moving

KINDS = {"f": Plane, "e": Line, "v": Point}
IDENTIFIABLE_S = {"f-f": 1.2, "e-f": 1.5, "f-e": 1.5, "e-e": 3.0}
TICK_NS = MODEL.tick_ns
each_recording = pytest.mark.parametrize("contacts", [FACE_TO_EDGE, EDGE_TO_EDGES])


def run(poses, model=MODEL):
    """All beliefs of a stream, including the last tick, and the state at its end."""
    one, beliefs = PoseFilter(model), []
    for pose in poses:
        beliefs += one.update(pose)
    return [*beliefs, *one.finish()], one


def same(a, b):
    """Whether two beliefs are bit-identical."""
    return a.to_json() == b.to_json() and np.array_equal(a.residual, b.residual, equal_nan=True)


@each_recording
def test_beliefs_are_well_formed(contacts):
    simulated, beliefs = recorded(contacts), segmented(contacts).filtered
    for belief, later in pairwise(beliefs):
        assert belief.stamp_ns < later.stamp_ns
    assert beliefs[-1].stamp_ns == simulated.poses.stamp_ns[-1]
    for belief in beliefs:
        assert belief.probability.shape == (len(STATES),)
        assert belief.probability.sum() == pytest.approx(1.0)
        assert belief.probability.min() >= 0.0
        assert belief.contact is STATES[int(np.argmax(belief.probability))]
        assert simulated.poses.stamp_ns[0] <= belief.onset_ns <= belief.stamp_ns
        assert belief.residual.shape == (len(CONTACTS),)
        json.dumps(belief.to_json(), allow_nan=False)
        if belief.contact is Contact.FREE:
            assert belief.geometry is None
            continue
        for kind, element in zip(
            (belief.contact.value[0], belief.contact.value[2]),
            (belief.geometry.object, belief.geometry.environment),
            strict=True,
        ):
            assert isinstance(element, KINDS[kind])
            assert np.linalg.eigvalsh(element.covariance).min() > -1e-7
            if not isinstance(element, Point):
                axis = element.normal if isinstance(element, Plane) else element.direction
                assert axis.max() == np.abs(axis).max(), "the canonical sign"


@each_recording
def test_the_contact_is_known_once_the_motion_shows_it(contacts):
    simulated, beliefs = recorded(contacts), segmented(contacts).filtered
    stamps = np.array([b.stamp_ns for b in beliefs])
    held, age = true_contacts(simulated, stamps), age_s(simulated, stamps)
    shown = [k for k, contact in enumerate(held) if age[k] > IDENTIFIABLE_S[contact.value]]
    assert len(shown) > 0.4 * len(beliefs)
    right = [beliefs[k].contact is held[k] for k in shown]
    assert np.mean(right) >= 0.97
    surprise = [-np.log(beliefs[k].probability[held[k].column]) for k in shown]
    assert np.mean(surprise) < 0.2


@each_recording
def test_onsets_are_estimated_at_the_true_times(contacts):
    simulated, last = recorded(contacts), segmented(contacts).filtered[-1]
    began = simulated.truth.intervals[-1].start_ns
    assert abs(last.onset_ns - began) < 0.3e9


def test_free_motion_begins_where_it_was_first_reported():
    beliefs, _ = run(moving(np.random.default_rng(3), 6.0, 100.0, 3e-4, 2.6e-3))
    both_free = [(a, b) for a, b in pairwise(beliefs) if a.contact is b.contact is Contact.FREE]
    assert len(both_free) > 5
    assert all(a.onset_ns == b.onset_ns for a, b in both_free)
    began = [b for a, b in pairwise(beliefs) if a.contact is not Contact.FREE and b.contact is Contact.FREE]
    assert all(0 <= b.stamp_ns - b.onset_ns <= MODEL.tick_s * 1e9 for b in began)


def test_the_tick_since_when_it_is_free_is_known_across_a_long_gap():
    """Only the beginning of the gap is tracked tick by tick."""
    poses = moving(np.random.default_rng(3), 6.0, 100.0, 3e-4, 2.6e-3)
    torn = replace(poses, stamp_ns=poses.stamp_ns + (np.arange(len(poses)) >= 400) * 65 * 10**9)
    began_ns, across = [], 0
    for seen in forward(torn, MODEL):
        began_ns.append(seen.tick.start_ns)
        if seen.belief.contact is Contact.FREE:
            assert began_ns[seen.state.free_since] == seen.belief.onset_ns
            across += seen.belief.stamp_ns - seen.belief.onset_ns > 65 * 10**9
    assert across


def test_residuals_of_the_true_contact_are_at_the_noise():
    beliefs = segmented(FACE_TO_EDGE).filtered
    for contact in (Contact.FF, Contact.EF):
        last = [b for b in beliefs if b.contact is contact][-1]
        assert 0.7 < last.residual[contact.column] < 1.3


def test_beliefs_depend_on_past_poses_only():
    """Bit-identical for any later poses, or none."""
    simulated, beliefs = recorded(FACE_TO_EDGE), segmented(FACE_TO_EDGE).filtered
    cut = 411
    nonsense = simulated.poses[cut : cut + 100]
    nonsense = replace(nonsense, position_m=np.random.default_rng(0).normal(size=(100, 3)))
    early, _ = run([*simulated.poses[:cut], *nonsense])
    complete = [b for b in beliefs if b.stamp_ns < simulated.poses.stamp_ns[400]]
    assert len(complete) == 20
    assert all(same(a, b) for a, b in zip(complete, early, strict=False))
    assert not same(early[24], beliefs[24])


def test_online_steps_equal_the_filtered_beliefs_of_the_segmenter():
    simulated = recorded(FACE_TO_EDGE)
    beliefs, _ = run(simulated.poses[:310])
    filtered = segment(simulated.poses[:310], MODEL).filtered
    assert len(beliefs) == len(filtered) == 16
    assert all(same(a, b) for a, b in zip(beliefs, filtered, strict=True))


@pytest.fixture
def without_ambiguity(monkeypatch):
    """The raw posterior, without sharing among indistinguishable states."""
    monkeypatch.setattr(ambiguity, "freedom_of", lambda *_, **__: ambiguity.Freedom(False, False))
    monkeypatch.setattr(ambiguity, "with_rivals", lambda probability, *_: probability)
    monkeypatch.setattr(ambiguity, "others_at_rest", lambda *_: ())


def test_the_filter_equals_the_smoother_on_the_poses_so_far(without_ambiguity):
    """The recursion of the tracker against ``hmm.smooth`` of the same hypotheses, after each tick."""
    poses = recorded(FACE_TO_EDGE).poses[300:500]
    for ticks in range(1, 11):
        seen = segment(poses[: 20 * ticks], MODEL)
        assert len(seen.filtered) == ticks
        np.testing.assert_allclose(seen.beliefs[-1].probability, seen.filtered[-1].probability, atol=1e-9)


def test_a_lag_equals_the_smoother_with_that_much_future(without_ambiguity):
    poses, lag = recorded(FACE_TO_EDGE).poses[300:500], 3
    one, found = PoseFilter(MODEL, lag * MODEL.tick_s), []
    for pose in poses:
        found += one.update(pose)
    found += one.finish()
    assert len(found) == 10
    for tick, belief in enumerate(found):
        seen = segment(poses[: 20 * min(tick + lag + 1, 10)], MODEL).beliefs[tick]
        assert belief.stamp_ns == seen.stamp_ns
        np.testing.assert_allclose(belief.probability, seen.probability, atol=1e-9)


def test_a_state_is_a_value():
    """The same step twice from one state gives the same result; earlier results are unchanged."""
    *before, last = forward(recorded(FACE_TO_EDGE).poses[:250], MODEL)
    state = before[-1].state
    kept = pickle.dumps(state)
    ends = [after(state, last.tick)[1] for _ in range(2)]
    assert pickle.dumps(state) == kept
    assert same(*ends)


def test_memory_is_bounded():
    """For an endless stream in one contact, whose onset is kept."""
    model = replace(MODEL, search=replace(MODEL.search, window_s=3.0))
    scenario = Scenario((Phase(Contact.FF, 24.0),), rate_hz=100.0)
    one, sizes = PoseFilter(model), []
    for pose in simulate(scenario, 1).poses:
        for belief in one.update(pose):
            last = belief
            sizes.append(len(pickle.dumps(one)) if len(sizes) % 5 == 0 else 0)
    assert len(one.state.window) == 30
    assert max(sizes[180:]) <= 1.3 * max(sizes[100:160])  # the number of hypotheses varies
    assert last.contact is Contact.FF


# --- streams as they come ---------------------------------------------------------------------------------


def still(count, rate_hz=200.0):
    stamps = (np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    return Poses(stamps, np.ones((count, 3)), np.tile([0.5, 0.5, 0.5, 0.5], (count, 1)))


def with_a_jump():
    poses = recorded(FACE_TO_EDGE).poses[:400]
    return replace(poses, position_m=poses.position_m + np.where(np.arange(400) > 200, 30.0, 0.0)[:, None])


STREAMS = {
    "without noise": lambda: moving(np.random.default_rng(1), 2.0, 200.0),
    "a frame per tick": lambda: moving(np.random.default_rng(1), 4.0, 9.0, 3e-4, 2e-3),
    "a jump of 30 m": with_a_jump,
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("stream", STREAMS)
def test_any_stream_gives_beliefs(stream):
    """No warning, no exception, no nan: a probability for every tick."""
    poses = STREAMS[stream]()
    beliefs, _ = run(poses)
    assert beliefs[-1].stamp_ns == poses.stamp_ns[-1]
    for belief in beliefs:
        assert belief.probability.sum() == pytest.approx(1.0)
        json.dumps(belief.to_json(), allow_nan=False)


def at_rest(ticks):
    """Beliefs (ticks, 7) of an object at rest, and those of the Markov chain alone."""
    beliefs, _ = run(still(20 * ticks))
    stay = np.diag(
        np.append(np.exp(tick_transitions(MODEL, REST_EXPOSURE).log_survival)[: len(CONTACTS)], 0.0)
    )
    step = np.exp(tick_transitions(MODEL, REST_EXPOSURE).log_transition) + stay
    chain = [np.exp(log_initial(MODEL)) @ np.linalg.matrix_power(step, t) for t in range(ticks)]
    return np.array([b.probability for b in beliefs]), np.array(chain)


def test_beliefs_at_rest_change_as_slowly_as_the_transition_model():
    """Until a rest is complete; what stays where it is by itself stands on a face, which is not certain."""
    posterior, chain = at_rest(40)
    rest = rest_ticks(MODEL.tick_s) - 1
    assert np.abs(posterior - chain)[:rest].max() < 0.1
    assert (posterior[rest:, Contact.FF.column] > posterior[rest - 1, Contact.FF.column] + 0.2).all()
    assert posterior[rest:].max() < 0.7


def test_a_tracker_without_poses_has_no_beliefs():
    one = PoseFilter(MODEL)
    assert one.finish() == []
    assert one.state.ticks == 0
    assert one.update(Pose(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))) == []


def test_finishing_twice_repeats_no_belief():
    beliefs, one = run(recorded(FACE_TO_EDGE).poses[:50])
    assert len(beliefs) == 3
    assert one.finish() == []


def in_parts(poses, cuts, lag_s=0.0):
    """All beliefs, including gaps, of a stream that was finished and continued at each of the ``cuts``."""
    one, beliefs = PoseFilter(MODEL, lag_s), []
    for first, end in pairwise([0, *cuts, len(poses)]):
        for pose in poses[first:end]:
            beliefs += one.update(pose)
        beliefs += one.finish()
    return beliefs


def test_poses_may_come_one_by_one_and_many_at_once():
    poses = recorded(FACE_TO_EDGE).poses[:200]
    grid, found = TickGrid(MODEL), []
    for first, end in pairwise([0, 1, 30, 33, 60, 61, 62, 200]):
        found += grid.add(poses[first:end])
    whole = TickGrid(MODEL).add(poses)
    assert [tick.count for tick in found] == [tick.count for tick in whole]
    np.testing.assert_array_equal([tick.zeta for tick in found], [tick.zeta for tick in whole])


def paused(at, pause_s):
    poses = recorded(FACE_TO_EDGE).poses[:300]
    return replace(poses, stamp_ns=poses.stamp_ns + (np.arange(300) >= at) * round(pause_s * 1e9))


@pytest.mark.parametrize("pause_s", [0.0, 2.0, 20.0])
def test_a_stream_continued_after_its_end_is_as_after_a_pause(pause_s):
    """After whole ticks: bit-identical to an uninterrupted stream."""
    poses = paused(100, pause_s)
    whole, parts = in_parts(poses, []), in_parts(poses, [100])
    assert len(whole) == len(parts) == 15 + min(round(pause_s / MODEL.tick_s), 49)
    assert all(same(a, b) for a, b in zip(whole, parts, strict=True))


@pytest.mark.parametrize("cuts", [[211], [211, 212]])
def test_an_end_within_a_tick_causes_no_jump(cuts):
    """For uniform motion: no outliers after it; the strength of motion is estimated again, as after a gap."""
    seconds = np.arange(800) / 200.0
    position_m = np.outer(seconds, [0.5, 0.0, 0.0]) + np.random.default_rng(0).normal(size=(800, 3)) * 3e-4
    poses = Poses((seconds * 1e9).astype(np.int64), position_m, np.tile([0.0, 0.0, 0.0, 1.0], (800, 1)))
    one = PoseFilter(MODEL)
    for first, end in pairwise([0, *cuts, 800]):
        for pose in poses[first:end]:
            one.update(pose)
        one.finish()
    state = one.state
    assert state.outliers == 0
    rest = 10 + len(cuts)  # the row of the rest of the tick; each end has added one
    assert not state.window.motion_ratio[rest : rest + SETTLING_TICKS].any()
    assert state.window.motion_ratio[rest + SETTLING_TICKS :].any()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lag_s", [0.0, 0.3])
@pytest.mark.parametrize("pause_s", [0.0, 0.03, 0.08, 2.0])
def test_a_pause_loses_and_repeats_no_belief(pause_s, lag_s):
    poses, cuts = paused(107, pause_s), [1, 107, 108, 181]
    beliefs = in_parts(poses, cuts, lag_s)
    stamps = np.array([belief.stamp_ns for belief in beliefs])
    assert (np.diff(stamps) > 0).all()
    assert set(poses.stamp_ns[np.array([*cuts, 300]) - 1]) <= set(stamps), "the last pose of each part"
    assert np.diff(stamps).max() < 2 * TICK_NS
    for belief in beliefs:
        json.dumps(belief.to_json(), allow_nan=False)
