"""Online detection of further contacts, with bounded work in each tick (docs/theory.md, section 18).

At intervals the latest ticks are tested for constraints beyond those of the known contacts. If there may be
some, contact kinds are searched, one in each tick. Contacts that were found are evaluated in every tick.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.explanations.conditional_contact import (
    ConditionalMotion,
    Presence,
    Run,
    constraints_of_two,
    count_constraints,
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
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact

WINDOW_TICKS: Final = 150
"""Further contacts are evaluated over this many of the latest ticks."""
SEARCH_SPANS_TICKS: Final = (30, 50, 100)
"""Numbers of latest ticks that are tested for further constraints."""
SEARCH_INTERVAL_TICKS: Final = 5.0
MAX_SEARCH_INTERVAL_TICKS: Final = 20.0
"""Ticks with motion between two tests; the interval doubles after each unsuccessful one up to the second."""
REFIT_SHARE: Final = 0.5
"""Elements are refitted when their run has grown by this share since the last fit."""
MAX_REMEMBERED: Final = 3
COUNTED_TICKS: Final = 20
"""Constraints are counted over this many of the latest ticks."""


class TrackedContact(NamedTuple):
    """A further contact that was found: present since tick ``since``, or no longer present."""

    elements: KnownContact
    geometry: ContactGeometry
    inseparable: tuple[Contact, ...]
    log_odds: float
    since: int
    is_present: bool
    refit_at: int
    """Tick at which its elements are refitted next."""


class FormationState(NamedTuple):
    """State of the search for contacts beside the ``first``; bounded in size.

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
    reclassified : index of the tracked contact whose kind is compared with others; -1 for none.
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
    reclassified: int = -1


EMPTY_FORMATION: Final = FormationState()


def with_first(
    state: FormationState, first: KnownContact, window: Window, moved_ticks: float
) -> FormationState:
    """The state with this first contact in the newest tick of the window, ``moved_ticks`` of motion later.

    If it constrains that tick otherwise than the one before, known contacts become remembered elements.
    """
    before, model = state.first, CONTACT_MODELS[first.contact.column]
    since = state.ticks_since_search + moved_ticks
    if before is None or (
        before.contact is first.contact
        and constraints_of_two(model, np.array([before.x, first.x]), window) == first.contact.codimension
    ):
        return state._replace(first=first, ticks_since_search=since)
    known = [before, *(one.elements for one in state.tracked), *state.remembered]
    return FormationState(
        first, remembered=tuple(known[:MAX_REMEMBERED]), search_interval=0.0, ticks_since_search=moved_ticks
    )


def advance(state: FormationState, ticks: FormationTicks, first: KnownContact) -> FormationState:
    """The state ``with_first`` after the newest of ``ticks``, in all of which that contact holds; the same if
    no further one is tracked or searched for."""
    searches = bool(state.queue) or state.ticks_since_search >= state.search_interval
    motion = ConditionalMotion.of(ticks.window, ticks.scales).keeping(first.c)
    before, tracked = state.tracked, []
    for one in before:
        now, runs = _evaluated(one, ticks, motion)
        tracked.append(now)
        for run in runs:
            motion = motion.keeping(one.elements.c, *run)
    state = state._replace(tracked=tuple(tracked), constraints=_count(tracked, motion, first))
    if state.reclassified >= 0:
        return _reclassify(state, ticks, first)
    pairs = enumerate(zip(before, tracked, strict=True))
    refitted = [number for number, (one, now) in pairs if now.refit_at > one.refit_at]
    if refitted and not state.queue:
        proposals, number = (tracked[refitted[-1]].elements,), refitted[-1]
        return state._replace(queue=ticks.kinds, proposals=proposals, searches_all=True, reclassified=number)
    if sum(one.is_present for one in tracked) >= MAX_FURTHER:
        return state._replace(queue=(), proposals=())
    if state.queue:
        return _continue_search(state, ticks, motion, first)
    return _begin_search(state, ticks, motion) if searches else state


def _count(tracked: Sequence[TrackedContact], motion: ConditionalMotion, first: KnownContact) -> int:
    """Constraints of the first contact and the further ones present now on the latest ticks."""
    present = [one.elements.c for one in tracked if one.is_present]
    if not present:
        return first.contact.codimension
    return count_constraints(motion.moved[-COUNTED_TICKS:], [first.c, *present])


def suspend(state: FormationState) -> FormationState:
    """The state while no first contact is established: none is present, and the search is dropped."""
    tracked = tuple(one._replace(is_present=False) for one in state.tracked)
    return state._replace(tracked=tracked, queue=(), proposals=(), is_open=False, reclassified=-1)


def _evaluated(
    one: TrackedContact, ticks: FormationTicks, motion: ConditionalMotion
) -> tuple[TrackedContact, tuple[Run, ...]]:
    """A tracked contact after the newest tick, and the runs in which it was present."""
    candidate = evaluate(ticks, motion, one.elements)
    if candidate is None or candidate.presence.log_odds <= 0.0:
        return one._replace(is_present=False), ()
    runs, log_odds = candidate.presence
    last = runs[-1]
    if last.end < len(motion):
        return one._replace(is_present=False, log_odds=log_odds), runs
    begins = int(ticks.window.index[last.first])
    since = min(one.since, begins) if one.is_present else begins
    if one.is_present:
        log_odds = max(log_odds, one.log_odds)
    now = one._replace(is_present=one.is_present or log_odds > SURE_NATS, log_odds=log_odds, since=since)
    newest = int(ticks.window.index[-1])
    if now.is_present and newest >= one.refit_at:
        refined = refine(ticks, motion, candidate, last)
        if refined is None:  # it keeps the elements that it has
            return now._replace(refit_at=_refit_at(newest, last)), runs
        geometry = ticks.geometry_of(refined)
        if geometry is None:
            return now._replace(is_present=False), runs
        now = now._replace(elements=refined.known, geometry=geometry, refit_at=_refit_at(newest, last))
    return now, runs


