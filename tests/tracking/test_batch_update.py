"""Updates by several ticks equal those by single ticks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.bank_update import MOST
from contact_tracker.hypotheses.tick_update import StopCondition
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.map.sighting import MAP_INSERTION_PROBABILITY
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.tracking import batch_update, tracker
from contact_tracker.tracking.batch_update import update_in_batches
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.forward_pass import filter_batches, forward
from contact_tracker.tracking.measurement_update import advanced_window, predict
from contact_tracker.tracking.state import scales_of
from cube_on_table import CUBE_ON_TABLE
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, MODEL, recorded

pytest.importorskip("contact_tracker.hypotheses.compiled.kernels")
SECOND = 1_000_000_000


def with_a_rest():
    """Motion, long rest without information, a gap, and motion again."""
    poses = recorded(FACE_TO_EDGE).poses[:900]
    held = np.concatenate([np.arange(450), np.full(400, 449), np.arange(450, 900)])
    gap = np.repeat([0, 2 * SECOND], [850, len(held) - 850])
    stamp_ns = poses.stamp_ns[0] + np.arange(len(held)) * (SECOND // 200) + gap
    return Poses(stamp_ns, poses.position_m[held], poses.quat_xyzw[held])


RECORDINGS = {
    "contacts": (recorded(FACE_TO_EDGE).poses[:1200], EMPTY_MAP),
    "edges": (recorded(EDGE_TO_EDGES).poses[:900], EMPTY_MAP),
    "rest and gap": (with_a_rest(), EMPTY_MAP),
    "known elements": (recorded(FACE_TO_EDGE).poses[:300], CUBE_ON_TABLE),
}


@cache
def one_by_one(name):
    poses, known_map = RECORDINGS[name]
    return list(forward(poses, MODEL, known_map=known_map, detail=Detail.WEIGHTS))


@cache
def in_batches(name):
    poses, known_map = RECORDINGS[name]
    return list(filter_batches(poses, MODEL, known_map=known_map))


@pytest.mark.parametrize("name", RECORDINGS)
def test_results_do_not_depend_on_the_number_of_ticks_at_once(name):
    expected, found = one_by_one(name), in_batches(name)
    results = [tick_result for _, some in found for tick_result in some]
    assert [one.tick.stamp_ns for one in results] == [one.tick.stamp_ns for one in expected]
    for tick_result, one in zip(results, expected, strict=True):
        for name_ in ("log_birth_weight", "log_transition", "residual"):
            np.testing.assert_array_equal(getattr(tick_result, name_), getattr(one.tick_result, name_))
        for a, b in zip(tick_result.live_hypotheses, one.state.live_hypotheses, strict=True):
            np.testing.assert_array_equal(a, b)
    many = np.cumsum([len(some) for _, some in found])
    for end, (state, _) in zip(many, found, strict=True):  # intermediate states are equal, too
        then = expected[end - 1].state
        for ours, theirs in zip(state.banks, then.banks, strict=True):
            np.testing.assert_array_equal(ours.words, theirs.words)
            np.testing.assert_array_equal(ours.onsets.words, theirs.onsets.words)
        for field in (
            "ticks",
            "next_hypothesis_id",
            "outliers",
            "label",
            "free_since",
            "free_since_ns",
            "deferred_exposure",
            "hazard_exposure",
        ):
            assert getattr(state, field) == getattr(then, field), field
        for field in ("log_state_weight", "best_rows"):
            np.testing.assert_array_equal(getattr(state, field), getattr(then, field))
        assert (state.belief.stamp_ns, state.belief.onset_ns) == (then.belief.stamp_ns, then.belief.onset_ns)
        for ours, theirs in zip(state.cached_proposals, then.cached_proposals, strict=True):
            np.testing.assert_array_equal(ours.proposals.rows.words, theirs.proposals.rows.words)
        assert state.map.due_ns == then.map.due_ns
        np.testing.assert_array_equal(state.window.variance, then.window.variance)


def test_the_recordings_have_ticks_at_which_batches_end():
    """Sightings, uninformative ticks, and nearly all states."""
    resting = one_by_one("rest and gap")
    assert sum(results.state.deferred_exposure > 0.0 for results in resting) > 10
    assert sum(results.tick.count == 0 for results in resting) >= 5
    for name in ("contacts", "edges", "rest and gap"):
        assert len({tuple(results.state.map.due_ns.items()) for results in one_by_one(name)}) > 3
    assert {results.state.label for results in one_by_one("contacts")} >= {Contact.FF, Contact.EF}


def test_many_ticks_are_updated_at_once():
    sizes = [len(some) for _, some in in_batches("contacts")]
    assert MOST // 2 < max(sizes) <= MOST
    assert np.mean(sizes) > 3.0


def tick_inputs(k, count):
    """A state, and the inputs of the next ``count`` ticks."""
    results = one_by_one("contacts")
    state, inputs = results[k].state, []
    for later in results[k + 1 : k + 1 + count]:
        inputs.append(predict(state, later.tick, advanced_window(state, later.tick)).tick_input)
        state = later.state
    return results[k].state, inputs


@pytest.mark.parametrize("k", [1, 9, 24])
def test_a_batch_ends_at_the_first_possible_sighting(k):
    """The caller decides on the update by the belief; no tick with an update may be skipped."""
    state, inputs = tick_inputs(k, 20)
    results = one_by_one("contacts")[k + 1 : k + 21]
    weights = [np.exp(one.state.log_state_weight - one.state.log_state_weight.max()) for one in results]
    exponent = MODEL.certainty.posterior_power
    top = [(w**exponent).max() / (w**exponent).sum() for w in weights]
    given = (
        state.banks,
        inputs,
        MODEL.noise.extra_contact_variance,
        scales_of(MODEL),
        MODEL.search.margin_nats,
    )
    for probability in (0.5, 0.8, MAP_INSERTION_PROBABILITY, 0.99):
        for due in ({}, {results[10].belief.onset_ns: results[10].tick.stamp_ns}):
            current_ns = results[0].belief.onset_ns if results[0].belief.onset_ns in due else -1
            stops = [
                (one.belief.onset_ns if one.belief.onset_ns in due else -1) != current_ns
                or (
                    one.state.label is not Contact.FREE
                    and p >= probability
                    and one.tick.stamp_ns >= due.get(one.belief.onset_ns, 0)
                )
                for one, p in zip(results, top, strict=True)
            ]
            updated = bank_update.update(*given, StopCondition(probability, exponent, due, current_ns))
            assert len(updated.tick_weights) == ([*stops, True].index(True) + 1 if any(stops) else 20)
    assert len(bank_update.update(*given).tick_weights) == 20


def averaged(poses, state):
    """All ticks, as ``update_in_batches`` takes them; and the state in which averaging begins."""
    state, ticks = tracker.accumulate_poses(state, poses)
    return state, ticks


def test_with_a_lag_ticks_are_updated_one_by_one():
    """The kernels do not have the lag histories of hypotheses."""
    poses = recorded(FACE_TO_EDGE).poses[:400]
    start, ticks = averaged(poses, tracker.start(MODEL, lag_s=0.5))
    batches = list(update_in_batches(start, ticks))
    assert [len(results) for _, results in batches] == [1] * len(ticks)
    for tick, (state, _) in zip(ticks, batches, strict=True):
        start, _ = tracker.update(start, tick, Detail.WEIGHTS)
        np.testing.assert_array_equal(state.lag_history, start.lag_history)
        assert state.lag_history.any()


def test_windows_are_computed_for_a_few_ticks_ahead_only(monkeypatch):
    """Also if a batch of poses closes many ticks, as sparse poses do."""
    poses = recorded(FACE_TO_EDGE).poses[:400:40]
    stamp_ns = poses.stamp_ns[0] + 5 * SECOND * np.arange(len(poses))
    start, ticks = averaged(replace(poses, stamp_ns=stamp_ns), tracker.start(MODEL))
    assert len(ticks) > 400
    most, windows = [], batch_update._windows

    def counted(*args):
        found = windows(*args)
        most.append(len(found))
        return found

    monkeypatch.setattr(batch_update, "_windows", counted)
    assert sum(len(results) for _, results in update_in_batches(start, ticks)) == len(ticks)
    assert max(most) == MOST


def test_nan_weights_end_a_batch():
    """Also if the bank of the first contact with the largest weight is empty."""
    state, inputs = tick_inputs(9, 3)
    begins = (inputs[0].births.proposals[0].pick([]), *inputs[0].births.proposals[1:])
    births = inputs[0].births._replace(proposals=begins, log_birth_weight=np.full(7, np.nan))
    banks = (blank(CONTACT_MODELS[0], 0), *state.banks[1:])
    given = MODEL.noise.extra_contact_variance, scales_of(MODEL), MODEL.search.margin_nats
    updated = bank_update.update(
        banks,
        [inputs[0]._replace(births=births), *inputs[1:]],
        *given,
        StopCondition(MAP_INSERTION_PROBABILITY, 0.5, {}),
    )
    assert len(updated.tick_weights) == 1
