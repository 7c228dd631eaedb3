"""The online filter of contacts for one model of the noise, as in the figure of docs/theory.md.

tick -> window -> births and transitions -> hypotheses (fit, evidence) -> weights of the states -> belief

Also the forward pass with it over the ticks of a recording.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

import contact_tracker.hmm as hmm
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.lifted_pose import T
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import TickWeights, marginalise_expired_ticks, update_banks
from contact_tracker.hypotheses.births import (
    CachedProposals,
    TickInput,
    prepare_weights,
    propose_births,
    reweight_transitions,
    share_with_faces,
    weigh_births,
)
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.pairs import Frame
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import ORIGIN_M, Tick, TickGrid, with_excess
from contact_tracker.motion.window import NO_REST, NewestRest, Window, advance_window, newest_rest, rest_ticks
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.posterior import lagged_belief, read_posterior, with_rest
from contact_tracker.tracking.state import FilterState, start
from contact_tracker.tracking.transition_model import (
    FACES,
    FREE,
    REST_EXPOSURE,
    REST_LOG_LIKELIHOOD,
    lift_after_rest,
    tick_transitions,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def predict_transitions(
    state: FilterState, tick: Tick, window: Window, rest: NewestRest = NO_REST
) -> TickInput:
    """The prediction for a ``tick``, the newest of the ``window``, from the ``state`` after the tick before.

    If it completes a ``rest``, the likelihood of the rest in each state counts, once per rest.
    """
    model = state.model
    cached = _proposals(state, Frame.around(state.origins, window.zeta[-1, T]))
    proposals, log_odds = cached.proposals, np.zeros(len(STATES))
    exposure = max(window.latest_motion_ratio, REST_EXPOSURE) + state.deferred_exposure
    if state.known_map.lists_elements:  # known elements come into contact by any displacement, however smooth
        exposure = max(exposure, window.displacement_ratio)
    ordinary = tick_transitions(model, exposure)
    transition, survival = lift_after_rest(ordinary) if rest.ends else ordinary
    if state.knows_elements:
        extra_variance = model.noise.extra_contact_variance
        proposals, odds, gain = weigh_births(proposals, window, extra_variance, state.scales)
        if not state.known_map.lists_elements:
            odds, gain = share_with_faces(odds, gain, model.geometry.revisit_prior)
        log_odds[:-1] = odds
        transition, survival = reweight_transitions(transition, survival, log_odds[:-1], gain)
    if rest.completes:
        transition, survival = transition + REST_LOG_LIKELIHOOD[:, None], survival + REST_LOG_LIKELIHOOD
    if state.ticks:
        birth_weight = hmm.birth_log_weights(state.log_state_weight, transition)
    else:
        if state.map.prior:  # an object that stands when a recording begins may stand on any of its faces
            log_odds[FACES] = max(log_odds[FACES], 0.0)
        birth_weight = state.log_state_weight + log_odds
        birth_weight = birth_weight - hmm.log_sum_exp(birth_weight) if state.knows_elements else birth_weight
    past = state.lag_history
    if past.size:
        past = hmm.inherited_past(past, state.log_state_weight, transition)
    return TickInput(
        proposals,
        cached,
        state.ticks,
        tick.start_ns,
        state.next_hypothesis_id,
        past,
        window,
        state.window,
        exposure,
        transition,
        survival,
        birth_weight,
    )


def _proposals(state: FilterState, frame: Frame) -> CachedProposals:
    """Birth proposals of each contact by the present map; those with unchanged inputs are reused."""
    if state.uses_later_contacts:
        left_out, current = state.map.shown_after(state.ticks, state.model.tick_s), None
        latest = state.map.latest_before(state.ticks)
    else:
        left_out, current, latest = (), state.current_pair, state.map.whole.latest
    cached, fresh = state.cached_proposals, CachedProposals(state.map, left_out, current, latest, frame, ())
    if fresh[:-1] == cached[:-1]:
        return cached
    view = replace(
        state.map.without(left_out) if left_out else state.map.whole, current=current, latest=latest
    )
    share = state.model.geometry.revisit_prior
    if state.uses_later_contacts:
        view = view.with_incident_vertices(share, state.map.reach_m)
    return fresh._replace(
        proposals=tuple(
            kept
            if fresh.inputs(contact) == cached.inputs(contact)
            else propose_births(contact, state.known_map, view, share, frame)
            for contact, kept in zip(CONTACT_MODELS, cached.proposals, strict=True)
        )
    )


@dataclass(eq=False)
class ContactFilter:
    """Semi-Markov filter over the six contacts and free motion, for one model of the noise."""

    state: FilterState

    @classmethod
    def start(cls, model: Model, lag_s: float = 0.0, known_map: Map = EMPTY_MAP) -> Self:
        """The filter before the first tick.

        With ``lag_s``, reported beliefs are about the tick that long ago, and use the data since then.
        """
        return cls(start(model, lag_s, known_map))

    def update(self, tick: Tick, detail: Detail = Detail.FORMATION, tests_curvature: bool = True) -> Belief:
        """Update by a tick; the belief about it has this ``detail``."""
        state = self.state if self.state.ticks else set_origins(self.state, tick)
        window = advance_window(state.window, state.ticks, tick, state.model)
        rest = newest_rest(window, state.model.tick_s)
        if is_uninformative(state, tick, window, rest):  # in gaps, and at rest
            state, belief = pass_tick(state, tick, window)
        else:
            change = predict_transitions(state, tick, window, rest)  # and births, by the map
            banks, weights = update_banks(state.banks, change, state.model, state.scales)  # fit, evidence
            state = update_state(state, tick, change, banks, weights)  # HMM
            state, belief = read_posterior(state, tick, detail, tests_curvature)  # and the map
        self.state, belief = with_rest(state, belief, rest.is_in_rest)
        return belief

    def prepare(self) -> None:
        """Propose the births of the next tick by a map that has changed, before a pose waits for them."""
        state = self.state
        if state.ticks:
            cached = _proposals(state, Frame.around(state.origins, state.window.zeta[-1, T]))
            prepare_weights(cached.proposals)
            self.state = state._replace(cached_proposals=cached)

    @property
    def reported(self) -> Belief | None:
        """The belief to report: the latest, or with a lag the earlier one, once there is one."""
        length = self.state.lag_history.shape[1]
        if not length:
            return self.state.belief
        return lagged_belief(self.state, 0) if len(self.state.recent) == length else None

    def finish(self) -> list[Belief]:
        """At the end of the stream: the beliefs that the lag has withheld. No tick is reported twice."""
        recent, length = self.state.recent, self.state.lag_history.shape[1]
        first = 1 if len(recent) == length else 0
        beliefs = [lagged_belief(self.state, row) for row in range(first, len(recent))]
        self.state = self.state._replace(recent=())
        return beliefs

    def with_own_innovations(self, tick: Tick) -> Tick:
        """A tick that was averaged for another filter, with the innovations by this filter's noise."""
        motion, own_tick = with_excess(self.state.free_motion, tick, self.state.model)
        self.state = self.state._replace(free_motion=motion)
        return own_tick


