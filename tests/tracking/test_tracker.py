"""The online tracker: beliefs from past poses, in bounded memory and without side effects."""

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.elements import Line, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import rest_ticks
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.transition_model import REST_EXPOSURE, log_initial, tick_transitions
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import PoseFilter, forward
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, MODEL, age_s, recorded, segmented, true_contacts
from smooth_motion import moving, with_noise

KINDS = {"f": Plane, "e": Line, "v": Point}
IDENTIFIABLE_S = {"f-f": 1.2, "e-f": 1.5, "f-e": 1.5, "e-e": 3.0}
TICK_NS = MODEL.tick_ns
each_recording = pytest.mark.parametrize("contacts", [FACE_TO_EDGE, EDGE_TO_EDGES])


def in_parts(poses, cuts, lag_s=0.0):
    """All beliefs, including gaps, of a stream that was finished and continued at each of the ``cuts``."""
    one, beliefs = PoseFilter(MODEL, lag_s), []
    for first, end in pairwise([0, *cuts, len(poses)]):
        for pose in poses[first:end]:
            beliefs += one.update(pose)
        beliefs += one.finish()
    assert one.finish() == [], "finishing twice repeats no belief"
    return beliefs


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
    assert abs(beliefs[-1].onset_ns - simulated.truth.intervals[-1].start_ns) < 0.3e9
    if contacts == FACE_TO_EDGE:
        for contact in (Contact.FF, Contact.EF):  # residuals of the true contact are at the noise
            last = [b for b in beliefs if b.contact is contact][-1]
            assert 0.7 < last.residual[contact.column] < 1.3


def test_free_motion_begins_where_it_was_first_reported_also_across_a_long_gap():
    """Only the beginning of the gap is tracked tick by tick."""
    poses = moving(np.random.default_rng(3), 6.0, 100.0, 3e-4, 2.6e-3)
    torn = replace(poses, stamp_ns=poses.stamp_ns + (np.arange(len(poses)) >= 400) * 65 * 10**9)
    seen = list(forward(torn, MODEL))
    beliefs, across = [one.belief for one in seen], 0
    for number, (one, belief) in enumerate(zip(seen, beliefs, strict=True)):
        if belief.contact is Contact.FREE:
            assert seen[one.state.free_since].tick.start_ns == belief.onset_ns
            across += belief.stamp_ns - belief.onset_ns > 65 * 10**9
            if number and beliefs[number - 1].contact is not Contact.FREE:
                assert 0 <= belief.stamp_ns - belief.onset_ns <= TICK_NS
    assert across


@pytest.mark.parametrize("lag", [0, 3])
def test_the_filter_equals_the_smoother_with_as_much_future_as_its_lag(monkeypatch, lag):
    """The recursion of the tracker against ``smooth`` of the same hypotheses, after each tick."""
    monkeypatch.setattr(ambiguity, "freedom_of", lambda *_, **__: ambiguity.Freedom(False, False))
    monkeypatch.setattr(ambiguity, "with_rivals", lambda probability, *_: probability)
    monkeypatch.setattr(ambiguity, "others_at_rest", lambda *_: ())
    poses = recorded(FACE_TO_EDGE).poses[300:500]
    one, found = PoseFilter(MODEL, lag * MODEL.tick_s), []
    for pose in poses:
        found += one.update(pose)
    found += one.finish()
    assert len(found) == 10
    for tick in (0, 1, 4, 6, 8, 9):
        smoothed = segment(poses[: 20 * min(tick + lag + 1, 10)], MODEL).beliefs[tick]
        assert found[tick].stamp_ns == smoothed.stamp_ns
        np.testing.assert_allclose(found[tick].probability, smoothed.probability, atol=1e-9)


def test_memory_is_bounded():
    model = replace(MODEL, search=replace(MODEL.search, window_s=3.0))
    scenario = Scenario((Phase(Contact.FF, 16.0),), rate_hz=50.0)
    one, sizes = PoseFilter(model), []
    for pose in simulate(scenario, 1).poses:
        for belief in one.update(pose):
            last = belief
            sizes.append(len(pickle.dumps(one)) if len(sizes) % 5 == 0 else 0)
    assert len(one.state.window) == 30
    assert max(sizes[110:]) <= 1.3 * max(sizes[60:100])  # the number of hypotheses varies
    assert last.contact is Contact.FF


