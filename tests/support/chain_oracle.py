"""Random models of the Markov chain of the states, and samples of it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model, TransitionCounts
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import FREE, log_initial, tick_transitions
from contact_tracker_lab.calibration.trellis import Trellis

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
N = len(STATES)
NOTHING = TransitionCounts((0.0,) * N, (0.0,) * N, ((0.0,) * N,) * N)


def prior(prior_changes: float = 20.0) -> Model:
    """The default model without counts."""
    model = load_model()
    return replace(model, transitions=replace(model.transitions, prior_changes=prior_changes, counts=NOTHING))


def random_model(rng: np.random.Generator, leave_per_s: float = 1.0, new_elements: bool = True) -> Model:
    """A model with rates about ``leave_per_s``, random destinations and nearly no prior."""
    changes = 1e3 * rng.dirichlet(np.ones(N), N)
    changes[FREE, FREE] = 0.0
    if not new_elements:
        np.fill_diagonal(changes, 0.0)
    moving = changes.sum(axis=1) / (leave_per_s * np.exp(rng.normal(size=N) * 0.3))
    counts = TransitionCounts(
        tuple(rng.dirichlet(np.ones(N)) * 1e3), tuple(moving), tuple(map(tuple, changes.tolist()))
    )
    model = prior(1e-6)
    return replace(model, transitions=replace(model.transitions, counts=counts))


def walk(model: Model, exposure: Array, rng: np.random.Generator) -> Ints:
    """States (T,) of one sample of the chain."""
    state = [int(rng.choice(N, p=np.exp(log_initial(model))))]
    for a in exposure[1:]:
        if rng.random() < np.exp(tick_transitions(model, a).log_survival[state[-1]]):
            state.append(state[-1])
            continue
        leave = np.exp(tick_transitions(model, a).log_transition[state[-1]])
        if state[-1] == FREE:
            leave[FREE] = 0.0
        state.append(int(rng.choice(N, p=leave / leave.sum())))
    return np.array(state)


def noisy_trellis(
    state: Ints, model: Model, exposure: Array, rng: np.random.Generator, blur: float
) -> Trellis:
    """The trellis of a forward pass with noisy observations of the states, without pruning.

    It includes the probability of staying, as in the tracker; a contact has a hypothesis per onset, free
    motion one per tick.
    """
    ticks = len(state)
    observed = np.eye(N)[state] + rng.normal(size=(ticks, N)) * blur
    evidence = np.cumsum(np.vstack([np.zeros(N), (observed - 0.5) / blur**2]), axis=0)
    evidence -= evidence[:, [FREE]]  # against free motion
    stay = np.cumsum(
        np.vstack([np.zeros(N), *(tick_transitions(model, a).log_survival for a in exposure)]), axis=0
    )
    states, onset = np.tile(np.arange(N), ticks), np.repeat(np.arange(ticks), N)
    alive, value = [], []
    for b in range(1, ticks + 1):
        here = np.flatnonzero((onset < b) & ((states != FREE) | (onset == b - 1)))
        i, a = states[here], onset[here]
        survival = np.where(i == FREE, 0.0, stay[b, i] - stay[a + 1, i])
        alive.append(here)
        value.append(evidence[b, i] - evidence[a, i] + survival)
    return Trellis(states, onset, alive, value)
