"""Smoothing, expected changes and Viterbi against enumeration of all paths."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker import hmm
from trellis_cases import Case

seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=40, deadline=None)


@many
@given(seed=seeds)
def test_posterior_and_evidence_are_the_sum_over_all_paths(seed):
    case = Case(seed)
    posterior, log_evidence = hmm.smooth(case.trellis, *case.model)
    paths = case.paths()
    weights = np.array([weight for weight, _ in paths])
    assert log_evidence == pytest.approx(np.logaddexp.reduce(weights), abs=1e-9)
    expected = np.zeros((case.ticks, case.states))
    for share, (_, segments) in zip(np.exp(weights - log_evidence), paths, strict=True):
        for h, onset, end in segments:
            expected[onset:end, case.state[h]] += share
    np.testing.assert_allclose(posterior, expected, atol=1e-9)
    np.testing.assert_allclose(posterior.sum(axis=1), 1.0)


@many
@given(seed=seeds)
def test_expected_changes_are_the_sum_over_all_paths(seed):
    case = Case(seed)
    posterior, changes, log_evidence = hmm.expect(case.trellis, *case.model)
    expected = np.zeros_like(changes)
    for weight, segments in case.paths():
        for (before, *_), (after, onset, _) in pairwise(segments):
            expected[onset, case.state[before], case.state[after]] += np.exp(weight - log_evidence)
    np.testing.assert_allclose(changes, expected, atol=1e-9)
    begun = np.diff(posterior, axis=0)  # probability that enters a state less that leaves it
    np.testing.assert_allclose(changes[1:].sum(axis=1) - changes[1:].sum(axis=2), begun, atol=1e-9)
    np.testing.assert_array_equal(posterior, hmm.smooth(case.trellis, *case.model)[0])


@many
@given(seed=seeds)
def test_viterbi_is_the_best_of_all_paths(seed):
    case = Case(seed)
    weight, segments = max(case.paths())
    assert np.isfinite(weight)
    assert hmm.viterbi(case.trellis, *case.model) == segments


@many
@given(seed=seeds)
def test_the_filter_is_the_smoother_of_the_data_so_far(seed):
    """The recursion of the online tracker, by ``enter`` and ``by_state``, against smoothing each prefix."""
    case = Case(seed)
    log_left, entry = case.log_initial, np.full(len(case.state), -np.inf)
    for b, (alive, likelihood) in enumerate(
        zip(case.trellis.alive, case.trellis.log_likelihood, strict=True), start=1
    ):
        fresh = hmm.birth_log_weights(log_left, case.log_transition[b - 1]) if b > 1 else log_left
        begins = alive[case.onset[alive] == b - 1]
        entry[begins] = fresh[case.state[begins]]
        log_left = hmm.by_state(entry[alive] + likelihood, case.state[alive], case.states)
        prefix = hmm.Trellis(case.state, case.onset, case.trellis.alive[:b], case.trellis.log_likelihood[:b])
        posterior, log_evidence = hmm.smooth(prefix, case.log_initial, case.log_transition[:b])
        assert log_evidence == pytest.approx(hmm.log_sum_exp(log_left), abs=1e-9)
        np.testing.assert_allclose(posterior[-1], np.exp(log_left - log_evidence), atol=1e-9)


@many
@given(seed=seeds)
def test_a_common_likelihood_factor_changes_the_evidence_only(seed):
    """Adding c_t nats to the likelihood of all hypotheses at tick t shifts the evidence, nothing else."""
    case = Case(seed)
    posterior, log_evidence = hmm.smooth(case.trellis, *case.model)
    path = hmm.viterbi(case.trellis, *case.model)
    offset = np.concatenate([[0.0], np.cumsum(np.random.default_rng(seed).normal(size=case.ticks) * 300.0)])
    case.value += offset - offset[case.onset][:, None]
    shifted, shifted_evidence = hmm.smooth(case.trellis, *case.model)
    np.testing.assert_allclose(shifted, posterior, atol=1e-9)
    assert shifted_evidence == pytest.approx(log_evidence + offset[-1], abs=1e-7)
    assert hmm.viterbi(case.trellis, *case.model) == path


@many
@given(seed=seeds)
def test_results_do_not_depend_on_the_order_of_hypotheses_and_states(seed):
    case, rng = Case(seed), np.random.default_rng(seed)
    posterior, log_evidence = hmm.smooth(case.trellis, *case.model)
    path = hmm.viterbi(case.trellis, *case.model)
    order, states = rng.permutation(len(case.state)), rng.permutation(case.states)
    name = np.argsort(order)
    case.onset, case.last, case.value = case.onset[order], case.last[order], case.value[order]
    case.state = np.argsort(states)[case.state[order]]
    case.log_initial, case.log_transition = (
        case.log_initial[states],
        case.log_transition[:, states][:, :, states],
    )
    renamed, renamed_evidence = hmm.smooth(case.trellis, *case.model)
    np.testing.assert_allclose(renamed, posterior[:, states], atol=1e-9)
    assert renamed_evidence == pytest.approx(log_evidence, abs=1e-9)
    assert hmm.viterbi(case.trellis, *case.model) == [(int(name[h]), a, b) for h, a, b in path]


@many
@given(seed=seeds)
def test_the_posterior_of_a_dominant_path_is_that_path(seed):
    case = Case(seed)
    case.value *= 1e4
    segments = hmm.viterbi(case.trellis, *case.model)
    posterior, _ = hmm.smooth(case.trellis, *case.model)
    weights = sorted(weight for weight, _ in case.paths())
    if len(weights) > 1 and weights[-1] - weights[-2] < 40.0:
        return
    expected = np.zeros_like(posterior)
    for h, onset, end in segments:
        expected[onset:end, case.state[h]] = 1.0
    np.testing.assert_allclose(posterior, expected, atol=1e-9)


def test_a_state_without_way_out_is_certain():
    ticks = 4
    trellis = hmm.Trellis(
        np.array([0, 1, 1, 1, 1]),
        np.array([0, 0, 1, 2, 3]),
        [np.array([0, 1 + t]) for t in range(ticks)],
        [np.array([-3.0 * (t + 1), 0.0]) for t in range(ticks)],
    )
    stuck = np.tile([[-np.inf, -np.inf], [-np.inf, 0.0]], (ticks, 1, 1))
    posterior, log_evidence = hmm.smooth(trellis, np.log([1.0, 1e-300]), stuck)
    assert log_evidence == pytest.approx(-12.0)
    np.testing.assert_allclose(posterior, [[1.0, 0.0]] * ticks, atol=1e-12)
    assert hmm.viterbi(trellis, np.log([1.0, 1e-300]), stuck) == [(0, 0, ticks)]


def test_weights_of_a_long_recording_neither_overflow_nor_underflow():
    """Probabilities remain normalised in spite of rounding."""
    case = Case(3, sizes=((3, 6),))
    unshifted, unshifted_changes, _ = hmm.expect(case.trellis, *case.model)
    case.value -= 1e9 * (np.arange(case.ticks + 1) - case.onset[:, None])
    posterior, changes, log_evidence = hmm.expect(case.trellis, *case.model)
    assert np.isfinite(log_evidence)
    np.testing.assert_allclose(posterior.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(posterior, unshifted, atol=1e-5)
    assert np.abs(changes.sum(axis=(1, 2)) - unshifted_changes.sum(axis=(1, 2))).max() < 1e-5


def test_hypotheses_absent_at_their_onset_have_no_origin():
    """The first hypothesis has the highest likelihood, but first appears a tick after its onset."""
    trellis = hmm.Trellis(
        np.array([0, 1, 1]),
        np.array([0, 0, 1]),
        [np.array([1]), np.array([0, 1, 2])],
        [np.zeros(1), np.array([50.0, 0.0, 0.0])],
    )
    even = np.log(np.full((2, 2, 2), 0.5))
    assert all(h for h, *_ in hmm.viterbi(trellis, even[0, 0], even))
    posterior, _ = hmm.smooth(trellis, even[0, 0], even)
    np.testing.assert_allclose(posterior, [[0.0, 1.0]] * 2)


def test_log_sum_exp_of_impossible_states_is_minus_infinity():
    table = np.array([[-np.inf, -np.inf], [1000.0, 1000.0], [-1000.0, -np.inf]])
    np.testing.assert_allclose(hmm.log_sum_exp(table), [-np.inf, 1000.0 + np.log(2.0), -1000.0])
    np.testing.assert_array_equal(hmm.by_state(np.zeros(0), np.zeros(0, np.int64), 3), np.full(3, -np.inf))
    best = hmm.by_state(np.array([1.0, 2.0, 0.5]), np.array([0, 0, 2]), 3, best=True)
    np.testing.assert_array_equal(best, [2.0, -np.inf, 0.5])
