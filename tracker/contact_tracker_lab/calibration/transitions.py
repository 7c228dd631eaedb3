"""Transitions by expectation-maximisation, from states that are known (truth) or estimated (beliefs).

The E-step gives the expected changes and stays of the Markov chain of the states in a recording, given a
model; the M-step gives the model for these counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model, TransitionCounts
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import (
    FREE,
    destinations,
    initial,
    leave_per_s,
    log_initial,
    tick_transitions,
)
from contact_tracker_lab.calibration.trellis import Trellis, expect
from contact_tracker_lab.evaluation.scoring import UNSCORED

UNKNOWN: Final = UNSCORED
LONGEST_UNKNOWN_S: Final = 1.0
"""Intervals without truth longer than this (s) separate the states before and after them."""
MOST_ROUNDS: Final = 50
CONVERGED: Final = 1e-3
"""Iteration ends when no rate or probability above ``NEGLIGIBLE`` changes by more than this share."""
NEGLIGIBLE: Final = 1e-3
LEAST_EXPOSURE_S: Final = 1e-9
"""Replaces zero exposure (s), to avoid zero over zero."""
_DIAGONAL: Final = np.arange(len(STATES))


class Expected(NamedTuple):
    """Expectations of a recording of T ticks.

    ``begins`` (7,): probability of the initial state; ``stays`` (T, 7), ``changes`` (T, 7, 7): probability
    that at the boundary before each tick a state stayed, or changed to another; ``log_evidence`` in nats.
    """

    begins: Array
    stays: Array
    changes: Array
    log_evidence: float


@dataclass(frozen=True, eq=False)
class KnownStates:
    """``label`` (T,): column of the true state of each tick, or ``UNKNOWN``; ``exposure`` (T,): exposure to
    change before each tick, in ticks of motion. A change at the end of a rest counts as one by motion
    (``transition_model.LIFTED_AFTER_REST``)."""

    label: Ints
    exposure: Array

    def expect(self, model: Model) -> Expected:
        """The E-step: short intervals without truth are summed over all paths by the model."""
        ticks, states = len(self.label), len(STATES)
        begins, changes, log_evidence = np.zeros(states), np.zeros((ticks, states, states)), 0.0
        longest = LONGEST_UNKNOWN_S / model.tick_s
        labelled = np.flatnonzero(self.label != UNKNOWN)
        if len(labelled) and labelled[0] <= longest:
            begins[self.label[labelled[0]]] = 1.0
            log_evidence = float(log_initial(model)[self.label[labelled[0]]])
        transitions = [tick_transitions(model, exposure) for exposure in self.exposure]
        steps = np.array([change for change, _ in transitions]).reshape(-1, states, states)
        # staying is a step like any other: the truth has no changes into the same contact
        steps[:, _DIAGONAL, _DIAGONAL] = np.array([stay for _, stay in transitions]).reshape(-1, states)
        for piece in np.split(labelled, np.flatnonzero(np.diff(labelled) - 1 > longest) + 1):
            if len(piece) > 1:
                first, end = piece[0], piece[-1] + 1
                between, log_share = _on_all_paths(self.label[first:end], steps[first:end])
                changes[first + 1 : end] = between[1:]
                log_evidence += log_share
        stays = changes[:, _DIAGONAL, _DIAGONAL].copy()
        changes[:, _DIAGONAL, _DIAGONAL] = 0.0
        return Expected(begins, stays, changes, log_evidence)


def _on_all_paths(label: Ints, steps: Array) -> tuple[Array, float]:
    """Changes (t, 7, 7) and log probability of a chain whose first tick is known.

    A plain Markov chain with one hypothesis per tick and state.
    """
    ticks, states = len(label), len(STATES)
    state, onset = np.tile(_DIAGONAL, ticks), np.repeat(np.arange(ticks), states)
    alive = [
        states * tick + (_DIAGONAL if column == UNKNOWN else np.array([column]))
        for tick, column in enumerate(label)
    ]
    without_evidence = Trellis(state, onset, alive, [np.zeros(len(hypotheses)) for hypotheses in alive])
    _, changes, log_share = expect(without_evidence, np.zeros(states), steps)
    return changes, log_share


@dataclass(frozen=True, eq=False)
class EstimatedStates:
    """The hypotheses of a forward pass in ``trellis``, whose fixed evidence excludes the probability of
    staying; ``exposure`` as in ``KnownStates``."""

    trellis: Trellis
    exposure: Array

    @classmethod
    def of(cls, trellis: Trellis, exposure: Array, model: Model) -> "EstimatedStates":
        """From the trellis of a forward pass by ``model``, which includes the probability of staying."""
        return cls(_with_survival(trellis, exposure, model, -1.0), exposure)

    def expect(self, model: Model) -> Expected:
        """The E-step: forward-backward over the same hypotheses with the transitions of ``model``."""
        steps = np.array([tick_transitions(model, exposure).log_transition for exposure in self.exposure])
        trellis = _with_survival(self.trellis, self.exposure, model, 1.0)
        posterior, changes, log_evidence = expect(trellis, log_initial(model), steps)
        changes[:, FREE, FREE] = 0.0  # for free motion this is a stay
        stays = np.zeros_like(posterior)
        stays[1:] = np.maximum(posterior[:-1] - changes[1:].sum(axis=2), 0.0)
        return Expected(posterior[0], stays, changes, log_evidence)


def _with_survival(trellis: Trellis, exposure: Array, model: Model, sign: float) -> Trellis:
    """The trellis with ``sign`` times the log probability of staying added to contacts, after their first
    tick."""
    stay = np.array([tick_transitions(model, e).log_survival for e in exposure]).reshape(-1, len(STATES))
    stay[:, FREE] = 0.0
    until = np.concatenate([np.zeros((1, len(STATES))), np.cumsum(stay, axis=0)])
    changed = []
    rows = zip(trellis.alive, trellis.log_likelihood, strict=True)
    for end, (alive, likelihood) in enumerate(rows, start=1):
        column = trellis.state[alive]
        changed.append(likelihood + sign * (until[end, column] - until[trellis.onset[alive] + 1, column]))
    return trellis._replace(log_likelihood=changed)


Chain = KnownStates | EstimatedStates


def runs(label: Ints) -> list[tuple[int, int, int]]:
    """Runs (column, first, end) of one state, in order; ``UNKNOWN`` is left out."""
    edges = [0, *(np.flatnonzero(np.diff(label)) + 1).tolist(), len(label)]
    return [(int(label[a]), a, b) for a, b in pairwise(edges) if a < b and label[a] != UNKNOWN]


def learn_transitions(model: Model, chains: Sequence[Chain]) -> tuple[Model, tuple[float, ...]]:
    """Maximum a posteriori transitions, given the recordings and the prior of ``model``.

    The prior is set by ``leave_per_s``, ``skip``, ``initial_f_f`` and ``prior_changes``; the model's
    counts are not used.

    Returns
    -------
    The model, and its log posterior after each round, in nats up to a constant; no round lowers it.
    """
    trail = []
    for _ in range(MOST_ROUNDS):
        expected = [chain.expect(model) for chain in chains]
        trail.append(sum(e.log_evidence for e in expected) + log_prior(model))
        previous = _probabilities(model)
        counted = count(model, chains, expected)
        model = replace(model, transitions=replace(model.transitions, counts=counted))
        probabilities = _probabilities(model)
        if np.max(np.abs(previous - probabilities) / np.maximum(probabilities, NEGLIGIBLE)) < CONVERGED:
            break
    rounded = _counts(*(np.round(part, 2) for part in (counted.begins, counted.moving_s, counted.changes)))
    return replace(model, transitions=replace(model.transitions, counts=rounded)), tuple(trail)


def _probabilities(model: Model) -> Array:
    """All rates and probabilities of the transitions."""
    t = model.transitions
    return np.concatenate([leave_per_s(t), initial(t), destinations(t).ravel()])


def count(model: Model, chains: Sequence[Chain], expected: Sequence[Expected]) -> TransitionCounts:
    """Sums of the counts over recordings. A state left within a tick has lasted for a part of it.

    With the rate lambda, and h the time in which the tick's motion could have ended the state, that part is
    1 / lambda - h / (exp(lambda h) - 1) on average: about half of h.
    """
    rate, moving = leave_per_s(model.transitions), np.zeros(len(STATES))
    for chain, e in zip(chains, expected, strict=True):
        # without any exposure nothing has changed
        h = np.maximum(model.tick_s * chain.exposure, LEAST_EXPOSURE_S)[:, None]
        left_after = 1.0 / rate - h / np.expm1(rate * h)
        moving += (e.stays * h + e.changes.sum(axis=2) * left_after).sum(axis=0)
    begins, changes = ([getattr(e, name) for e in expected] for name in ("begins", "changes"))
    return _counts(np.sum(begins, axis=0), moving, np.concatenate(changes).sum(axis=0))


def _counts(begins: Array, moving_s: Array, changes: Array) -> TransitionCounts:
    rows = tuple(tuple(row) for row in changes.tolist())
    return TransitionCounts(tuple(begins.tolist()), tuple(moving_s.tolist()), rows)


def log_prior(model: Model) -> float:
    """Log density, up to a constant, of the prior under which each M-step is the most probable model."""
    t, zeros = model.transitions, np.zeros(len(STATES))
    empty = replace(t, counts=_counts(zeros, zeros, np.diag(zeros)))
    rate, weight = leave_per_s(t), t.prior_changes
    rows = zip((initial(empty), *destinations(empty)), (initial(t), *destinations(t)), strict=True)
    shares = sum(float(p[p > 0] @ np.log(q[p > 0])) for p, q in rows)
    return weight * (float((np.log(rate) - rate / t.leave_per_s).sum()) + shares)
