"""Online detection of further contacts (docs/theory.md, section 18).

At intervals the latest ticks are searched for constraints beyond those of the known contacts, one kind of
contact in each tick. Contacts that were found are evaluated in every tick.
"""

from typing import Final, NamedTuple

from contact_tracker.explanations.conditional_contact import (
    ConditionalMotion,
    ExplainedTicks,
    KnownContact,
    Run,
    count_constraints,
)
from contact_tracker.explanations.further_contacts import (
    MAX_FURTHER,
    SURE_NATS,
    ContactSearch,
    Further,
    begin_search,
    conclude_search,
    evaluate,
    keeping,
    refine,
)

WINDOW_TICKS: Final = 150
"""Number of latest ticks over which further contacts are evaluated."""
SEARCH_SPANS_TICKS: Final = (30, 50, 100)
"""Numbers of latest ticks that are searched."""
SEARCH_INTERVAL_TICKS: Final = 10.0
"""Ticks with motion between two searches."""
MAX_REMEMBERED: Final = 3


class TrackedContact(NamedTuple):
    """A further contact that was ``found`` in the latest ticks, still present or not, and the tick at which
    its elements are refitted."""

    found: Further
    is_present: bool
    refit_at: int


class FormationState(NamedTuple):
    """State of the search for further contacts while the ``first`` holds; bounded in size.

    Attributes
    ----------
    tracked : further contacts found so far, present or not.
    remembered : elements of earlier contacts, which may touch again.
    unsearched_ticks : ticks with motion since the last search began.
    search : the search that is under way.
    is_open : whether the motion keeps more constraints than the reported contacts explain.
    constraints : of the first contact and of all that are present.
    """

    first: KnownContact | None = None
    tracked: tuple[TrackedContact, ...] = ()
    remembered: tuple[KnownContact, ...] = ()
    unsearched_ticks: float = 0.0
    search: ContactSearch | None = None
    is_open: bool = False
    constraints: int = 0

    @property
    def is_due(self) -> bool:
        """Whether contacts are to be evaluated or sought."""
        return bool(self.tracked or self.search) or self.unsearched_ticks >= SEARCH_INTERVAL_TICKS

    @property
    def present(self) -> tuple[Further, ...]:
        """The further contacts that hold now."""
        return tuple(contact.found for contact in self.tracked if contact.is_present)


EMPTY_FORMATION: Final = FormationState()


def suspend(state: FormationState) -> FormationState:
    """The state while there is no first contact: no further contact is present."""
    tracked = tuple(contact._replace(is_present=False) for contact in state.tracked)
    return state._replace(tracked=tracked, search=None, is_open=False)


def advance(state: FormationState, ticks: ExplainedTicks, first: KnownContact) -> FormationState:
    """The state, which is due, after the newest of ``ticks``, in all of which the ``first`` contact holds."""
    free = ConditionalMotion.of(ticks)
    state = _with_first(state, first, free)
    motion, tracked = free.keeping(first.c), list[TrackedContact]()
    for contact in state.tracked:
        tracked.append(_evaluated(contact, motion))
        motion = keeping(motion, contact.found.known, tracked[-1].found.runs)
    state = state._replace(tracked=tuple(tracked))
    if len(state.present) < MAX_FURTHER:
        state = _search(state, motion, first)
    contacts = [first.c, *(contact.known.c for contact in state.present)]
    return state._replace(constraints=count_constraints(free.moved[-1:], contacts))


def _with_first(state: FormationState, first: KnownContact, motion: ConditionalMotion) -> FormationState:
    """The state with this first contact. If it constrains the newest tick otherwise than the previous one,
    all contacts become remembered elements."""
    previous = state.first
    if previous is None or (
        previous.contact is first.contact
        and count_constraints(motion.moved[-1:], [previous.c, first.c]) == first.contact.codimension
    ):
        return state._replace(first=first)
    elements = [previous, *(contact.found.known for contact in state.tracked), *state.remembered]
    return FormationState(first, (), tuple(elements[:MAX_REMEMBERED]), SEARCH_INTERVAL_TICKS)


def _evaluated(contact: TrackedContact, motion: ConditionalMotion) -> TrackedContact:
    """The contact after the newest tick, with the runs in which it was present."""
    found, newest = contact.found, int(motion.ticks.window.index[-1])
    candidate = evaluate(motion, found.known)
    if candidate is None or candidate.presence.log_odds <= 0.0:
        return contact._replace(found=found._replace(runs=()), is_present=False)
    log_odds, runs = candidate.presence.log_odds, [*map(motion.ticks.numbered, candidate.presence.runs)]
    lasts = runs[-1].end > newest
    if lasts and contact.is_present:  # it began before the window, or was surer of itself
        runs[-1] = Run(min(found.runs[-1].first, runs[-1].first), newest + 1)
        log_odds = max(log_odds, found.log_odds)
    is_present = lasts and (contact.is_present or log_odds > SURE_NATS)
    found = found._replace(log_odds=log_odds, runs=tuple(runs))
    refit_at = contact.refit_at
    if is_present and newest >= refit_at:
        refined, refit_at = refine(motion, candidate), _refit_at(found)
        if refined is not None and refined.geometry is None:  # a complete map lacks its elements
            is_present = False
        elif refined is not None and refined.geometry is not None:
            found = found._replace(known=refined.known, geometry=refined.geometry)
    return TrackedContact(found, is_present, refit_at)


def _refit_at(found: Further) -> int:
    """The tick at which the last run is longer by half."""
    first, end = found.runs[-1]
    return end + max((end - first) // 2, 1)


def _search(state: FormationState, motion: ConditionalMotion, first: KnownContact) -> FormationState:
    """The state after one step of a search for one more contact that holds now."""
    search, unsearched_ticks = state.search, state.unsearched_ticks
    if search is not None and not search.kinds:
        return _conclude(state, search, motion, first)
    if search is not None:
        search = search.advance(motion, lasts=True)
    elif unsearched_ticks < SEARCH_INTERVAL_TICKS:
        return state
    else:
        lengths = [min(span, len(motion)) for span in SEARCH_SPANS_TICKS if span < 2 * len(motion)]
        spans = [Run(len(motion) - length, len(motion)) for length in lengths]
        search, unsearched_ticks = begin_search(motion, spans, state.remembered, lasts=True), 0.0
    is_open = state.is_open and search is not None
    return state._replace(search=search, unsearched_ticks=unsearched_ticks, is_open=is_open)


def _conclude(
    state: FormationState, search: ContactSearch, motion: ConditionalMotion, first: KnownContact
) -> FormationState:
    found, is_open = conclude_search(search, motion, first, state.present, lasts=True)
    state = state._replace(search=None, is_open=is_open)
    if found is None:
        return state
    present = (contact for contact in state.tracked if contact.is_present)
    return state._replace(tracked=(*present, TrackedContact(found, True, _refit_at(found))))
