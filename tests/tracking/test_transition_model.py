"""The Markov chain of the states, against the containment lattice written out by hand."""

from collections import Counter
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from scipy.stats import binomtest, nbinom

from contact_tracker.config import preset_names
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import TransitionCounts
from contact_tracker.recording import read_truth
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.transition_model import (
    LIFTED_AFTER_REST,
    PACE_SHAPE,
    REST_EXPOSURE,
    destinations,
    initial,
    leave_per_s,
    lift_after_rest,
    log_initial,
    tick_transitions,
)

NOTHING = TransitionCounts((0.0,) * 7, (0.0,) * 7, ((0.0,) * 7,) * 7)
MODEL = replace(load_model(), transitions=replace(load_model().transitions, counts=NOTHING))
FREE = Contact.FREE.column
# f-f > e-f > {v-f, e-e}, f-f > f-e > {f-v, e-e}; free is a neighbour of all
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
def test_all_changes_have_positive_probabilities(name, activity):
    model = load_model(name)
    exposed = max(activity, REST_EXPOSURE)
    leave = np.exp(tick_transitions(model, exposed).log_transition)
    assert np.isfinite(tick_transitions(model, exposed).log_transition).all()
    assert np.exp(log_initial(model)).sum() == pytest.approx(1.0)
    assert np.isfinite(log_initial(model)).all()
    stay = np.exp(tick_transitions(model, exposed).log_survival)
    np.testing.assert_allclose(stay, np.exp(-leave_per_s(model.transitions) * model.tick_s * exposed))
    contacts = np.arange(len(STATES)) != FREE
    np.testing.assert_allclose(leave[contacts].sum(axis=1), 1.0 - stay[contacts])
    assert leave[FREE, FREE] == pytest.approx(stay[FREE])
    assert leave[FREE].sum() == pytest.approx(1.0)


def test_one_step_of_the_lattice_is_likely_and_a_skip_is_rarer():
    leave = np.exp(tick_transitions(MODEL, 1.0).log_transition)
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


def test_observed_changes_outweigh_the_lattice_prior_by_count():
    """Against the posterior means of gamma and Dirichlet distributions, by their integrals."""
    changes = np.zeros((7, 7))
    changes[0, 1], changes[0, 6] = 30.0, 10.0
    counted = TransitionCounts((0.0,) * 6 + (60.0,), (50.0, *(0.0,) * 6), tuple(map(tuple, changes.tolist())))
    prior = replace(MODEL.transitions, prior_changes=20.0)
    learned = replace(prior, counts=counted)
    before, after = destinations(prior), destinations(learned)
    np.testing.assert_allclose(after[1:], before[1:])
    np.testing.assert_allclose(after[0], (before[0] * 20.0 + changes[0]) / 60.0)
    np.testing.assert_allclose(initial(learned), (initial(prior) * 20.0 + counted.begins) / 80.0)
    rate = leave_per_s(learned)
    grid = np.linspace(1e-6, 3.0, 200_001)
    log_weight = (20.0 + 40.0 - 1.0) * np.log(grid) - (20.0 / prior.leave_per_s + 50.0) * grid
    weight = np.exp(log_weight - log_weight.max())
    assert rate[0] == pytest.approx(float(grid @ weight / weight.sum()), rel=1e-6)
    np.testing.assert_allclose(rate[1:], prior.leave_per_s)


@pytest.mark.parametrize("exposed", [1.5, 30.0, 600.0])
def test_after_a_long_rest_states_may_have_changed_more_than_once(exposed):
    contacts = np.arange(len(STATES)) != FREE
    step = np.exp(tick_transitions(MODEL, 1e-3).log_transition) + np.diag(
        contacts * np.exp(tick_transitions(MODEL, 1e-3).log_survival)
    )
    chain = np.linalg.matrix_power(step, round(exposed / 1e-3))
    jump = np.exp(tick_transitions(MODEL, exposed).log_transition) + np.diag(
        contacts * np.exp(tick_transitions(MODEL, exposed).log_survival)
    )
    np.testing.assert_allclose(jump, chain, atol=1e-3)
    np.testing.assert_allclose(jump.sum(axis=1), 1.0)


