"""Transitions learned from known states or beliefs, on chains of known rates."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from chain_oracle import N, noisy_trellis, prior, random_model, walk
from contact_tracker.config.parameters import TransitionCounts
from contact_tracker.tracking.transition_model import (
    REST_EXPOSURE,
    destinations,
    initial,
    leave_per_s,
    log_initial,
    tick_transitions,
)
from contact_tracker_lab.calibration.transitions import (
    UNKNOWN,
    EstimatedStates,
    KnownStates,
    count,
    learn_transitions,
    log_prior,
)


def chains(rng, model, count_, ticks, silence=0.0):
    """Runs of the chain, with rest, and some ticks without truth."""
    made = []
    for _ in range(count_):
        exposure = rng.choice([REST_EXPOSURE, 0.4, 1.0], ticks, p=[0.2, 0.3, 0.5])
        state = walk(model, exposure, rng)
        made.append(KnownStates(np.where(rng.random(ticks) < silence, UNKNOWN, state), exposure))
    return made


def test_rates_and_splits_of_a_simulated_chain_are_recovered():
    silence, runs_, least = 0.15, 10, 5.0
    rng = np.random.default_rng(4)
    true = random_model(rng, new_elements=False)
    learned = learn_transitions(prior(1e-3), chains(rng, true, runs_, 300, silence))[0].transitions
    changes = np.array(learned.counts.changes).sum(axis=1)
    assert changes.min() > least
    off = np.log(leave_per_s(learned) / leave_per_s(true.transitions))
    assert np.abs(off * np.sqrt(changes)).max() < 3.5  # standard deviations of a Poisson count
    p, q = destinations(true.transitions), destinations(learned)
    spread = np.sqrt(p * (1.0 - p) / changes[:, None]) + 1e-3
    assert np.abs((q - p) / spread).max() < 4.0
    assert np.abs(initial(learned) - initial(true.transitions)).max() < 4.0 * np.sqrt(0.25 / runs_)


def test_counts_of_known_states_are_counts():
    label = np.array([0, 0, 1, 1, 1, 6, 6, UNKNOWN])
    exposure = np.array([1.0, REST_EXPOSURE, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0])
    chain, model = KnownStates(label, exposure), prior()
    seen = count(model, [chain], [chain.expect(model)])
    assert seen.begins == (1.0, *(0.0,) * 6)
    assert np.argwhere(seen.changes).tolist() == [[0, 1], [1, 6]]
    rest = 0.1 * REST_EXPOSURE
    expected = [rest + 0.05, 0.1 + 0.05 + 0.05, 0.0, 0.0, 0.0, 0.0, 0.1]
    np.testing.assert_allclose(seen.moving_s, expected, rtol=5e-3)


def test_a_state_left_within_a_tick_lasted_for_the_mean_of_the_truncated_exponential():
    model = random_model(np.random.default_rng(0), leave_per_s=9.0)
    chain = KnownStates(np.array([0, 1]), np.ones(2))
    lasted = count(model, [chain], [chain.expect(model)]).moving_s[0]
    times = (np.arange(100_000) + 0.5) / 100_000 * model.tick_s
    weight = np.exp(-leave_per_s(model.transitions)[0] * times)
    assert lasted == pytest.approx(float(times @ weight / weight.sum()), rel=1e-6)


def test_gaps_in_the_truth_sum_over_all_paths():
    model, exposure = random_model(np.random.default_rng(2)), np.array([1.0, 0.3, 1.0, REST_EXPOSURE, 0.7])
    label = np.array([3, UNKNOWN, UNKNOWN, UNKNOWN, 1])
    steps = np.exp([tick_transitions(model, a).log_transition for a in exposure])
    for step, a in zip(steps, exposure, strict=True):
        np.fill_diagonal(step, np.exp(tick_transitions(model, a).log_survival))
    total, changes, stays = 0.0, np.zeros((5, N, N)), np.zeros((5, N))
    for between in product(range(N), repeat=3):
        path = [3, *between, 1]
        weight = np.prod([steps[t, path[t - 1], path[t]] for t in range(1, 5)])
        total += weight
        for t in range(1, 5):
            if path[t - 1] == path[t]:
                stays[t, path[t]] += weight
            else:
                changes[t, path[t - 1], path[t]] += weight
    expected = KnownStates(label, exposure).expect(model)
    np.testing.assert_allclose(expected.changes, changes / total, atol=1e-12)
    np.testing.assert_allclose(expected.stays, stays / total, atol=1e-12)
    assert expected.log_evidence == pytest.approx(np.log(total) + log_initial(model)[3])


def test_partial_truth_is_learned_from_in_its_part_only():
    rng = np.random.default_rng(5)
    whole = chains(rng, random_model(rng), 1, 60)[0]
    part = whole.label.copy()
    part[:20] = part[45:] = UNKNOWN
    model = prior()
    expected = KnownStates(part, whole.exposure).expect(model)
    inner = KnownStates(whole.label[20:45], whole.exposure[20:45]).expect(model)
    np.testing.assert_array_equal(expected.changes[21:45], inner.changes[1:])
    assert expected.changes.sum() == inner.changes.sum()
    assert expected.stays.sum() == inner.stays.sum()
    assert not expected.begins.any()  # how it began is unknown


def believed(known, start, rng, blur):
    trellis = noisy_trellis(known.label, start, known.exposure, rng, blur)
    return EstimatedStates.of(trellis, known.exposure, start)


def believed_chains(rng, true, start, blur, count_=6, ticks=60):
    return [believed(known, start, rng, blur) for known in chains(rng, true, count_, ticks)]


def test_em_increases_the_posterior_up_to_its_maximum():
    rng = np.random.default_rng(6)
    start = prior(20.0)
    some = [*believed_chains(rng, random_model(rng), start, 0.7), *chains(rng, random_model(rng), 2, 60, 0.3)]
    learned, log_posteriors = learn_transitions(start, some)
    assert len(log_posteriors) > 4
    assert (np.diff(log_posteriors) > -1e-9).all()
    assert log_posteriors[-1] > log_posteriors[0] + 1.0

    def log_posterior(model):
        return sum(chain.expect(model).log_evidence for chain in some) + log_prior(model)

    top = log_posterior(learned)
    assert top == pytest.approx(log_posteriors[-1], abs=0.01)
    for _ in range(8):  # any other transitions are less probable
        seen = learned.transitions.counts
        moved = TransitionCounts(
            tuple(np.array(seen.begins) * np.exp(rng.normal(size=N) * 0.3)),
            tuple(np.array(seen.moving_s) * np.exp(rng.normal(size=N) * 0.3)),
            tuple(map(tuple, (np.array(seen.changes) * np.exp(rng.normal(size=(N, N)) * 0.3)).tolist())),
        )
        other = replace(learned, transitions=replace(learned.transitions, counts=moved))
        assert log_posterior(other) < top
