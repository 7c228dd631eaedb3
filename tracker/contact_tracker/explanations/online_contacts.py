"""Online detection of further contacts, with bounded work in each tick (docs/theory.md, section 18).

At intervals the latest ticks are tested for constraints beyond those of the known contacts. If they may keep
one, contact kinds are searched, one in each tick. Contacts that were found are evaluated in every tick.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.explanations.conditional_contact import (
    SAME_ROW,
    ConditionalMotion,
    Presence,
    Run,
    coefficients,
    count_constraints,
    perturbed,
)
from contact_tracker.explanations.further_contacts import (
    MAX_FURTHER,
    SURE_NATS,
    Candidate,
    FormationTicks,
    KnownContact,
    allowed,
    best_of,
    confirm,
    evaluate,
    inseparable_kinds,
    promising_kinds,
    refine,
    search_span,
)
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.hypotheses import compiled
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact

WINDOW_TICKS: Final = 150
"""Number of latest ticks over which further contacts are evaluated."""
SEARCH_SPANS_TICKS: Final = (30, 50, 100)
"""Numbers of latest ticks that are tested for further constraints."""
SEARCH_INTERVAL_TICKS: Final = 5.0
MAX_SEARCH_INTERVAL_TICKS: Final = 20.0
"""Ticks with motion between two tests; the interval doubles after each unsuccessful one up to the second."""
REFIT_SHARE: Final = 0.5
"""Growth of their run since the last fit at which elements are refitted."""
MAX_REMEMBERED: Final = 3
COUNTED_TICKS: Final = 20
"""Number of latest ticks over which constraints are counted."""


class TrackedContact(NamedTuple):
    """A further contact that was found in tick ``since``, still present or not."""

    elements: KnownContact
    geometry: ContactGeometry
    inseparable: tuple[Contact, ...]
    log_odds: float
    since: int
    is_present: bool
    refit_at: int
    """Tick at which the elements are refitted next."""


class FormationState(NamedTuple):
    """State of the search for further contacts while the ``first`` holds; bounded in size.

    Attributes
    ----------
    tracked : further contacts found so far, present or not.
    remembered : elements of earlier contacts, which may touch again.
    queue : contact kinds still to be searched in the last ``span`` ticks.
    proposals : results of this search so far.
    searches_all : whether all kinds are searched, or single constraints only.
    ticks_since_search, search_interval : ticks with motion since the last test, and until the next.
    is_open : whether the motion keeps more constraints than the reported contacts explain.
    constraints : of the first contact and of all that are present.
    """

    first: KnownContact | None = None
    tracked: tuple[TrackedContact, ...] = ()
    remembered: tuple[KnownContact, ...] = ()
    queue: tuple[Contact, ...] = ()
    span: int = 0
    proposals: tuple[KnownContact, ...] = ()
    searches_all: bool = False
    ticks_since_search: float = 0.0
    search_interval: float = SEARCH_INTERVAL_TICKS
    is_open: bool = False
    constraints: int = 0


EMPTY_FORMATION: Final = FormationState()


def with_first(
    state: FormationState, first: KnownContact, window: Window, moved_ticks: float
) -> FormationState:
    """The state with this first contact in the newest tick of the window, ``moved_ticks`` of motion later.

    If it constrains this tick otherwise than the previous one, all contacts become remembered elements.
    """
    previous, model = state.first, CONTACT_MODELS[first.contact.column]
    since = state.ticks_since_search + moved_ticks
    if previous is None or (
        previous.contact is first.contact
        and constraints_of_two(model, np.array([previous.x, first.x]), window) == first.contact.codimension
    ):
        return state._replace(first=first, ticks_since_search=since)
    elements = [previous, *(contact.elements for contact in state.tracked), *state.remembered]
    remembered = tuple(elements[:MAX_REMEMBERED])
    return FormationState(first, remembered=remembered, search_interval=0.0, ticks_since_search=moved_ticks)


def constraints_of_two(model: ContactModel, x: Array, window: Window) -> int:
    """Number of independent constraints that two contacts of one kind, with elements x (2, S), impose
    together in the newest tick."""
    if not compiled.in_use():
        return count_constraints(perturbed(window.zeta[-1:]), [*coefficients(model, x)])
    from contact_tracker.hypotheses.compiled import calls

    return calls.count_constraints(calls.model_of(model, 1.0), calls.ticks_of(window), x, SAME_ROW)


def advance(state: FormationState, ticks: FormationTicks, first: KnownContact) -> FormationState:
    """The state after the newest of ``ticks``, in all of which the ``first`` contact holds.

    ``state`` is that of ``with_first``, and stays as it is if no further contact is tracked or sought.
    """
    searches = bool(state.queue) or state.ticks_since_search >= state.search_interval
    motion = ConditionalMotion.of(ticks.window, ticks.scales).keeping(first.c)
    tracked = list[TrackedContact]()
    for contact in state.tracked:
        evaluated, runs = _evaluated(contact, ticks, motion)
        tracked.append(evaluated)
        for run in runs:
            motion = motion.keeping(contact.elements.c, *run)
    state = state._replace(tracked=tuple(tracked), constraints=_count(tracked, motion, first))
    if sum(contact.is_present for contact in tracked) >= MAX_FURTHER:
        return state._replace(queue=(), proposals=())
    if state.queue:
        return _continue_search(state, ticks, motion, first)
    return _begin_search(state, ticks, motion) if searches else state


def _count(tracked: Sequence[TrackedContact], motion: ConditionalMotion, first: KnownContact) -> int:
    """Number of constraints of the first contact and of those present, on the latest ticks."""
    present = [contact.elements.c for contact in tracked if contact.is_present]
    if not present:
        return first.contact.codimension
    return count_constraints(motion.moved[-COUNTED_TICKS:], [first.c, *present])


def suspend(state: FormationState) -> FormationState:
    """The state while there is no first contact: no further contact is present, and the search is dropped."""
    tracked = tuple(contact._replace(is_present=False) for contact in state.tracked)
    return state._replace(tracked=tracked, queue=(), proposals=(), is_open=False)


def _evaluated(
    contact: TrackedContact, ticks: FormationTicks, motion: ConditionalMotion
) -> tuple[TrackedContact, tuple[Run, ...]]:
    """The contact after the newest tick, and the runs in which it was present."""
    candidate = evaluate(ticks, motion, contact.elements)
    if candidate is None or candidate.presence.log_odds <= 0.0:
        return contact._replace(is_present=False), ()
    runs, log_odds = candidate.presence
    last = runs[-1]
    if last.end < len(motion):
        return contact._replace(is_present=False, log_odds=log_odds), runs
    begins = int(ticks.window.index[last.first])
    since = min(contact.since, begins) if contact.is_present else begins
    if contact.is_present:
        log_odds = max(log_odds, contact.log_odds)
    is_present = contact.is_present or log_odds > SURE_NATS
    contact = contact._replace(is_present=is_present, log_odds=log_odds, since=since)
    newest = int(ticks.window.index[-1])
    if is_present and newest >= contact.refit_at:
        refined = refine(ticks, motion, candidate, last)
        if refined is None:  # its elements are kept
            return contact._replace(refit_at=_refit_at(newest, last)), runs
        geometry = ticks.geometry_of(refined)
        if geometry is None:
            return contact._replace(is_present=False), runs
        refit_at = _refit_at(newest, last)
        contact = contact._replace(elements=refined.elements, geometry=geometry, refit_at=refit_at)
    return contact, runs


def _refit_at(newest: int, run: Run) -> int:
    return newest + max(round(REFIT_SHARE * (run.end - run.first)), 1)


def _begin_search(state: FormationState, ticks: FormationTicks, motion: ConditionalMotion) -> FormationState:
    """Evaluate the remembered elements; if none is present, queue constraints that may be kept now."""
    interval = max(state.search_interval, SEARCH_INTERVAL_TICKS)
    state = state._replace(ticks_since_search=0.0, search_interval=interval)
    best = best_of(_present(state.remembered, ticks, motion))
    if best is not None:
        return _queue_all_kinds(state, best, ticks)
    spans = [min(span, len(motion)) for span in SEARCH_SPANS_TICKS if span < 2 * len(motion)]
    tests = [(*promising_kinds(motion.cut(len(motion) - span, len(motion))), span) for span in spans]
    _, models, span = max(tests, key=lambda test: test[0])
    if not models:
        return state._replace(is_open=False)
    kinds = tuple(model.contact for model in models)
    return state._replace(queue=kinds, span=span, proposals=(), searches_all=False)


def _continue_search(
    state: FormationState, ticks: FormationTicks, motion: ConditionalMotion, first: KnownContact
) -> FormationState:
    """Search the next kind; after the last, accept the best proposal or continue with all kinds."""
    run = Run(max(len(motion) - state.span, 0), len(motion))
    candidate = search_span(ticks, motion, CONTACT_MODELS[state.queue[0].column], run)
    new = () if candidate is None else (candidate.elements,)
    state = state._replace(queue=state.queue[1:], proposals=(*state.proposals, *new))
    if state.queue:
        return state
    candidates = [*_present(state.proposals, ticks, motion)]
    if state.searches_all:
        candidates = allowed(ticks, candidates)
    best = best_of(candidates)
    if best is None and candidates:
        # its elements may be fitted to a part of its run only
        best = max(candidates, key=lambda candidate: candidate.presence.log_odds)
        best = best_of([refine(ticks, motion, best, best.presence.runs[-1]) or best])
    if best is None:
        # a contact that is present now may be reported once it has lasted longer
        doubled = min(2.0 * state.search_interval, MAX_SEARCH_INTERVAL_TICKS)
        interval = SEARCH_INTERVAL_TICKS if candidates else doubled
        return state._replace(proposals=(), search_interval=interval, is_open=False)
    if state.searches_all:
        return _accept(state, best, candidates, ticks, motion, first)
    return _queue_all_kinds(state, best, ticks)


def _queue_all_kinds(state: FormationState, best: Candidate, ticks: FormationTicks) -> FormationState:
    """Queue all kinds for the run of the best candidate, as others may explain it as well."""
    run, proposals = best.presence.runs[-1], (best.elements,)
    return state._replace(queue=ticks.kinds, span=run.end - run.first, proposals=proposals, searches_all=True)


def _present(
    contacts: Sequence[KnownContact], ticks: FormationTicks, motion: ConditionalMotion
) -> Iterator[Candidate]:
    """The evaluated ``contacts`` that hold in the newest tick."""
    for contact in contacts:
        candidate = evaluate(ticks, motion, contact)
        if candidate is not None and _is_now(candidate.presence, motion):
            yield candidate


def _is_now(presence: Presence, motion: ConditionalMotion) -> bool:
    return presence.runs[-1].end == len(motion)


def _accept(
    state: FormationState,
    best: Candidate,
    candidates: list[Candidate],
    ticks: FormationTicks,
    motion: ConditionalMotion,
    first: KnownContact,
) -> FormationState:
    """Track the best candidate, if the motion uses all freedom that the contacts leave."""
    state = state._replace(queue=(), proposals=(), searches_all=False, search_interval=SEARCH_INTERVAL_TICKS)
    refined = refine(ticks, motion, best, best.presence.runs[-1])
    if refined is None or not _is_now(refined.presence, motion):
        return state._replace(search_interval=MAX_SEARCH_INTERVAL_TICKS, is_open=True)
    best = refined
    present, last = [contact for contact in state.tracked if contact.is_present], best.presence.runs[-1]
    holding = [first, *(contact.elements for contact in present)]
    confirmed = confirm(ticks, motion, best, holding, last)
    if confirmed is None:
        return state._replace(search_interval=MAX_SEARCH_INTERVAL_TICKS, is_open=True)
    geometry, constraints, new = confirmed
    tracked = TrackedContact(
        best.elements,
        geometry,
        inseparable_kinds(ticks, motion, best, candidates, last, new),
        best.presence.log_odds,
        int(ticks.window.index[last.first]),
        True,
        _refit_at(int(ticks.window.index[-1]), last),
    )
    return state._replace(tracked=(*present, tracked), is_open=False, constraints=constraints)