@pytest.mark.parametrize("name", preset_names())
def test_what_stands_is_mostly_lifted_and_what_is_held_is_not_let_go(name):
    ordinary = tick_transitions(load_model(name), 0.1)
    at_end = lift_after_rest(ordinary)
    gained = np.exp(at_end.log_transition) - np.exp(ordinary.log_transition)
    stays = np.exp(at_end.log_survival - ordinary.log_survival)
    np.testing.assert_allclose(stays, [1.0 - LIFTED_AFTER_REST, *[1.0] * 6], atol=1e-12)
    assert gained[0, -1] > 0.6
    assert (gained[0, :-1] <= 0.0).all()
    np.testing.assert_array_equal(gained[1:], 0.0)
    from_faces = np.exp(at_end.log_transition[0]).sum() + np.exp(at_end.log_survival[0])
    np.testing.assert_allclose(
        from_faces, np.exp(ordinary.log_transition[0]).sum() + np.exp(ordinary.log_survival[0])
    )


def ends_of_rests(truth):
    """The contact of each rest of a second or more that goes on to another motion, and what follows it."""
    known = [interval for interval in truth.intervals if interval.contact is not None]
    for (contact, motion), rest in groupby(known, lambda one: (one.contact, one.motion)):
        rest = list(rest)
        following = known.index(rest[-1]) + 1
        is_long = rest[-1].end_ns - rest[0].start_ns >= 1_000_000_000
        if motion == "rest" and contact is not Contact.FREE and is_long and following < len(known):
            yield contact, known[following].contact


def test_the_probability_of_a_lift_is_as_often_as_recordings_with_truth_show(shared_recordings):
    ends = Counter(
        (contact is Contact.FF, "lifted" if following is Contact.FREE else following is contact)
        for path in (*shared_recordings.glob("everyday/*.mcap"), *shared_recordings.glob("physics/*/*.mcap"))
        for contact, following in ends_of_rests(read_truth(str(path)))
    )
    assert set(ends) == {(True, "lifted"), (True, True), (False, True)}
    lifts = binomtest(ends[True, "lifted"], ends[True, "lifted"] + ends[True, True])
    assert lifts.proportion_ci(0.5).low < LIFTED_AFTER_REST < lifts.proportion_ci(0.5).high


def true_changes(truth, rate_per_s):
    """The number of changes between phases of 0.1 s or more, and the number that rates let expect."""
    known = [one for one in truth.intervals if one.contact is not None and one.end_ns - one.start_ns >= 1e8]
    expected = sum(
        rate_per_s[one.contact.column] * (one.end_ns - one.start_ns) * 1e-9
        for one in known
        if one.motion != "rest"
    )
    return len(list(groupby(one.contact for one in known))) - 1, expected


def test_the_pace_varies_as_much_as_recordings_with_truth_show(shared_recordings):
    """Changes of a recording are Poisson with its own pace: over recordings negative binomial."""
    rate_per_s = leave_per_s(load_model().transitions)
    paths = *shared_recordings.glob("everyday/*.mcap"), *shared_recordings.glob("physics/*/*.mcap")
    changes, expected = np.array([true_changes(read_truth(str(path)), rate_per_s) for path in paths]).T

    def log_likelihood(shape):
        return nbinom.logpmf(changes, shape, shape / (shape + expected)).sum()

    best = max(map(log_likelihood, np.geomspace(0.2, 20.0, 60)))
    assert log_likelihood(PACE_SHAPE) > best - 0.5
    assert log_likelihood(PACE_SHAPE) > log_likelihood(1e4) + 50.0  # one pace for all
