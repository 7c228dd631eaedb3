"""Transitions by expectation-maximisation: expected counts given a model, and the model given the counts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model, TransitionCounts
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import destinations, initial, leave_per_s
from contact_tracker_lab.calibration.e_step import Chain, Expected

Array = NDArray[np.float64]

MOST_ROUNDS: Final = 50
CONVERGED: Final = 1e-3
"""Iteration ends when no rate or probability above ``NEGLIGIBLE`` changes by more than this share."""
NEGLIGIBLE: Final = 1e-3
LEAST_EXPOSURE_S: Final = 1e-9
"""Replaces zero exposure, to avoid zero over zero."""


@dataclass(frozen=True)
class LearnedTransitions:
    """The learned model, and the log posterior of the model after each round, in nats up to a constant."""

    model: Model
    log_posterior: tuple[float, ...]


def learn_transitions(model: Model, chains: Sequence[Chain]) -> LearnedTransitions:
    """Maximum a posteriori transitions, given the recordings and the prior of ``model``.

    The prior is that of ``leave_per_s``, ``skip``, ``initial_f_f`` and ``prior_changes``; the model's own
    counts are not used. No round lowers the log posterior.
    """
    trail = []
    for _ in range(MOST_ROUNDS):
        expected = [chain.expect(model) for chain in chains]
        trail.append(sum(e.log_evidence for e in expected) + log_prior(model))
        before = model
        counted = count(model, chains, expected)
        model = replace(model, transitions=replace(model.transitions, counts=counted))
        if _moved(before, model) < CONVERGED:
            break
    return LearnedTransitions(
        replace(model, transitions=replace(model.transitions, counts=_rounded(counted))), tuple(trail)
    )


def count(model: Model, chains: Sequence[Chain], expected: Sequence[Expected]) -> TransitionCounts:
    """Sums of the counts over recordings. A state left within a tick has lasted for a part of it.

    With the rate lambda, and h the time in which the tick's motion could have ended the state, that part is
    1 / lambda - h / (exp(lambda h) - 1) on average: about half of h.
    """
    rate = leave_per_s(model.transitions)
    begins, moving = np.zeros(len(STATES)), np.zeros(len(STATES))
    changes = np.zeros((len(STATES), len(STATES)))
    for chain, e in zip(chains, expected, strict=True):
        # without any exposure nothing has changed
        h = np.maximum(model.tick_s * chain.exposure, LEAST_EXPOSURE_S)[:, None]
        begins += e.begins
        changes += e.changes.sum(axis=0)
        left_after = 1.0 / rate - h / np.expm1(rate * h)
        moving += (e.stays * h + e.changes.sum(axis=2) * left_after).sum(axis=0)
    return TransitionCounts(_numbers(begins), _numbers(moving), tuple(map(_numbers, changes)))


def log_prior(model: Model) -> float:
    """Log density, up to a constant, of the prior under which each M-step is the most probable model."""
    t = model.transitions
    empty = replace(t, counts=zero_counts())
    rate, weight = leave_per_s(t), t.prior_changes
    rates = weight * (np.log(rate) - rate / t.leave_per_s).sum()
    rows = (initial(empty), *destinations(empty)), (initial(t), *destinations(t))
    shares = sum(weight * float(p[p > 0] @ np.log(q[p > 0])) for p, q in zip(rows[0], rows[1], strict=True))
    return float(rates) + shares


def zero_counts() -> TransitionCounts:
    """Counts of no recording."""
    zeros = (0.0,) * len(STATES)
    return TransitionCounts(zeros, zeros, (zeros,) * len(STATES))


def _moved(before: Model, after: Model) -> float:
    """Largest relative change."""
    a, b = (
        np.concatenate(
            [leave_per_s(m.transitions), initial(m.transitions), destinations(m.transitions).ravel()]
        )
        for m in (before, after)
    )
    return float(np.max(np.abs(a - b) / np.maximum(b, NEGLIGIBLE)))


def _rounded(counted: TransitionCounts) -> TransitionCounts:
    """Rounded to hundredths, as in the file."""
    return TransitionCounts(
        tuple(round(value, 2) for value in counted.begins),
        tuple(round(value, 2) for value in counted.moving_s),
        tuple(tuple(round(value, 2) for value in row) for row in counted.changes),
    )


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
