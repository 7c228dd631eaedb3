"""Random models of the Markov chain of the states, and samples of it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model, TransitionCounts
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import FREE, log_initial, tick_transitions

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
