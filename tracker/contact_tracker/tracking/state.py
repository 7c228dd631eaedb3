"""Everything the tracker knows between two poses."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hmm import log_sum_exp
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.bank_update import Alive
from contact_tracker.hypotheses.birth import fresh
from contact_tracker.hypotheses.birth_proposals import Reminded
from contact_tracker.hypotheses.evidence import Scales
from contact_tracker.landmarks.landmark_memory import NOTHING_MET, Memory
from contact_tracker.landmarks.prior_map import NOTHING, Knowledge
from contact_tracker.motion.sliding import NOTHING_SEEN, Sliding
from contact_tracker.motion.tick_grid import TickState
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.transition_model import log_initial

Array = NDArray[np.float64]


class TrackerState(NamedTuple):
    """Everything the tracker knows; bounded in size however long the stream.

    ``averaging`` of poses into ticks, which may be ahead; the window of the last taken in, ``sliding`` on;
    ``banks`` of hypotheses by contact; the ``memory`` of elements met, and what of it each contact
    has been ``reminded`` of; ``log_left`` (7,) weights of the states at the last boundary, up to a
    constant, the ``residual`` (6,) of each contact (see ``Belief``), the rows of their best hypotheses, the
    ``leaders`` (6,), and all that is ``alive``; ``ticks`` seen, ``numbers`` of hypotheses given out,
    ``outliers`` among the poses; the label, tick and time since when it is free; ``exposure`` to change
    at the last boundary, ``change`` (7, 7) and ``entry`` (7,), the log chances of change there and the log
    weights with which states began; ``log_normaliser``, what was taken from the weights to keep their numbers
    small; the exposure that is ``withheld`` while ticks say nothing; ``past``
    (7, L, 7) of each state and ``recent`` beliefs, where answers lag; the last ``belief``.
    """

    model: Model
    knowledge: Knowledge
    averaging: TickState | None
    sliding: Sliding
    banks: tuple[Bank, ...]
    memory: Memory
    reminded: tuple[Reminded, ...]
    log_left: Array
    residual: Array
    leaders: NDArray[np.int64]
    alive: Alive
    ticks: int
    numbers: int
    outliers: int
    label: Contact | None
    free_since: int
    free_since_ns: int
    exposure: float
    change: Array
    entry: Array
    log_normaliser: float
    withheld: float
    past: Array
    recent: tuple[Belief, ...]
    belief: Belief | None

    @property
    def log_evidence(self) -> float:
        """Log probability of all ticks so far, relative to that of free motion (nats)."""
        return self.log_normaliser + float(log_sum_exp(self.log_left))

    @property
    def window(self) -> Window:
        """The last ticks."""
        return self.sliding.window


def start(model: Model, lag_s: float = 0.0, knowledge: Knowledge = NOTHING) -> TrackerState:
    """A tracker that has seen nothing, but may know something.

    With ``lag_s`` it speaks of that long ago, and knows better.
    """
    lag = round(lag_s / model.tick_s)
    length = lag + 1 if lag else 0
    banks = tuple(blank(contact, 0, length) for contact in CONTACT_MODELS)
    past = np.zeros((len(STATES), length, len(STATES)))
    initial, states = log_initial(model), len(STATES)
    return TrackerState(
        model=model,
        knowledge=knowledge,
        averaging=None,
        sliding=NOTHING_SEEN,
        banks=banks,
        memory=NOTHING_MET,
        reminded=tuple(Reminded(NOTHING_MET, None, fresh(contact)) for contact in CONTACT_MODELS),
        log_left=initial,
        residual=np.full(len(CONTACT_MODELS), np.nan),
        leaders=np.full(len(CONTACT_MODELS), -1),
        alive=Alive.of(banks, -1),
        ticks=0,
        numbers=0,
        outliers=0,
        label=None,
        free_since=0,
        free_since_ns=0,
        exposure=0.0,
        change=np.zeros((states, states)),
        entry=initial,
        log_normaliser=0.0,
        withheld=0.0,
        past=past,
        recent=(),
        belief=None,
    )


def scales_of(model: Model) -> Scales:
    """What evidence needs of the model."""
    motion = model.motion
    return Scales(
        model.geometry.reach_m, motion.body_radius_m, motion.foreknowledge, motion.independence, model.tick_s
    )