def _refit_at(newest: int, run: Run) -> int:
    return newest + max(round(REFIT_SHARE * (run.end - run.first)), 1)


def _begin_search(state: FormationState, ticks: FormationTicks, motion: ConditionalMotion) -> FormationState:
    """Test the remembered elements; if none touches, queue the constraints that the latest ticks may keep."""
    interval = max(state.search_interval, SEARCH_INTERVAL_TICKS)
    state = state._replace(ticks_since_search=0.0, search_interval=interval)
    candidates = [evaluate(ticks, motion, one) for one in state.remembered]
    best = best_of(one for one in candidates if one is not None and _is_now(one.presence, motion))
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
    state = _search_next_kind(state, ticks, motion, run)
    if state.queue:
        return state
    candidates = [*_candidates(state, ticks, motion)]
    if state.searches_all:
        candidates = allowed(ticks, candidates)
    best = best_of(candidates)
    if best is None and candidates:
        one = max(candidates, key=lambda one: one.presence.log_odds)  # found on a part of its run
        best = best_of([refine(ticks, motion, one, one.presence.runs[-1]) or one])
    if best is None:
        # a contact that is present now may be reported once it has lasted longer
        doubled = min(2.0 * state.search_interval, MAX_SEARCH_INTERVAL_TICKS)
        interval = SEARCH_INTERVAL_TICKS if candidates else doubled
        return state._replace(proposals=(), search_interval=interval, is_open=False)
    if state.searches_all:
        return _accept(state, best, candidates, ticks, motion, first)
    return _queue_all_kinds(state, best, ticks)


def _search_next_kind(
    state: FormationState, ticks: FormationTicks, motion: ConditionalMotion, run: Run
) -> FormationState:
    """The state after a search for the next queued kind in ``run``."""
    found = search_span(ticks, motion, CONTACT_MODELS[state.queue[0].column], run)
    new = () if found is None else (found.known,)
    return state._replace(queue=state.queue[1:], proposals=(*state.proposals, *new))


def _reclassify(state: FormationState, ticks: FormationTicks, first: KnownContact) -> FormationState:
    """Search the next kind; after the last, compare them with the tracked contact over its whole run."""
    one, others = state.tracked[state.reclassified], list(state.tracked)
    del others[state.reclassified]
    motion = ConditionalMotion.of(ticks.window, ticks.scales).keeping(first.c)
    for other in others:
        known = evaluate(ticks, motion, other.elements) if other.is_present else None
        for run in known.presence.runs if known is not None else ():
            motion = motion.keeping(other.elements.c, *run)
    own = evaluate(ticks, motion, one.elements)
    ended = state._replace(queue=(), proposals=(), searches_all=False, reclassified=-1)
    if own is None or not one.is_present or not _is_now(own.presence, motion):
        return ended
    run = own.presence.runs[-1]
    state = _search_next_kind(state, ticks, motion, run)
    if state.queue:
        return state
    candidates = [own, *allowed(ticks, _candidates(state, ticks, motion))]
    best = max(candidates, key=lambda candidate: candidate.presence.log_odds)
    if best.presence.log_odds < own.presence.log_odds + DECISIVE:
        best = own
    else:
        refined = refine(ticks, motion, best, best.presence.runs[-1])
        geometry = None if refined is None else ticks.geometry_of(refined)
        if refined is None or geometry is None:
            return ended
        best = refined
        one = one._replace(elements=best.known, geometry=geometry)
    present = [first.c, *(other.elements.c for other in others if other.is_present)]
    part = motion.moved[slice(*run)]
    new = count_constraints(part, [*present, best.known.c]) - count_constraints(part, present)
    tracked, alike = list(state.tracked), inseparable_kinds(ticks, motion, best, candidates, run, new)
    tracked[state.reclassified] = one._replace(inseparable=alike)
    return ended._replace(tracked=tuple(tracked))


def _queue_all_kinds(state: FormationState, best: Candidate, ticks: FormationTicks) -> FormationState:
    """Queue all kinds for the run of the best candidate: others may explain it as well."""
    run, proposals = best.presence.runs[-1], (best.known,)
    return state._replace(queue=ticks.kinds, span=run.end - run.first, proposals=proposals, searches_all=True)


def _candidates(
    state: FormationState, ticks: FormationTicks, motion: ConditionalMotion
) -> Iterator[Candidate]:
    for one in state.proposals:
        candidate = evaluate(ticks, motion, one)
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
    present, last = [one for one in state.tracked if one.is_present], best.presence.runs[-1]
    holding = [first, *(one.elements for one in present)]
    confirmed = confirm(ticks, motion, best, holding, last)
    if confirmed is None:
        return state._replace(search_interval=MAX_SEARCH_INTERVAL_TICKS, is_open=True)
    geometry, constraints, new = confirmed
    tracked = TrackedContact(
        best.known,
        geometry,
        inseparable_kinds(ticks, motion, best, candidates, last, new),
        best.presence.log_odds,
        int(ticks.window.index[last.first]),
        True,
        _refit_at(int(ticks.window.index[-1]), last),
    )
    return state._replace(tracked=(*present, tracked), is_open=False, constraints=constraints)
