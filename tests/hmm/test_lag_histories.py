"""Lag histories of hypotheses against enumeration of all paths of the chain, and sums of logarithms."""

from itertools import product

import numpy as np
import pytest

from contact_tracker import hmm


def test_log_sum_exp_of_impossible_states_is_minus_infinity():
    table = np.array([[-np.inf, -np.inf], [1000.0, 1000.0], [-1000.0, -np.inf]])
    np.testing.assert_allclose(hmm.log_sum_exp(table), [-np.inf, 1000.0 + np.log(2.0), -1000.0])


TICKS, STATES, LAG = 6, 3, 3
Array = np.ndarray


def of_all_paths(initial: Array, changes: Array, data: Array, lag: int) -> Array:
    """Posterior (TICKS, lag, STATES) of the last ticks at each tick; zero before the first."""
    found = np.zeros((TICKS, lag, STATES))
    for tick in range(TICKS):
        total = 0.0
        for path in product(range(STATES), repeat=tick + 1):
            steps = [changes[t, path[t - 1], path[t]] for t in range(1, tick + 1)]
            weight = initial[path[0]] * np.prod(steps) * np.prod(data[range(tick + 1), path])
            total += weight
            for back in range(min(lag, tick + 1)):
                found[tick, lag - 1 - back, path[tick - back]] += weight
        found[tick] /= total
    return found


@pytest.mark.parametrize("lag", [0, 1, LAG])
@pytest.mark.parametrize("scale", [1.0, 1e-200, 1e200])
def test_lag_histories_are_sums_over_all_paths(lag: int, scale: float) -> None:
    """With one hypothesis per state in each tick, and weights with any common factor."""
    rng = np.random.default_rng(3)
    initial, data = rng.dirichlet(np.ones(STATES)), rng.uniform(0.1, 1.0, (TICKS, STATES))
    changes = rng.dirichlet(np.ones(STATES), (TICKS, STATES))
    expected = of_all_paths(initial, changes, data, lag)
    past, log_left = np.zeros((STATES, lag, STATES)), np.log(initial) + np.log(scale)
    for tick in range(TICKS):
        if tick:
            past = hmm.inherited_past(past, log_left, np.log(changes[tick]))
            log_left = np.logaddexp.reduce(log_left[:, None] + np.log(changes[tick]), axis=0)
        log_left = log_left + np.log(data[tick])
        past = np.array([hmm.grown_past(one, state) for state, one in enumerate(past)])
        assert past.shape == (STATES, lag, STATES)
        np.testing.assert_allclose(hmm.mixed_past(past, log_left), expected[tick], atol=1e-12)


def test_histories_of_several_hypotheses_are_extended_at_once() -> None:
    past = np.arange(12.0).reshape(2, 2, 3)
    grown = hmm.grown_past(past, 1)
    np.testing.assert_array_equal(grown[:, 0], past[:, 1])
    np.testing.assert_array_equal(grown[:, 1], [[0.0, 1.0, 0.0]] * 2)


@pytest.mark.filterwarnings("error")
def test_weights_may_differ_by_any_factor() -> None:
    """Hypotheses whose weights underflow do not contribute; without any the history is zero."""
    np.testing.assert_array_equal(hmm.mixed_past(np.zeros((0, LAG, STATES)), np.zeros(0)), 0.0)
    past = np.eye(STATES)[:, None]
    log_left, even = np.array([-2000.0, 0.0, -4000.0]), np.zeros((STATES, STATES))
    np.testing.assert_array_equal(hmm.inherited_past(past, log_left, even), past[[1, 1, 1]])
    np.testing.assert_array_equal(hmm.mixed_past(past, log_left), past[1])
