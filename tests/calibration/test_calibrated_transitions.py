"""Counts of true states, on chains of known rates."""

from dataclasses import replace

import numpy as np

from chain_oracle import prior, random_model, walk
from contact_tracker.tracking.transition_model import REST_EXPOSURE, destinations, initial, leave_per_s
from contact_tracker_lab.calibration.transitions import UNSCORED, Counts, count_transitions

TICK_S = prior().tick_s


def test_rates_and_splits_of_a_simulated_chain_are_recovered():
    rng, runs, counted = np.random.default_rng(5), 20, []
    true = random_model(rng, new_elements=False)
    for _ in range(runs):
        exposure = rng.choice([REST_EXPOSURE, 0.4, 1.0], 300, p=[0.2, 0.3, 0.5])
        counted.append(count_transitions(walk(true, exposure, rng), exposure, TICK_S))
    total = Counts(*(np.sum(parts, axis=0) for parts in zip(*counted, strict=True)))
    learned = replace(prior(1e-3).transitions, counts=total.rounded)
    changes = np.array(learned.counts.changes).sum(axis=1)
    assert changes.min() > 5.0
    off = np.log(leave_per_s(learned) / leave_per_s(true.transitions))
    assert np.abs(off * np.sqrt(changes)).max() < 3.5  # standard deviations of a Poisson count
    p, q = destinations(true.transitions), destinations(learned)
    spread = np.sqrt(p * (1.0 - p) / changes[:, None]) + 1e-3
    assert np.abs((q - p) / spread).max() < 4.0
    assert np.abs(initial(learned) - initial(true.transitions)).max() < 4.0 * np.sqrt(0.25 / runs)


def test_counts_of_known_states_are_counts():
    label = np.array([0, 0, 1, 1, 1, 6, 6, UNSCORED])
    exposure = np.array([1.0, 0.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0])
    seen = count_transitions(label, exposure, TICK_S).rounded
    assert seen.begins == (1.0, *(0.0,) * 6)
    assert np.argwhere(seen.changes).tolist() == [[0, 1], [1, 6]]
    expected = [0.1 * REST_EXPOSURE + 0.05, 0.1 + 0.05 + 0.05, 0.0, 0.0, 0.0, 0.0, 0.1]
    np.testing.assert_allclose(seen.moving_s, expected, atol=5.1e-3)


def test_short_gaps_are_half_of_each_state_and_long_ones_divide():
    label = np.full(40, UNSCORED)
    label[[12, 16, 19, 35]] = 3, 1, 1, 0
    seen = count_transitions(label, np.ones(40), TICK_S)
    assert not seen.begins.any()  # how it began is unknown
    assert np.argwhere(seen.changes).tolist() == [[3, 1]]
    np.testing.assert_allclose(seen.moving_s[[3, 1]], [0.2, 0.2 + 0.3])