_BORN: Final = attrgetter("is_given")


def set_origins(state: FilterState, tick: Tick) -> FilterState:
    """The state before the first tick, in the coordinates of the ticks."""
    return state._replace(origins=tick.origins, map=state.map.at_origins(tick.origins))


def is_uninformative(state: FilterState, tick: Tick, window: Window, rest: NewestRest) -> bool:
    """Whether neither this tick nor the one before carries information: at rest, in a gap, or before the
    strength of motion is known. Births at such a tick can wait for the next informative one without changing
    the posterior. With known elements every tick is informative, since it shows whether they touch; with
    elements of the map, every tick up to the one that completes a rest, except after a gap."""
    if state.belief is None or state.known_map.lists_elements or tick.innovation_excess != NO_EXCESS:
        return False
    if state.window.innovation_excess[-1].any() or rest.ends:
        return False
    assert window.frames is not None
    if state.knows_elements and window.frames[-rest_ticks(state.model.tick_s) :].all():
        return rest.is_in_rest and not rest.completes
    return not rest.completes


def pass_tick(state: FilterState, tick: Tick, window: Window) -> tuple[FilterState, Belief]:
    """Pass over an uninformative tick, which does not change the belief: it is only appended to the window,
    and its exposure to change is deferred to the next informative tick."""
    assert state.belief is not None
    oldest, banks = state.window.expired_by(window), state.banks
    if oldest.innovation_excess.any():  # the terms of other ticks are zero, as no element is known
        errors = state.model.noise.extra_contact_variance
        banks = tuple(
            marginalise_expired_ticks(bank, contact, oldest.with_error(variance), state.scales)
            for bank, contact, variance in zip(banks, CONTACT_MODELS, errors, strict=True)
        )
    change, birth_weight = state.log_transition, state.log_birth_weight
    if state.hazard_exposure:  # the tick before was informative
        change = tick_transitions(state.model, 0.0).log_transition
        birth_weight = hmm.birth_log_weights(state.log_state_weight, change)
    histories = state.lag_history
    if histories.size:
        banks = _with_longer_histories(banks)
        histories = np.array([hmm.grown_past(past, column) for column, past in enumerate(histories)])
    passed = state._replace(
        window=window,
        banks=banks,
        live_hypotheses=state.live_hypotheses.at_tick(state.ticks),
        ticks=state.ticks + 1,
        next_hypothesis_id=state.next_hypothesis_id + 1,
        outliers=state.outliers.joined(tick.outliers),
        hazard_exposure=0.0,
        log_transition=change,
        log_birth_weight=birth_weight,
        deferred_exposure=state.deferred_exposure + REST_EXPOSURE,
        lag_history=histories,
    )
    return passed, replace(state.belief, stamp_ns=tick.stamp_ns)


