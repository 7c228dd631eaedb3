"""The online filter of contacts for one model of the noise, as in the figure of docs/theory.md.

tick -> window -> births and transitions -> hypotheses (fit, evidence) -> weights of the states -> belief

Also the ticks of a recording.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Final, Self

import numpy as np
from scipy.special import expit

import contact_tracker.hmm as hmm
from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.explanations import online_contacts
from contact_tracker.explanations.conditional_contact import ExplainedTicks, KnownContact
from contact_tracker.geometry.elements import opposite
from contact_tracker.geometry.lifted_pose import T
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import (
    TickWeights,
    fit_window,
    marginalise_expired_ticks,
    update_banks,
)
from contact_tracker.hypotheses.births import (
    BirthProposals,
    TickInput,
    map_evidence,
    prepare_weights,
    propose_births,
    reweight_transitions,
    share_with_faces,
    weigh_births,
)
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.hypotheses.observability import element_estimate, fitted_contact
from contact_tracker.map.association import MAP_INSERTION_PROBABILITY, MapView, Sighting
from contact_tracker.map.elements import Key, is_same_element, kinds_of
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.pairs import Frame
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.free_speed import FreeSpeed
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import ORIGIN_M, Tick, TickGrid, with_excess
from contact_tracker.motion.window import NO_REST, NewestRest, Window, advance_window, newest_rest, rest_ticks
from contact_tracker.states import STATES, Contact, united
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.ambiguity import NO_CURVED_MOTION, update_curved_motion
from contact_tracker.tracking.belief import Belief, Detail, FurtherContact
from contact_tracker.tracking.posterior import (
    beside_indistinguishable,
    label_fit,
    label_posterior,
    lagged_belief,
    state_shares,
)
from contact_tracker.tracking.state import FilterState, start
from contact_tracker.tracking.transition_model import (
    FACES,
    FREE,
    REST_EXPOSURE,
    REST_LOG_LIKELIHOOD,
    lift_after_rest,
    tick_transitions,
)


def predict_transitions(
    state: FilterState, tick: Tick, window: Window, rest: NewestRest = NO_REST
) -> TickInput:
    """The prediction for a ``tick``, the newest of the ``window``, from the ``state`` after the tick before.

    If it completes a ``rest``, the likelihood of the rest in each state counts, once per rest.
    """
    model = state.model
    proposals = _proposals(state, Frame.around(state.origins, window.zeta[-1, T]))
    log_odds = np.zeros(len(STATES))
    exposure = max(window.latest_motion_ratio, REST_EXPOSURE) + state.deferred_exposure
    if state.known_map.fixes_elements:  # known elements come into contact by any displacement, however smooth
        exposure = max(exposure, window.displacement_ratio)
    ordinary = tick_transitions(model, exposure)
    transition, survival = lift_after_rest(ordinary) if rest.ends else ordinary
    if state.knows_elements:
        extra_variance = model.noise.extra_contact_variance
        proposals, odds, gain = weigh_births(proposals, window, extra_variance, state.scales)
        if not state.known_map.fixes_elements:
            odds, gain = share_with_faces(odds, gain, model.geometry.revisit_prior)
        log_odds[:-1] = odds
        transition, survival = reweight_transitions(transition, survival, log_odds[:-1], gain)
    if speed_evidence := _speed_evidence(state, window):
        transition = transition.copy()
        transition[:, FREE] += speed_evidence
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
        speed_evidence,
    )


def _speed_evidence(state: FilterState, window: Window) -> float:
    """Evidence (nats) of the newest tick for free motion, by its speed; zero where that is not weighed."""
    log_speed = None if state.free_speed is None else window.log_speed(state.model.tick_s)
    return (
        0.0 if state.free_speed is None or log_speed is None else state.free_speed.added_evidence(log_speed)
    )


def _learn_speed(state: FilterState, p_free: float) -> FreeSpeed | None:
    """The speed of free motion after a tick that is free with this probability."""
    log_speed = None if state.free_speed is None else state.window.log_speed(state.model.tick_s)
    if state.free_speed is None or log_speed is None:
        return state.free_speed
    return state.free_speed.update(log_speed, p_free)


def _proposals(state: FilterState, frame: Frame) -> tuple[BirthProposals, ...]:
    """Birth proposals of each contact by the present map; as the same objects while their inputs stay the
    same. The place of the body matters only to edges and vertices of the environment."""
    if state.uses_later_contacts:
        left_out, current = state.map.shown_after(state.ticks, state.model.tick_s), None
        latest, reach_m = state.map.latest_before(state.ticks), state.map.reach_m
    else:
        left_out, current, latest, reach_m = (), state.current_pair, state.map.whole.latest, None
    share = state.model.geometry.revisit_prior
    return _births(state.map, state.known_map, frame, current, left_out, latest, share, reach_m)


def pairs_touched_elsewhere(
    state: FilterState, label: Contact, window: Window, first: int, shown: Sequence[Sighting] | None = None
) -> BirthProposals | None:
    """Proposals of a contact by the fixed elements, and by what contacts of this recording have touched
    outside of the ticks from number ``first`` to the end of the ``window``; None for free motion, and without
    such elements. With ``shown``, only what these sightings, which know later ticks, confirm."""
    end = int(window.index[-1]) + 1
    within = tuple(
        s.first
        for s in state.map.sightings
        if (s.first < end and s.end > first) or not (shown is None or any(map(s.is_part_of, shown)))
    )
    is_anything_known = state.known_map.fixes_elements or len(within) < len(state.map.sightings)
    if label is Contact.FREE or not is_anything_known:
        return None
    frame = Frame.around(state.origins, window.zeta[:, T].mean(axis=0))
    model, kinds = _KINDS[label.column]
    of_map = state.map.without_prior, state.known_map, within, None, 0.0, None
    return _births_of(model, _near(frame, kinds[1]), None, *of_map)


def _near(frame: Frame, kind: str) -> Frame:
    """The frame for an element of the environment of this kind: it has no place for a face, for which the
    place does not matter."""
    return frame._replace(near_m=(0.0, 0.0, 0.0)) if kind == "f" else frame


_KINDS: Final = [(model, kinds_of(model)) for model in CONTACT_MODELS]
"""Each contact, and the kinds of its elements."""


@lru_cache(maxsize=32)  # of some filters, as labels and places recur
def _births(
    world: GrowingMap,
    known_map: Map,
    frame: Frame,
    current: tuple[Key, Key] | None,
    left_out: tuple[int, ...],
    latest: tuple[Key, Key] | None,
    share: float,
    reach_m: float | None,
) -> tuple[BirthProposals, ...]:
    """Birth proposals of each contact by the map ``world`` without the sightings ``left_out``: the ``latest``
    pair touched last, and the ``current`` one touches. With ``reach_m`` edges and faces of the map have
    vertices (``with_incident_vertices``)."""
    touching = None if current is None else tuple([world.elements[key].kind for key in current])
    of_map = world, known_map, left_out, latest, share, reach_m
    return tuple(
        [
            _births_of(model, _near(frame, kinds[1]), current if kinds == touching else None, *of_map)
            for model, kinds in _KINDS
        ]
    )


@lru_cache(maxsize=128)  # of six contacts, as the label or the place changes
def _births_of(
    model: ContactModel,
    frame: Frame,
    current: tuple[Key, Key] | None,
    world: GrowingMap,
    known_map: Map,
    left_out: tuple[int, ...],
    latest: tuple[Key, Key] | None,
    share: float,
    reach_m: float | None,
) -> BirthProposals:
    view = replace(_view(world, left_out, share, reach_m), current=current, latest=latest)
    return propose_births(model, known_map, view, share, frame)


@lru_cache(maxsize=16)
def _view(world: GrowingMap, left_out: tuple[int, ...], share: float, reach_m: float | None) -> MapView:
    view = world.without(left_out) if left_out else world.whole
    return view if reach_m is None else view.with_incident_vertices(share, reach_m)


@dataclass(eq=False)
class ContactFilter:
    """Semi-Markov filter over the six contacts and free motion, for one model of the noise."""

    state: FilterState

    @classmethod
    def start(
        cls,
        model: Model,
        lag_s: float = 0.0,
        known_map: Map = EMPTY_MAP,
        free_speed: FreeSpeed | None = None,
    ) -> Self:
        """The filter before the first tick.

        With ``lag_s``, reported beliefs are about the tick that long ago, and use the data since then. With
        ``free_speed``, speed is evidence.
        """
        return cls(start(model, lag_s, known_map)._replace(free_speed=free_speed))

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
            prepare_weights(_proposals(state, Frame.around(state.origins, state.window.zeta[-1, T])))
        self.state = state._replace(prepared_map=state.map)

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
    if state.belief is None or state.known_map.fixes_elements or tick.innovation_excess != NO_EXCESS:
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
    normaliser = float(weights.log_birth_weight[FREE] - weights.log_state_weight[FREE])
    if change.speed_evidence:  # which tells nothing about the model of the noise
        p_free = np.exp(weights.log_state_weight[FREE] - hmm.log_sum_exp(weights.log_state_weight))
        normaliser += float(np.log1p(p_free * np.expm1(-change.speed_evidence)))
    return state._replace(
        window=change.window,
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
        log_normaliser=state.log_normaliser + normaliser,
        lag_history=past,
    )


def _with_longer_histories(banks: Sequence[Bank]) -> tuple[Bank, ...]:
    """The banks with their lag histories extended by a tick in the state of each."""
    return tuple(
        replace(bank, lag_history=hmm.grown_past(bank.lag_history, column))
        for column, bank in enumerate(banks)
    )


ESTABLISHED: Final = 0.8
"""Further contacts are searched beside a label of at least this probability..."""
ESTABLISHED_TICKS: Final = 20
"""... that has lasted this many ticks..."""
STILL_ESTABLISHED: Final = 0.5
"""... and are reported while the label has at least this probability."""


def read_posterior(
    state: FilterState, tick: Tick, detail: Detail, tests_curvature: bool
) -> tuple[FilterState, Belief]:
    """The belief after a tick, whose evidence is in ``state``; certain elements are added to the map.

    One filter of a bank ``tests_curvature``: whether free motion is on a curved surface.
    """
    shares = state_shares(state)
    probability = ambiguity.tempered(shares, state.model.certainty.posterior_power)
    label = STATES[int(probability.argmax())]
    onset_ns = state.free_since_ns if label is Contact.FREE else int(state.best[label.column, 2])
    fit = label_fit(state, label) if detail >= Detail.GEOMETRY else None
    shared = belief = Belief(tick.stamp_ns, label, probability, onset_ns, fit, state.residual)
    state = state._replace(label=label, free_speed=_learn_speed(state, float(shares[FREE])))
    is_due = _should_update_map(state, belief)
    if detail >= Detail.SHARED or is_due:
        if label is not Contact.FREE:
            state = state._replace(curved=NO_CURVED_MOTION)
        elif tests_curvature:  # at intervals
            motion = state.curved, state.window, state.free_since, state.scales, state.known_map
            state = state._replace(curved=update_curved_motion(*motion, state.map.touched_faces))
        shared = beside_indistinguishable(state, belief)
    if is_due and not shared.inseparable:
        state = state._replace(map=state.map.insert(label_sighting(state, label, tick.stamp_ns)))
    if detail >= Detail.SHARED:
        belief = decide_on_map(state, shared)
    if detail >= Detail.FORMATION:
        state, belief = follow_formation(state, belief, tick)
    elif state.formation is not online_contacts.EMPTY_FORMATION:
        state = state._replace(formation=online_contacts.suspend(state.formation))
    return state, belief


def _should_update_map(state: FilterState, belief: Belief) -> bool:
    """Whether the labelled contact is certain enough for the map, and due."""
    if (
        state.uses_later_contacts
        or belief.contact is Contact.FREE
        or belief.probability.max() < MAP_INSERTION_PROBABILITY
    ):
        return False
    return belief.stamp_ns >= state.map.due_ns.get(belief.onset_ns, belief.stamp_ns)


def decide_on_map(state: FilterState, belief: Belief) -> Belief:
    """The belief without the indistinguishable states against which the newest pose is evidence, since it is
    on elements that contacts before the label's onset have touched, and that are the label's as well."""
    label = belief.contact
    if not belief.inseparable or label is Contact.FREE:
        return belief
    onset = state.onset_of(label)
    pairs = pairs_touched_elsewhere(state, label, state.window.since(onset), onset)
    if pairs is None:
        return belief
    on_map, touched = map_evidence(CONTACT_MODELS[label.column], pairs, state.window.cut(-1), state.scales)
    inseparable = tuple(rival for rival in belief.inseparable if on_map[rival.column] < DECISIVE)
    if len(inseparable) == len(belief.inseparable) or not _is_on(state, belief, pairs, touched):
        return belief
    return replace(belief, inseparable=inseparable)


def _is_on(state: FilterState, belief: Belief, pairs: BirthProposals, touched: int) -> bool:
    """Whether the label's contact is with the same element of the environment as the ``touched`` pair, whose
    normals have no sense."""
    contact, newest, errors = (
        CONTACT_MODELS[belief.contact.column],
        state.window.cut(-1),
        state.model.systematic,
    )
    at_pose = fit_window(contact, newest, state.scales, pairs.pick(np.array([touched])))
    pair = fitted_contact(at_pose, 0, contact, state.scales, newest, state.origins, errors)
    own = belief.geometry
    if own is None:
        fit = label_fit(state, belief.contact)
        assert fit is not None
        own = fit.geometry
    own_world, world = own.environment, pair.geometry.environment
    return is_same_element(own_world, world) or is_same_element(opposite(own_world), world)


def open_beside(state: FilterState, belief: Belief) -> Belief:
    """The belief in which other contacts that fit as well are indistinguishable from the label, if there are
    further contacts beside it."""
    label, known_map = belief.contact, state.known_map
    if not belief.further:
        return belief
    onset = state.onset_of(label)
    rivals = ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1)
    others = united(*(contact.inseparable for contact in belief.further))
    alike = filter(known_map.allows, ambiguity.alike_in_formation(label, rivals, others))
    return replace(belief, inseparable=united(belief.inseparable, alike))


def with_rest(state: FilterState, belief: Belief, is_in_rest: bool) -> tuple[FilterState, Belief]:
    """The state and the belief to report after a tick: a rest does not distinguish the label from
    other states, and beside indistinguishable states the label is not certain."""
    if is_in_rest:
        open_at_rest = ambiguity.others_at_rest(belief.contact, state.known_map, belief.inseparable)
        belief = replace(belief, inseparable=open_at_rest or belief.inseparable)
    if belief.inseparable or belief.is_open:
        args = belief.inseparable, state.known_map, belief.is_open
        probability = ambiguity.reported(label_posterior(state), belief.contact, *args)
        belief = replace(belief, probability=probability)
    length = state.lag_history.shape[1]
    recent = (*state.recent, belief)[-length:] if length else ()
    return state._replace(recent=recent, belief=belief), belief


def label_sighting(state: FilterState, label: Contact, stamp_ns: int) -> Sighting:
    """The estimate of the elements by the best hypothesis of ``label``, a contact."""
    bank, contact = state.banks[label.column], CONTACT_MODELS[label.column]
    row, onset, _ = state.best[label.column].tolist()
    hypothesis = bank.single(row)
    since = state.window.since(onset).with_error(state.model.noise.extra_contact_variance[label.column])
    estimate = element_estimate(hypothesis, contact, state.scales, since)
    return Sighting(onset, state.ticks, estimate, int(hypothesis.onsets.onset_ns[0]), stamp_ns)


def follow_formation(state: FilterState, belief: Belief, tick: Tick) -> tuple[FilterState, Belief]:
    """Update the further contacts after an informative tick; returns the state and the belief with them."""
    label = belief.contact
    least = STILL_ESTABLISHED if state.formation.present else ESTABLISHED
    if label is Contact.FREE or belief.probability[label.column] < least:
        return state._replace(formation=online_contacts.suspend(state.formation)), belief
    window, (row, onset, _) = state.window, state.best[label.column].tolist()
    first_row, length = int(window.index.searchsorted(onset)), window.index.size
    if length - first_row < ESTABLISHED_TICKS:
        return state._replace(formation=online_contacts.suspend(state.formation)), belief
    labelled = KnownContact(label, state.banks[label.column].rows["x"][row].copy())
    beyond, excess = state.model.noise.extra_contact_variance[label.column], window.innovation_excess[-1]
    moved_ticks = float((excess / (excess + window.variance[-1] + beyond)).max(initial=0.0))
    formation = state.formation._replace(unsearched_ticks=state.formation.unsearched_ticks + moved_ticks)
    if formation.is_due:
        latest = window.cut(max(first_row, length - online_contacts.WINDOW_TICKS), None).with_error(beyond)
        ticks = ExplainedTicks(
            latest,
            state.scales,
            state.model.systematic,
            state.model.transitions.leave_per_s,
            state.origins,
            state.known_map,
        )
        formation = online_contacts.advance(formation, ticks, labelled)
    state = state._replace(formation=formation)
    if formation.tracked:
        belief = open_beside(state, replace(belief, further=_reported(state, belief, tick)))
    if formation.is_open:
        belief = replace(belief, is_open=True)
    return state, belief


def _reported(state: FilterState, belief: Belief, tick: Tick) -> tuple[FurtherContact, ...]:
    """The further contacts present now; ticks are ``tick_ns`` of the model apart."""
    power, newest = state.model.certainty.posterior_power, state.ticks - 1
    return tuple(
        FurtherContact(
            contact.known.contact,
            float(expit(power * contact.log_odds)) * ambiguity.most_beside(len(contact.inseparable)),
            max(tick.start_ns - (newest - contact.runs[-1].first) * state.model.tick_ns, belief.onset_ns),
            None,
            contact.geometry,
            contact.inseparable,
            state.formation.constraints,
        )
        for contact in state.formation.present
    )


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
