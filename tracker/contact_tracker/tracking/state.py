"""The state of a contact filter between two ticks."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.explanations.online_contacts import EMPTY_FORMATION, FormationState
from contact_tracker.geometry.elements import Origins
from contact_tracker.hmm import log_sum_exp
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.map.elements import Key
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.free_motion import FreeMotion
from contact_tracker.motion.free_speed import FreeSpeed
from contact_tracker.motion.poses import NO_OUTLIERS, Outliers
from contact_tracker.motion.window import EMPTY_WINDOW, Window
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.ambiguity import NO_CURVED_MOTION, CurvedMotion
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.transition_model import log_initial


def _constant(array: NDArray[Any]) -> NDArray[Any]:
    """The array as a value that all filters share."""
    array.setflags(write=False)
    return array


class FilterState(NamedTuple):
    """The state of a filter; its size is bounded, however long the stream.

    7 states: the six contacts and free motion; L lagged ticks.
    """

    model: Model
    known_map: Map
    """Known elements."""
    scales: EvidenceParameters
    """Evidence parameters of the model."""
    banks: tuple[Bank, ...]
    """The hypothesis bank of each contact."""
    live_hypotheses: LiveHypotheses
    """The active hypotheses of all banks, and free motion."""
    map: GrowingMap
    """Elements that contacts have touched."""
    prepared_map: GrowingMap
    """The map by which births were proposed before a tick needed them (``ContactFilter.prepare``)."""
    log_state_weight: Array
    """(7,) log weight of each state at the last boundary, up to a constant."""
    log_birth_weight: Array
    """(7,) log birth weights at that boundary."""
    lag_history: Array
    """(7, L, 7) per state: probabilities of the states in the last L ticks."""
    origins: Origins = Origins.zero()
    """Origins of the coordinates of the ticks, once there are some."""
    free_motion: FreeMotion | None = None
    """Free motion by this filter's noise, if its ticks have been averaged for another filter."""
    window: Window = EMPTY_WINDOW
    """The latest ticks by which the hypotheses have been updated."""
    residual: Array = _constant(np.full(len(CONTACT_MODELS), np.nan))
    """(6,) whitened residual of each contact, see ``Belief``."""
    best: NDArray[np.int64] = _constant(np.full((len(CONTACT_MODELS), 3), -1))
    """(6, 3) row, onset tick and onset time (ns) of the best hypothesis in each bank; -1 if it is empty."""
    ticks: int = 0
    """Number of ticks so far."""
    next_hypothesis_id: int = 0
    """Number of the next hypothesis."""
    outliers: Outliers = NO_OUTLIERS
    """Outliers among the poses so far."""
    label: Contact | None = None
    """The most probable state; None before the first tick."""
    free_since: int = 0
    """Number of the tick since which the label is free."""
    free_since_ns: int = 0
    curved: CurvedMotion = NO_CURVED_MOTION
    """The last test of free motion for a curved surface."""
    hazard_exposure: float = 0.0
    """Exposure to change at the last boundary, in ticks of motion."""
    log_transition: Array = _constant(np.zeros((len(STATES), len(STATES))))
    """(7, 7) log probabilities of change at that boundary, from row to column."""
    log_normaliser: float = 0.0
    """Sum of the normalisation constants of the weights (nats)."""
    deferred_exposure: float = 0.0
    """Exposure of uninformative ticks, which counts at the next informative one."""
    recent: tuple[Belief, ...] = ()
    """Beliefs of the last L ticks, with a lag."""
    belief: Belief | None = None
    """The latest belief."""
    free_speed: FreeSpeed | None = None
    """Speed of free motion; None where speed is not weighed."""
    formation: FormationState = EMPTY_FORMATION
    """Search for further contacts."""
    uses_later_contacts: bool = False
    """Whether the map is one of the whole recording, from an earlier pass."""

    @property
    def log_evidence(self) -> float:
        """Log probability of all ticks so far, relative to that of free motion (nats)."""
        return self.log_normaliser + float(log_sum_exp(self.log_state_weight))

    @property
    def knows_elements(self) -> bool:
        """Whether a pose shows if known elements touch."""
        return bool(self.known_map.fixes_elements or self.map.elements or self.map.contacts)

    @property
    def current_pair(self) -> tuple[Key, Key] | None:
        """The pair of the map that touches now, if the label is a contact that has been added to it."""
        if self.label is None or self.label is Contact.FREE:
            return None
        return self.map.pairs.get(int(self.best[self.label.column, 1]))

    def onset_of(self, label: Contact) -> int:
        """The tick in which a label has begun."""
        return self.free_since if label is Contact.FREE else int(self.best[label.column, 1])


def start(model: Model, lag_s: float = 0.0, known_map: Map = EMPTY_MAP) -> FilterState:
    """The state before the first tick.

    With ``lag_s``, beliefs are about the tick that long ago, and use the data since then.
    """
    lag = round(lag_s / model.tick_s)
    length = lag + 1 if lag else 0
    banks = tuple(blank(contact, 0, length) for contact in CONTACT_MODELS)
    empty = GrowingMap(model.geometry.reach_m).with_prior(known_map.prior)
    return FilterState(
        model,
        known_map,
        scales_of(model),
        banks,
        LiveHypotheses.of(banks, -1),
        empty,
        empty,
        log_initial(model),
        log_initial(model),
        np.zeros((len(STATES), length, len(STATES))),
    )


def scales_of(model: Model) -> EvidenceParameters:
    """The evidence parameters of a model."""
    motion = model.motion
    return EvidenceParameters(
        model.geometry.reach_m,
        motion.body_radius_m,
        motion.prior_predictive_share,
        motion.likelihood_exponent,
        model.tick_s,
        model.correlation,
    )