def update_state(
    state: FilterState, tick: Tick, change: TickInput, banks: Sequence[Bank], weights: TickWeights
) -> FilterState:
    """The state after an informative tick, with the updated banks and weights."""
    past = change.lag_history
    if past.size:
        banks, free = _with_longer_histories(banks), hmm.grown_past(past[FREE], FREE)
        past = np.array([*(hmm.mixed_past(b.lag_history, b.log_weight) for b in banks), free])
    was_free, outliers = state.label is Contact.FREE, state.outliers
    if tick.outliers.total:
        outliers = outliers.joined(tick.outliers)
    return state._replace(
        window=change.window,
        cached_proposals=change.cached_proposals,
        ticks=state.ticks + 1,
        next_hypothesis_id=state.next_hypothesis_id + sum(map(len, map(_BORN, change.proposals))) + 1,
        deferred_exposure=0.0,
        banks=tuple(banks),
        log_state_weight=weights.log_state_weight,
        residual=weights.residual,
        best=weights.best,
        live_hypotheses=weights.live_hypotheses,
        outliers=outliers,
        free_since=state.free_since if was_free else state.ticks,
        free_since_ns=state.free_since_ns if was_free else tick.start_ns,
        hazard_exposure=change.hazard_exposure,
        log_transition=change.log_transition,
        log_birth_weight=weights.log_birth_weight,
        log_normaliser=state.log_normaliser
        + float(weights.log_birth_weight[FREE] - weights.log_state_weight[FREE]),
        lag_history=past,
    )


def _with_longer_histories(banks: Sequence[Bank]) -> tuple[Bank, ...]:
    """The banks with their lag histories extended by a tick in the state of each."""
    return tuple(
        replace(bank, lag_history=hmm.grown_past(bank.lag_history, column))
        for column, bank in enumerate(banks)
    )


class FilteredTick(NamedTuple):
    """One tick of the pass: the ``state`` after it, the ``tick``, and the ``belief``."""

    state: FilterState
    tick: Tick
    belief: Belief

    @property
    def numbers(self) -> Index:
        """Numbers (A,) that identify the active hypotheses in the whole recording."""
        return np.append(Bank.of_all(self.state.banks, "number"), self.state.next_hypothesis_id - 1)


def ticks_of(
    parts: Iterable[Poses],
    model: Model,
    progress: Callable[[int], None] | None = None,
    body_m: Array = ORIGIN_M,
) -> Iterator[Tick]:
    """The ticks of a recording, each as soon as it is over.

    Parameters
    ----------
    parts : validated poses in order of time, in batches.
    progress : called after each batch of poses with the number of those read so far.
    body_m : (3,) point of the body that is tracked, see ``sensor_noise.independent_point``.
    """
    grid, count = TickGrid(model, body_m), 0
    for batch in parts:
        yield from grid.add(batch) if len(batch) else ()
        count += len(batch)
        if progress is not None:
            progress(count)
    yield from grid.close()


def forward(
    ticks: Iterable[Tick], filter_: ContactFilter, detail: Detail = Detail.GEOMETRY
) -> Iterator[FilteredTick]:
    """Update a filter by ticks; the beliefs have this ``detail``."""
    for tick in ticks:
        belief = filter_.update(tick, detail)
        yield FilteredTick(filter_.state, tick, belief)
