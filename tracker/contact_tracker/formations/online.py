"""Further contacts while poses come in: bounded work in each tick (docs/theory.md, section 18).

From time to time the latest ticks are tested for constraints beyond those of the known contacts. If there may
be some, kinds of contacts are searched for, a few in each tick. Contacts that were found are weighed in every
tick.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.formations.conditional import ConditionalMotion, count_constraints
from contact_tracker.formations.further import (
    MOST,
    SURE_NATS,
    Candidate,
    FormationTicks,
    KnownContact,
    best_of,
    found_in,
    inseparable_kinds,
    possible,
    promising_kinds,
    refined,
    weigh,
)
from contact_tracker.formations.presence import Presence, Run
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.motion.used_directions import DIRECTIONS, used_directions
from contact_tracker.states import Contact

Array = NDArray[np.float64]

LONGEST_TICKS: Final = 150
"""So many of the last ticks are weighed."""
SPANS: Final = (30, 50, 100)
"""In the last so many ticks constraints are looked for."""
LOOK_TICKS: Final = 5.0
LONGEST_WAIT_TICKS: Final = 20.0
"""After so many ticks with motion they are looked for again; after each vain search the next one waits
longer, up to so many ticks."""
REFIT_SHARE: Final = 0.5
"""Elements are fitted again after so much of the time for which they had touched at the last fit."""
REMEMBERED: Final = 3
AT_ONCE: Final = 2
"""Kinds that are searched for in one tick."""
COUNTED_TICKS: Final = 20
"""Constraints are counted in so many of the last ticks."""


class Elements(NamedTuple):
    """Of a contact: its kind and x (S,)."""

    contact: Contact
    x: Array

    @property
    def known(self) -> KnownContact:
        return KnownContact(CONTACT_MODELS[self.contact.column], self.x)


class Held(NamedTuple):
    """A further contact that was found: it ``holds`` since the tick ``since``, or does so no more."""

    elements: Elements
    geometry: ContactGeometry
    inseparable: tuple[Contact, ...]
    log_odds: float
    since: int
    holds: bool
    refit_at: int
    """The tick from which on its elements are to be fitted again."""


class Beside(NamedTuple):
    """What is known of contacts beside the ``first``; bounded in size.

    ``remembered`` elements may touch again when the first contact has changed. ``queue`` are the kinds that
    are still to be searched for in the last ``span`` ticks, ``found`` what this has led to so far; ``kinds``
    says that all are searched for, else single constraints. ``waited`` are the ticks with motion since the
    last look, ``wait`` is how many there must be. ``is_open``: more constraints are kept than those of the
    contacts that are reported, by motion that does not show which. ``constraints`` are those of the first and
    of all that hold. ``rejudged`` is the number of the held one that is to be compared with other kinds, by
    more ticks than at first; -1 where a new one is searched for.
    """

    first: Elements | None = None
    held: tuple[Held, ...] = ()
    remembered: tuple[Elements, ...] = ()
    queue: tuple[Contact, ...] = ()
    span: int = 0
    found: tuple[Elements, ...] = ()
    kinds: bool = False
    waited: float = 0.0
    wait: float = LOOK_TICKS
    is_open: bool = False
    constraints: int = 0
    rejudged: int = -1


NOTHING_BESIDE: Final = Beside()


def advance(beside: Beside, ticks: FormationTicks, first: KnownContact) -> Beside:
    """One tick on: the newest of ``ticks``, all of which are of the ``first`` contact."""
    window = ticks.window
    motion = ConditionalMotion.of(window, ticks.scales)
    beside = _beside(beside, first, motion)
    beside = beside._replace(waited=beside.waited + float(window.motion_ratio[-1]))
    looks = bool(beside.queue) or beside.waited >= beside.wait
    if not beside.held and not looks:
        return beside
    motion = motion.keeping(first.c)
    before, held = beside.held, []
    for one in before:
        now, runs = _weighed(one, ticks, motion)
        held.append(now)
        for run in runs:
            motion = motion.keeping(one.elements.known.c, *run)
    beside = beside._replace(held=tuple(held), constraints=_count(held, motion, first))
    if beside.rejudged >= 0:
        return _rejudged(beside, ticks, first)
    refitted = [
        i for i, (one, now) in enumerate(zip(before, held, strict=True)) if now.refit_at > one.refit_at
    ]
    if refitted and not beside.queue:
        elements = held[refitted[-1]].elements
        return beside._replace(queue=ticks.kinds, found=(elements,), kinds=True, rejudged=refitted[-1])
    if sum(one.holds for one in held) >= MOST:
        return beside._replace(queue=(), found=())
    if beside.queue:
        return _searched(beside, ticks, motion, first)
    return _looked(beside, ticks, motion) if looks else beside


def _count(held: Sequence[Held], motion: ConditionalMotion, first: KnownContact) -> int:
    """Constraints that the first contact puts on the last ticks, with those beside it that hold now."""
    holding = [one.elements.known.c for one in held if one.holds]
    if not holding:
        return first.model.contact.codimension
    last = motion.cut(max(len(motion) - COUNTED_TICKS, 0), len(motion))
    return count_constraints(last, [first.c, *holding])


def interrupted(beside: Beside) -> Beside:
    """No contact is sure: nothing is reported beside it, and no search goes on."""
    held = tuple(one._replace(holds=False) for one in beside.held)
    return beside._replace(held=held, queue=(), found=(), is_open=False, rejudged=-1)


def _beside(beside: Beside, first: KnownContact, motion: ConditionalMotion) -> Beside:
    """The same if the first contact is that of before; else all that was known is remembered."""
    elements, before = Elements(first.model.contact, first.x), beside.first
    if before is None:
        return beside._replace(first=elements)
    if before.contact is elements.contact and _is_same(motion, before.known, first):
        return beside._replace(first=elements)
    known = [before, *(one.elements for one in beside.held), *beside.remembered]
    return Beside(elements, remembered=tuple(known[:REMEMBERED]), wait=0.0)


def _is_same(motion: ConditionalMotion, one: KnownContact, other: KnownContact) -> bool:
    """Whether two contacts of one kind constrain the newest tick alike."""
    newest = motion.cut(len(motion) - 1, len(motion))
    return count_constraints(newest, [one.c, other.c]) == one.model.contact.codimension


def _weighed(one: Held, ticks: FormationTicks, motion: ConditionalMotion) -> tuple[Held, tuple[Run, ...]]:
    """The same by the newest tick, and when it held."""
    candidate = weigh(ticks, motion, one.elements.known)
    if candidate is None or candidate.presence.log_odds <= 0.0:
        return one._replace(holds=False), ()
    last = candidate.presence.runs[-1]
    if last.end < len(motion):
        return one._replace(holds=False, log_odds=candidate.presence.log_odds), candidate.presence.runs
    begins = int(ticks.window.index[last.first])
    since = min(one.since, begins) if one.holds else begins
    log_odds = max(candidate.presence.log_odds, one.log_odds) if one.holds else candidate.presence.log_odds
    now = one._replace(holds=one.holds or log_odds > SURE_NATS, log_odds=log_odds, since=since)
    newest = int(ticks.window.index[-1])
    if now.holds and newest >= one.refit_at:
        better, fitted = refined(ticks, motion, candidate, last)
        elements, geometry = Elements(one.elements.contact, better.known.x), ticks.geometry_of(fitted)
        if geometry is None:
            return now._replace(holds=False), candidate.presence.runs
        now = now._replace(elements=elements, geometry=geometry, refit_at=_refit_at(newest, last))
    return now, candidate.presence.runs


def _refit_at(newest: int, run: Run) -> int:
    return newest + max(round(REFIT_SHARE * (run.end - run.first)), 1)


def _looked(beside: Beside, ticks: FormationTicks, motion: ConditionalMotion) -> Beside:
    """What is remembered may touch; if it does not, kinds of constraints that the last ticks may keep."""
    beside = beside._replace(waited=0.0, wait=max(beside.wait, LOOK_TICKS))
    candidates = [weigh(ticks, motion, one.known) for one in beside.remembered]
    best = best_of(one for one in candidates if one is not None and _is_now(one.presence, motion))
    if best is not None:
        return _with_all_kinds(beside, best, ticks)
    looks = [_Look.at(motion, min(span, len(motion))) for span in SPANS if span < 2 * len(motion)]
    best_look = max(looks, key=lambda look: look.promise)
    if not best_look.kinds:
        return beside._replace(is_open=False)
    return beside._replace(queue=best_look.kinds, span=best_look.span, found=(), kinds=False)


class _Look(NamedTuple):
    """In the last ``span`` ticks constraints of some ``kinds`` may be kept; how much they would explain."""

    promise: float
    span: int
    kinds: tuple[Contact, ...]

    @classmethod
    def at(cls, motion: ConditionalMotion, span: int) -> "_Look":
        promise, models = promising_kinds(motion.cut(len(motion) - span, len(motion)))
        return cls(promise, span, tuple(model.contact for model in models))


def _searched(
    beside: Beside, ticks: FormationTicks, motion: ConditionalMotion, first: KnownContact
) -> Beside:
    """A few kinds more; after the last, what follows from all that was found."""
    run = Run(max(len(motion) - beside.span, 0), len(motion))
    beside = _with_next_kinds(beside, ticks, motion, run)
    if beside.queue:
        return beside
    candidates = [*_candidates(beside, ticks, motion)]
    if beside.kinds:
        candidates = possible(ticks, candidates)
    best = best_of(candidates)
    if best is None and candidates:
        best = best_of([_fitted(ticks, motion, max(candidates, key=lambda one: one.presence.log_odds))])
    if best is None:
        # a contact that holds now may be reported once it has lasted longer
        wait = LOOK_TICKS if candidates else min(2.0 * beside.wait, LONGEST_WAIT_TICKS)
        return beside._replace(found=(), wait=wait, is_open=False)
    if beside.kinds:
        return _accepted(beside, best, candidates, ticks, motion, first)
    return _with_all_kinds(beside, best, ticks)


def _fitted(ticks: FormationTicks, motion: ConditionalMotion, one: Candidate) -> Candidate:
    """The candidate with its elements, found on a part of its run, refitted to all of it."""
    return refined(ticks, motion, one, one.presence.runs[-1])[0]


def _with_next_kinds(beside: Beside, ticks: FormationTicks, motion: ConditionalMotion, run: Run) -> Beside:
    """After a search for the next kinds in a run."""
    some, queue = beside.queue[:AT_ONCE], beside.queue[AT_ONCE:]
    new = (
        Elements(kind, one.known.x)
        for kind in some
        for one in found_in(ticks, motion, CONTACT_MODELS[kind.column], run)
    )
    return beside._replace(queue=queue, found=(*beside.found, *new))


def _rejudged(beside: Beside, ticks: FormationTicks, first: KnownContact) -> Beside:
    """A few kinds more; after the last, what else a contact that holds may be by all ticks of its run."""
    one, others = beside.held[beside.rejudged], list(beside.held)
    del others[beside.rejudged]
    motion = ConditionalMotion.of(ticks.window, ticks.scales).keeping(first.c)
    for other in others:
        known = weigh(ticks, motion, other.elements.known) if other.holds else None
        for run in known.presence.runs if known is not None else ():
            motion = motion.keeping(other.elements.known.c, *run)
    own = weigh(ticks, motion, one.elements.known)
    if own is None or not one.holds or not _is_now(own.presence, motion):
        return beside._replace(queue=(), found=(), kinds=False, rejudged=-1)
    run = own.presence.runs[-1]
    beside = _with_next_kinds(beside, ticks, motion, run)
    if beside.queue:
        return beside
    candidates = [own, *possible(ticks, _candidates(beside, ticks, motion))]
    best = max(candidates, key=lambda candidate: candidate.presence.log_odds)
    if best.presence.log_odds < own.presence.log_odds + DECISIVE:
        best = own
    else:
        best, fitted = refined(ticks, motion, best, best.presence.runs[-1])
        elements = Elements(best.known.model.contact, best.known.x)
        geometry = ticks.geometry_of(fitted)
        if geometry is None:
            return beside._replace(queue=(), found=(), kinds=False, rejudged=-1)
        one = one._replace(elements=elements, geometry=geometry)
    holding = [first.c, *(other.elements.known.c for other in others if other.holds)]
    part = motion.cut(*run)
    new = count_constraints(part, [*holding, best.known.c]) - count_constraints(part, holding)
    held = list(beside.held)
    held[beside.rejudged] = one._replace(
        inseparable=inseparable_kinds(ticks, motion, best, candidates, run, new)
    )
    return beside._replace(held=tuple(held), found=(), kinds=False, rejudged=-1)


def _with_all_kinds(beside: Beside, best: Candidate, ticks: FormationTicks) -> Beside:
    """About to search for all kinds in the ticks in which the best one holds: others may explain as much."""
    elements, run = Elements(best.known.model.contact, best.known.x), best.presence.runs[-1]
    return beside._replace(queue=ticks.kinds, span=run.end - run.first, found=(elements,), kinds=True)


def _candidates(beside: Beside, ticks: FormationTicks, motion: ConditionalMotion) -> Iterator[Candidate]:
    for one in beside.found:
        candidate = weigh(ticks, motion, one.known)
        if candidate is not None and _is_now(candidate.presence, motion):
            yield candidate


def _is_now(presence: Presence, motion: ConditionalMotion) -> bool:
    return presence.runs[-1].end == len(motion)


def _accepted(
    beside: Beside,
    best: Candidate,
    candidates: list[Candidate],
    ticks: FormationTicks,
    motion: ConditionalMotion,
    first: KnownContact,
) -> Beside:
    """With the best candidate among those that hold, if the motion uses the freedom that all leave."""
    beside = beside._replace(queue=(), found=(), kinds=False, wait=LOOK_TICKS)
    best, elements = refined(ticks, motion, best, best.presence.runs[-1])
    if not _is_now(best.presence, motion):
        return beside._replace(wait=LONGEST_WAIT_TICKS, is_open=True)
    holding = [one for one in beside.held if one.holds]
    run = best.presence.runs[-1]
    contacts = [first.c, *(one.elements.known.c for one in holding)]
    before = count_constraints(motion.cut(*run), contacts) if holding else first.model.contact.codimension
    constraints = count_constraints(motion.cut(*run), [*contacts, best.known.c])
    uses_freedom = used_directions(ticks.window.cut(*run)) >= DIRECTIONS - constraints
    geometry = ticks.geometry_of(elements)
    if geometry is None or constraints <= before or not uses_freedom:
        return beside._replace(wait=LONGEST_WAIT_TICKS, is_open=True)
    kind, last = best.known.model.contact, best.presence.runs[-1]
    held = Held(
        Elements(kind, best.known.x),
        geometry,
        inseparable_kinds(ticks, motion, best, candidates, last, constraints - before),
        best.presence.log_odds,
        int(ticks.window.index[last.first]),
        True,
        _refit_at(int(ticks.window.index[-1]), last),
    )
    return beside._replace(held=(*holding, held), is_open=False, constraints=constraints)
