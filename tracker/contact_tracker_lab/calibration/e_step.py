"""The E-step: expected changes and stays of the Markov chain of the states in a recording, given a model.

States are known (``KnownStates``: truth) or estimated (``EstimatedStates``: the hypotheses of a forward pass,
their evidence held fixed). Short intervals without truth, as often at a change, are summed over all paths by
the model.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import FREE, log_initial, tick_transitions
from contact_tracker_lab.calibration.tick_stream import UNKNOWN

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST_UNKNOWN_S: Final = 1.0
"""Longer intervals without truth separate the states before and after."""
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


class Chain(Protocol):
    """The chain of states of one recording."""

    @property
    def exposure(self) -> Array:
        """(T,) exposure of each tick, see ``transition_model.hazard_exposure``."""

    def expect(self, model: Model) -> Expected:
        """The E-step with the transitions of ``model``."""


@dataclass(frozen=True, eq=False)
class KnownStates:
    """``label`` (T,) column of the true state of each tick, or ``UNKNOWN``; ``exposure`` (T,)."""

    label: Ints
    exposure: Array

    def expect(self, model: Model) -> Expected:
        """Counts where states are known, expectations in short intervals without truth."""
        ticks = len(self.label)
        stays, changes = np.zeros((ticks, len(STATES))), np.zeros((ticks, len(STATES), len(STATES)))
        begins, initial = np.zeros(len(STATES)), log_initial(model)
        steps = self._steps(model)
        known = np.flatnonzero(self.label != UNKNOWN)
        log_evidence = 0.0
        longest = LONGEST_UNKNOWN_S / model.tick_s
        if len(known) and known[0] <= longest:
            begins[self.label[known[0]]] = 1.0
            log_evidence += float(initial[self.label[known[0]]])
        for before, after in pairwise(known.tolist()):
            i, j = int(self.label[before]), int(self.label[after])
            if after == before + 1:
                log_evidence += float(steps[after, i, j])
                changes[after, i, j] = 1.0
            elif after - before - 1 <= longest:
                between, log_share = _bridge(steps[before : after + 1], i, j)
                changes[before + 1 : after + 1] = between[1:]
                log_evidence += log_share
        stays[:] = changes[:, _DIAGONAL, _DIAGONAL]
        changes[:, _DIAGONAL, _DIAGONAL] = 0.0
        return Expected(begins, stays, changes, log_evidence)

    def _steps(self, model: Model) -> Array:
        """Log probability (T, 7, 7) of each step; the truth has no changes into the same contact."""
        transitions = [tick_transitions(model, exposure) for exposure in self.exposure]
        steps = np.array([change for change, _ in transitions])
        if len(steps):
            steps[:, _DIAGONAL, _DIAGONAL] = [stay for _, stay in transitions]
        return steps


def _bridge(steps: Array, first: int, last: int) -> tuple[Array, float]:
    """Changes (t, 7, 7) between two known ticks with none known between, and their log probability.

    A plain Markov chain with one hypothesis per tick and state: staying is a step like any other.
    """
    ticks, states = len(steps), len(STATES)
    state, onset = np.tile(np.arange(states), ticks), np.repeat(np.arange(ticks), states)
    alive = [np.arange(b * states, (b + 1) * states) for b in range(ticks)]
    alive[0], alive[-1] = alive[0][[first]], alive[-1][[last]]
    without_evidence = hmm.Trellis(state, onset, alive, [np.zeros(len(some)) for some in alive])
    _, changes, log_share = hmm.expect(without_evidence, np.zeros(states), steps)
    return changes, log_share


@dataclass(frozen=True, eq=False)
class EstimatedStates:
    """The hypotheses of a forward pass; the evidence in ``trellis`` excludes the probability of staying."""

    trellis: hmm.Trellis
    exposure: Array

    @classmethod
    def of(cls, trellis: hmm.Trellis, exposure: Array, model: Model) -> "EstimatedStates":
        """From the trellis of a forward pass by ``model``, which includes the probability of staying."""
        return cls(_with_survival(trellis, exposure, model, -1.0), exposure)

    def expect(self, model: Model) -> Expected:
        """Forward-backward over the same hypotheses with the transitions of ``model``."""
        steps = np.array([tick_transitions(model, exposure).log_transition for exposure in self.exposure])
        trellis = _with_survival(self.trellis, self.exposure, model, 1.0)
        posterior, changes, log_evidence = hmm.expect(trellis, log_initial(model), steps)
        changes[:, FREE, FREE] = 0.0  # for free motion this is staying
        stays = np.zeros_like(posterior)
        stays[1:] = np.maximum(posterior[:-1] - changes[1:].sum(axis=2), 0.0)
        return Expected(posterior[0], stays, changes, log_evidence)


def _with_survival(trellis: hmm.Trellis, exposure: Array, model: Model, sign: float) -> hmm.Trellis:
    """The trellis with ``sign`` times the log probability of staying added to contacts, after their first
    tick."""
    stay = np.array([tick_transitions(model, e).log_survival for e in exposure]).reshape(-1, len(STATES))
    stay[:, FREE] = 0.0
    until = np.concatenate([np.zeros((1, len(STATES))), np.cumsum(stay, axis=0)])
    changed = [
        likelihood
        + sign * (until[b, trellis.state[alive]] - until[trellis.onset[alive] + 1, trellis.state[alive]])
        for b, (alive, likelihood) in enumerate(
            zip(trellis.alive, trellis.log_likelihood, strict=True), start=1
        )
    ]
    return trellis._replace(log_likelihood=changed)
