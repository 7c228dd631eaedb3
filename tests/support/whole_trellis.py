"""A whole recording at once: the hypotheses of a forward pass, and their smoothing, which ``hmm`` does tick
by tick."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.hmm import birth_log_weights, log_sum_exp
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.tracking.transition_model import FREE
from pose_filter import FilteredTick


class Trellis(NamedTuple):
    """All hypotheses of a recording of T ticks.

    ``state`` (H,), ``onset`` (H,) by hypothesis; entry b - 1 of the lists has the active hypotheses at
    boundary b = 1 .. T, and their log-likelihoods up to it.
    """

    state: Ints
    onset: Ints
    alive: Sequence[Ints]
    log_likelihood: Sequence[Array]


def _by_state(values: Array, state: Ints, states: int) -> Array:
    """Log-sum of ``values`` (H,) over the hypotheses of each state, (states,)."""
    table = np.full((states, len(values)), -np.inf)
    table[state, np.arange(len(values))] = values
    return log_sum_exp(table)


def smooth(trellis: Trellis, log_initial: Array, log_transition: Array) -> tuple[Array, float]:
    """Posterior (T, N) of the state at each tick given all data, and the log evidence of the data."""
    states, ticks, count = len(log_initial), len(trellis.alive), len(trellis.state)
    entry = np.full(count, -np.inf)
    log_ended = np.full((ticks + 1, states), -np.inf)
    for b, (alive, likelihood) in enumerate(zip(trellis.alive, trellis.log_likelihood, strict=True), start=1):
        fresh = alive[trellis.onset[alive] == b - 1]
        weight = log_initial if b == 1 else birth_log_weights(log_ended[b - 1], log_transition[b - 1])
        entry[fresh] = weight[trellis.state[fresh]]
        log_ended[b] = _by_state(entry[alive] + likelihood, trellis.state[alive], states)
    log_evidence = float(log_sum_exp(log_ended[ticks]))

    onward = np.full((ticks + 1, states), -np.inf)  # log probability of later data if a state is left at b
    onward[ticks] = 0.0
    inward = np.full(count, -np.inf)  # log probability of a hypothesis' and later data
    posterior, lasting = np.zeros((ticks, states)), np.zeros(count)  # lasting: it ends at b or later
    for b in range(ticks, 0, -1):
        alive, likelihood = trellis.alive[b - 1], trellis.log_likelihood[b - 1]
        state = trellis.state[alive]
        ends = likelihood + onward[b, state]
        inward[alive] = np.logaddexp(inward[alive], ends)
        lasting[alive] += np.exp(entry[alive] + ends - log_evidence)
        np.add.at(posterior[b - 1], state, lasting[alive])
        fresh = alive[trellis.onset[alive] == b - 1]
        begin = _by_state(inward[fresh], trellis.state[fresh], states)
        onward[b - 1] = log_sum_exp(log_transition[b - 1] + begin[None, :], axis=1)
    return posterior / posterior.sum(axis=1)[:, None], log_evidence


@dataclass
class RecordedPass:
    """The hypotheses of a forward pass, for evaluation of a whole recording."""

    exposures: list[float] = field(default_factory=list)
    alive: list[LiveHypotheses] = field(default_factory=list)
    numbers: list[Ints] = field(default_factory=list)

    def note(self, result: FilteredTick) -> None:
        """Append a tick."""
        self.exposures.append(result.state.hazard_exposure)
        self.alive.append(result.state.live_hypotheses)
        self.numbers.append(result.numbers)

    @property
    def exposure(self) -> Array:
        """Exposure to change at the boundary before each tick (T,), in ticks of motion.

        Exposure that is deferred at the end of the recording is missing. It has no effect, since no data
        follow.
        """
        return np.array(self.exposures)

    @property
    def trellis(self) -> Trellis:
        """All hypotheses of the pass."""
        count = 1 + int(self.numbers[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for number, alive in zip(self.numbers, self.alive, strict=True):
            states[number], onsets[number] = alive.state, alive.onset
        return Trellis(states, onsets, self.numbers, [alive.log_likelihood for alive in self.alive])