def test_beliefs_at_rest_change_as_slowly_as_the_transition_model():
    """Until a rest is complete; what stays where it is by itself stands on a face, which is not certain."""
    ticks, contacts = 40, np.arange(len(STATES)) < len(CONTACTS)
    stamps = (np.arange(20 * ticks) * 5e6).astype(np.int64)
    still = Poses(stamps, np.ones((20 * ticks, 3)), np.full((20 * ticks, 4), 0.5))
    posterior = np.array([belief.probability for belief in in_parts(still, [])])
    transitions = tick_transitions(MODEL, REST_EXPOSURE)
    step = np.exp(transitions.log_transition) + np.diag(contacts * np.exp(transitions.log_survival))
    chain = [np.exp(log_initial(MODEL)) @ np.linalg.matrix_power(step, t) for t in range(ticks)]
    rest = rest_ticks(MODEL.tick_s) - 1
    assert np.abs(posterior - np.array(chain))[:rest].max() < 0.1
    assert (posterior[rest:, Contact.FF.column] > posterior[rest - 1, Contact.FF.column] + 0.2).all()
    assert posterior[rest:].max() < 0.7


def paused(at, pause_s):
    poses = recorded(FACE_TO_EDGE).poses[:300]
    return replace(poses, stamp_ns=poses.stamp_ns + (np.arange(300) >= at) * round(pause_s * 1e9))


@pytest.mark.parametrize("pause_s", [0.0, 20.0])
def test_a_stream_continued_after_its_end_is_as_after_a_pause(pause_s):
    """After whole ticks: bit-identical to an uninterrupted stream."""
    poses = paused(100, pause_s)
    whole, parts = in_parts(poses, []), in_parts(poses, [100])
    assert len(whole) == len(parts) == 15 + min(round(pause_s / MODEL.tick_s), 49)
    assert [b.to_json() for b in whole] == [b.to_json() for b in parts]


@pytest.mark.filterwarnings("error")
def test_with_a_lag_every_contact_has_elements():
    """Also one that no belief since then has named."""
    poses = moving(np.random.default_rng(0), 12.0, 100.0, 3e-4, np.radians(0.15))
    beliefs = [belief for belief in in_parts(poses, [], 1.0) if belief.contact is not Contact.FREE]
    assert len(beliefs) > 10
    assert all(belief.geometry is not None for belief in beliefs)
    assert all(belief.onset_ns <= belief.stamp_ns for belief in beliefs)


def tilted_and_put_down() -> Poses:
    """A box slides on a table, stands, is tilted about an edge that does not slip, stands, and slides."""
    rng, time_s = np.random.default_rng(0), np.arange(1200) / 100.0
    slid_s = np.minimum(time_s, 4.0) + np.clip(time_s - 9.0, 0.0, None)
    share = np.clip((time_s - 4.5) / 3.5, 0.0, 1.0)
    yaw, tilt = 0.6 * np.sin(1.1 * slid_s), 0.7 * np.sin(np.pi * share) ** 2
    turn = Rotation.from_euler("ZX", np.column_stack([yaw, -tilt]))
    edge_m = np.column_stack([0.2 * np.sin(0.8 * slid_s), 0.15 * np.sin(1.3 * slid_s), 0.0 * time_s])
    return with_noise(rng, time_s, edge_m - turn.apply([0.0, -0.04, -0.03]), turn, 3e-4, 2e-3)


def test_a_box_that_was_tilted_surely_stands_on_its_table_only() -> None:
    """The turn about an edge is that of two faces across it as well, which its pose on the table does not
    confirm."""
    beliefs = [tick.belief for tick in forward(tilted_and_put_down(), MODEL) if tick.belief.stamp_ns > 5e9]
    sure = [one for one in beliefs if one.contact is Contact.FF and one.probability.max() > 0.9]
    assert sure
    for belief in sure:
        assert abs(belief.geometry.environment.normal[2]) > 0.99
