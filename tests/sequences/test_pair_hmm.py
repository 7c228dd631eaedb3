"""The alignment of two sequences: against all alignments of short ones, and by its symmetries."""

from itertools import product
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.sequences.pair_hmm import RATE, align

CONTACTS = 3
seeds = st.integers(0, 2**32 - 1)


def sequence(rng, count):
    p = rng.dirichlet(np.full(CONTACTS, 0.3), count) + 1e-6
    return np.log(CONTACTS * p / p.sum(axis=1, keepdims=True))


def all_alignments(n, m):
    """Steps in order, each of segments of both sequences or of one of them; missing before new."""
    if not (n or m):
        yield []
    for a, b in product(range(n + 1), range(m + 1)):
        if (a and b) or a + b == 1:
            for rest in all_alignments(n - a, m - b):
                if not (a == 0 and rest and rest[0] == (1, 0)):
                    yield [(a, b), *rest]


def log_weight(steps, first, second, pairs, alone, rate):
    total, i, j = 0.0, 0, 0
    for a, b in steps:
        if not (a and b):
            total += np.log(rate) + (alone[0][i] if a else alone[1][j])
        else:
            per_contact = first[i : i + a].sum(axis=0) + second[j : j + b].sum(axis=0) + pairs[i, j]
            total += np.log1p(-2.0 * rate) + np.logaddexp.reduce(per_contact) - np.log(CONTACTS)
            total += (a + b - 2) * np.log(rate) + 2.0 * np.log1p(-rate)
        i, j = i + a, j + b
    return total


@settings(max_examples=10, deadline=None)
@given(seed=seeds, n=st.integers(1, 4), m=st.integers(1, 4), rate=st.sampled_from((0.02, RATE, 0.3)))
def test_probabilities_are_those_of_all_alignments(seed, n, m, rate) -> None:
    rng = np.random.default_rng(seed)
    first, second, pairs = sequence(rng, n), sequence(rng, m), rng.normal(size=(n, m, CONTACTS))
    are_alike = rng.random((n, m)) < 0.5
    alone = np.log(rng.random(n)), np.log(rng.random(m))
    more = pairs + np.log(2.0 * np.where(are_alike, 1.0 - rate, rate))[..., None]
    found = list(all_alignments(n, m))
    weights = np.array([log_weight(one, first, second, more, alone, rate) for one in found])
    total = np.logaddexp.reduce(weights)
    together, missing, new = np.zeros((n, m)), np.zeros(n), np.zeros(m)
    for steps, p in zip(found, np.exp(weights - total), strict=True):
        i, j = 0, 0
        for a, b in steps:
            together[i : i + a, j : j + b] += p
            missing[i : i + a] += p * (b == 0)
            new[j : j + b] += p * (a == 0)
            i, j = i + a, j + b
    with patch("contact_tracker.sequences.pair_hmm.RATE", rate):
        got = align(first, second, pairs, are_alike, alone)
    np.testing.assert_allclose(got.together, together, atol=0.07)
    np.testing.assert_allclose(got.missing, missing, atol=0.07)
    np.testing.assert_allclose(got.new, new, atol=0.07)
    flat = [one for steps in got.steps for one in steps[0]], [one for steps in got.steps for one in steps[1]]
    assert flat == ([*range(n)], [*range(m)])


@pytest.mark.parametrize(
    ("first", "second", "missing", "new"),
    [([0, 6, 1, 3, 6, 0], [0, 6, 1, 6, 0], [3], []), ([0, 6, 1, 6, 4], [0, 6, 3, 6, 4], [2], [2])],
)
def test_sure_steps_are_missing_or_new(first, second, missing, new) -> None:
    evidence = np.log(7.0 * (1e-4 + (1.0 - 7e-4) * np.eye(7)))
    alike = np.ones((len(first), len(second)), bool)
    alone = np.zeros(len(first)), np.zeros(len(second))
    alignment = align(evidence[first], evidence[second], np.zeros((*alike.shape, 7)), alike, alone)
    assert [own[0] for own, other in alignment.steps if not other] == missing
    assert [other[0] for own, other in alignment.steps if not own] == new
    assert np.all(alignment.missing[missing] > 0.8)
    assert np.all(alignment.new[new] > 0.8)
