"""The Markov chain of the states, against the containment lattice written out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from contact_tracker import hmm
from contact_tracker.labels import STATES, Contact
from contact_tracker.model import load_model, preset_names
from contact_tracker.transitions import AT_REST, log_initial, log_stay, log_transition

MODEL = load_model()
FREE = Contact.FREE.column
# f-f > e-f > {v-f, e-e}, f-f > f-e > {f-v, e-e}; everything meets and leaves the surface
LIKELY = {
    "f-f": {"e-f", "f-e", "free"},
    "e-f": {"f-f", "v-f", "e-e", "free"},
    "f-e": {"f-f", "f-v", "e-e", "free"},
    "v-f": {"e-f", "free"},
    "f-v": {"f-e", "free"},
    "e-e": {"e-f", "f-e", "free"},
    "free": {"f-f", "e-f", "f-e", "v-f", "f-v", "e-e"},
}

each_preset = pytest.mark.parametrize("name", preset_names())


@each_preset
@pytest.mark.parametrize("activity", [0.0, 0.3, 1.0])
def test_nothing_is_impossible_and_everything_is_a_probability(name, activity):
    model = load_model(name)
    leave = np.exp(log_transition(model, activity))
    assert np.isfinite(log_transition(model, activity)).all()
    assert np.exp(log_initial(model)).sum() == pytest.approx(1.0)
    assert np.isfinite(log_initial(model)).all()
    stay = np.exp(log_stay(model, activity))
    share = max(activity, AT_REST)
    assert stay == pytest.approx(np.exp(-model.transitions.leave_per_s * model.tick_s * share))
    contacts = np.arange(len(STATES)) != FREE
    np.testing.assert_allclose(leave[contacts].sum(axis=1), 1.0 - stay)
    assert leave[FREE, FREE] == pytest.approx(stay)
    assert leave[FREE].sum() == pytest.approx(1.0)


def test_one_step_of_the_lattice_is_likely_and_a_skip_is_rarer():
    leave = np.exp(log_transition(MODEL, 1.0))
    for a in STATES:
        likely = {b.value for b in STATES if b is not a and leave[a.column, b.column] > 0.9 * _most(leave, a)}
        assert likely == LIKELY[a.value]
        for b in STATES:
            share = leave[a.column, b.column] / _most(leave, a)
            if b.value in LIKELY[a.value]:
                assert share == pytest.approx(1.0)
            elif b is not a:
                assert share == pytest.approx(MODEL.transitions.skip)
            elif a is not Contact.FREE:  # the same contact with other elements
                assert share == pytest.approx(MODEL.transitions.skip**2)


def _most(leave, a):
    return max(leave[a.column, b.column] for b in STATES if b is not a)


def test_recordings_begin_as_the_model_says():
    initial = np.exp(log_initial(MODEL))
    assert initial[Contact.FF.column] == pytest.approx(MODEL.transitions.initial_f_f)
    np.testing.assert_allclose(initial[1:], (1.0 - MODEL.transitions.initial_f_f) / 6)


@pytest.mark.parametrize("tick_s", [0.05, 0.1, 0.4])
def test_without_data_the_chain_stays_a_probability_and_forgets_at_its_rate(tick_s):
    """Nothing speaks for or against any hypothesis: staying is paid for in each tick but the first."""
    model, rng = replace(MODEL, tick_s=tick_s), np.random.default_rng(0)
    ticks, states = 12, len(STATES)
    activity = rng.choice([0.0, 0.5, 1.0], ticks)
    stay = np.array([log_stay(model, a) for a in activity])
    change = np.array([log_transition(model, a) for a in activity])
    state, onset = np.tile(np.arange(states), ticks), np.repeat(np.arange(ticks), states)
    alive = [np.flatnonzero((onset < b) & ((state != FREE) | (onset == b - 1))) for b in range(1, ticks + 1)]
    stays = [np.array([stay[onset[h] + 1 : b].sum() for h in a]) for b, a in enumerate(alive, start=1)]
    trellis = hmm.Trellis(state, onset, alive, stays)
    posterior, log_evidence = hmm.smooth(trellis, log_initial(model), change)
    assert log_evidence == pytest.approx(0.0, abs=1e-12)
    expected = [np.exp(log_initial(model))]
    for t in range(1, ticks):
        keep = np.where(np.arange(states) == FREE, 0.0, np.exp(stay[t]))
        expected.append(expected[-1] @ (np.exp(change[t]) + np.diag(keep)))
    np.testing.assert_allclose(posterior, expected, atol=1e-12)


def test_time_scales_do_not_depend_on_the_tick():
    """Leaving within a second is as probable with ten ticks as with one."""
    fine, coarse = replace(MODEL, tick_s=0.1), replace(MODEL, tick_s=1.0)
    assert 10 * log_stay(fine, 1.0) == pytest.approx(log_stay(coarse, 1.0))


def test_at_rest_contacts_hardly_change():
    assert log_stay(MODEL, 0.0) == pytest.approx(AT_REST * log_stay(MODEL, 1.0))
    assert AT_REST < 0.1
