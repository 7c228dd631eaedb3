"""Further contacts in the ticks of a segment whose first contact is known (docs/theory.md, section 18)."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.formations.conditional import ConditionalMotion, coefficients, count_constraints
from contact_tracker.formations.elements import FittedElements, fit_elements
from contact_tracker.formations.naming import named_by
from contact_tracker.formations.presence import Presence, Run, most_probable
from contact_tracker.formations.price import price
from contact_tracker.formations.search import LEAST_RATIO, RELAXED, moments, relaxed_ratio, search
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.hypotheses.evidence import AS_WELL, DECISIVE, EvidenceParameters
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.used_directions import DIRECTIONS, used_directions
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, Contact

Array = NDArray[np.float64]

MOST: Final = 2
"""Further contacts of a segment."""
LEAST_TICKS: Final = 20
SPAN_TICKS: Final = 60
HOP_TICKS: Final = 15
"""Constraints are looked for in all ticks, and in spans of so many, this far apart."""
TRIED_SPANS: Final = 2
SURE_NATS: Final = 2.5
"""Log odds (nats) against none from which a further contact, or a joint, is reported."""
LEAST_GAIN: Final = 25.0
"""Complexity (nats) of the elements of a single constraint at least, in short runs of ticks."""
SAME_GAIN: Final = 0.9
FITS: Final = 1.5
"""A whitened residual beyond which elements are those of no contact."""


class KnownContact(NamedTuple):
    """A contact and its elements x (S,)."""

    model: ContactModel
    x: Array

    @property
    def c(self) -> Array:
        """Coefficients (K, 25) of its constraints."""
        return coefficients(self.model, self.x)


class Further(NamedTuple):
    """A further contact, in ``runs`` of ticks, ``log_odds`` nats more probable than none.

    ``inseparable`` kinds explain as much.
    """

    elements: FittedElements
    geometry: ContactGeometry
    runs: tuple[Run, ...]
    log_odds: float
    inseparable: tuple[Contact, ...]

    @property
    def contact(self) -> Contact:
        return self.elements.model.contact

    @property
    def known(self) -> KnownContact:
        """With its elements."""
        return KnownContact(self.elements.model, self.elements.x)


Ranks = tuple[tuple[frozenset[int], int], ...]
"""Of each set of further contacts that hold at once, by number: the constraints of these and the first
together."""


class Formation(NamedTuple):
    """What touches beside the first contact of a segment.

    ``is_open``: more constraints are kept than those of the contacts that are named, by motion that does not
    show which.
    """

    further: tuple[Further, ...]
    is_open: bool
    ranks: Ranks = ()


NOTHING: Final = Formation((), False)


class Candidate(NamedTuple):
    """Elements, when they touch, and what speaks for them."""

    known: KnownContact
    presence: Presence
    gain: float
    rms: float


class FormationTicks(NamedTuple):
    """The ticks of a segment, and what is needed to weigh them."""

    window: Window
    scales: EvidenceParameters
    leave_per_s: float
    origin_m: Array
    knowledge: PriorMap = EMPTY_MAP

    @property
    def kinds(self) -> tuple[Contact, ...]:
        """Kinds that the prior map allows."""
        return tuple(filter(self.knowledge.allows, CONTACTS))

    def geometry_of(self, elements: FittedElements) -> ContactGeometry | None:
        """Elements with covariance in the user's frames, by the names of those known; None where there are no
        such elements."""
        named = named_by(self.knowledge, elements.geometry(self.scales, self.origin_m))
        complete = self.knowledge.object_complete, self.knowledge.environment_complete
        unlisted = any(name is None and only for name, only in zip(named.names, complete, strict=True))
        return None if unlisted else named

    @property
    def log_change(self) -> Array:
        """(W,) of a contact that joins or leaves right before each tick: it does so by moving."""
        moved = self.window.motion_ratio * (self.leave_per_s * self.scales.tick_s)
        return np.asarray(np.log(-np.expm1(-np.maximum(moved, 1e-4))))


def find_formation(segment: FormationTicks, first: KnownContact) -> Formation:
    """All contacts beside the ``first``, which lasts through the segment."""
    if len(segment.window) < LEAST_TICKS:
        return NOTHING
    free = ConditionalMotion.of(segment.window, segment.scales)
    found, is_open = _further_contacts(segment, first, free)
    return Formation(tuple(found), is_open, _ranks(free, first, found))


def _ranks(motion: ConditionalMotion, first: KnownContact, found: Sequence[Further]) -> Ranks:
    holds = np.zeros((len(motion), len(found)), bool)
    for number, one in enumerate(found):
        for run in one.runs:
            holds[slice(*run), number] = True
    ranks = list[tuple[frozenset[int], int]]()
    for pattern in np.unique(holds, axis=0):
        numbers = np.flatnonzero(pattern).tolist()
        if numbers:
            contacts = [first.c, *(found[number].known.c for number in numbers)]
            ranks.append((frozenset(numbers), count_constraints(motion, contacts)))
    return tuple(ranks)


def _further_contacts(
    segment: FormationTicks, first: KnownContact, free: ConditionalMotion
) -> tuple[list[Further], bool]:
    """Those of a formation, and whether it is open."""
    window, found, motion = segment.window, list[Further](), free.keeping(first.c)
    while len(found) < MOST:
        best = best_of(_candidates(segment, motion))
        if best is None:
            return found, False
        some = _search_kinds(segment, motion, longest(best.presence))
        best = best_of(possible(segment, [best, *some]))
        if best is None:
            return found, True
        best, elements = refined(segment, motion, best, longest(best.presence))
        run = longest(best.presence)
        holding = [first, *(one.known for one in found if any(map(run.overlaps, one.runs)))]
        before = first.model.contact.codimension
        if len(holding) > 1:
            before = count_constraints(motion.cut(*run), [one.c for one in holding])
        more = count_constraints(motion.cut(*run), [one.c for one in (*holding, best.known)])
        geometry = segment.geometry_of(elements)
        uses_freedom = used_directions(window.cut(*run)) >= DIRECTIONS - more
        if geometry is None or more <= before or not uses_freedom:
            # what is moved in fewer directions than it could be is held back by something else
            return found, True
        others = inseparable_kinds(segment, motion, best, some, run, more - before)
        found.append(Further(elements, geometry, best.presence.runs, best.presence.log_odds, others))
        for one in best.presence.runs:
            motion = motion.keeping(best.known.c, *one)
    return found, False


def possible(segment: FormationTicks, candidates: Iterable[Candidate]) -> list[Candidate]:
    """The candidates of kinds that the prior map allows."""
    return [one for one in candidates if one.known.model.contact in segment.kinds]


def refined(
    segment: FormationTicks, motion: ConditionalMotion, best: Candidate, run: Run
) -> tuple[Candidate, FittedElements]:
    """The candidate with its elements at their greatest likelihood in a run, and the ticks by these."""
    model = best.known.model
    elements = fit_elements(model, best.known.x, segment.window.cut(*run), segment.scales)
    refined = weigh(segment, motion, KnownContact(model, elements.x))
    return (best if refined is None else refined), elements


def _candidates(segment: FormationTicks, motion: ConditionalMotion) -> Iterator[Candidate]:
    """Single constraints that spans of the ticks may keep: every contact keeps one of them."""
    for span, models in _promising(motion):
        for model in models:
            yield from found_in(segment, motion, model, span)


def _promising(motion: ConditionalMotion) -> list[tuple[Run, list[ContactModel]]]:
    """Spans that may keep a further constraint, the most promising first, and of which kinds."""
    ticks = len(motion)
    spans = [Run(0, ticks)]
    if ticks > SPAN_TICKS + HOP_TICKS:
        starts = [*range(0, ticks - SPAN_TICKS, HOP_TICKS), ticks - SPAN_TICKS]
        spans += [Run(start, start + SPAN_TICKS) for start in starts]
    rated = []
    for span in spans:
        part = motion.cut(*span)
        ratios = _ratios(part)
        if ratios:
            rated.append((len(part) * float(np.log1p(max(ratios.values()))), span, [*ratios]))
    rated.sort(key=lambda one: -one[0])
    return [(span, models) for _, span, models in rated[:TRIED_SPANS]]


def promising_kinds(motion: ConditionalMotion) -> tuple[float, list[ContactModel]]:
    """Kinds of single constraints that the ticks may keep in addition (usually none), with the largest gain
    (nats) of any of them.

    In few ticks a constraint counts only if its gain can exceed the complexity of its elements.
    """
    least = float(np.expm1(2.0 * LEAST_GAIN / len(motion)))
    ratios = {model: ratio for model, ratio in _ratios(motion).items() if ratio > least}
    return 0.5 * len(motion) * float(np.log1p(max(ratios.values(), default=0.0))), [*ratios]


def _ratios(motion: ConditionalMotion) -> dict[ContactModel, float]:
    ratios = {model: relaxed_ratio(moments(model, motion)) for model in RELAXED}
    return {model: ratio for model, ratio in ratios.items() if ratio > LEAST_RATIO}


def _search_kinds(segment: FormationTicks, motion: ConditionalMotion, run: Run) -> list[Candidate]:
    """The best elements of each kind in a run."""
    models = [CONTACT_MODELS[kind.column] for kind in segment.kinds]
    return [one for model in models for one in found_in(segment, motion, model, run)]


def found_in(
    segment: FormationTicks, motion: ConditionalMotion, model: ContactModel, span: Run
) -> Iterator[Candidate]:
    """What a search in one span leads to, as it explains all ticks."""
    part, window = motion.cut(*span), segment.window.cut(*span)
    for x in search(model, part, window, segment.scales.reach_m).x[:1]:
        known = KnownContact(model, x)
        if np.sqrt(part.evidence(known.c).chi_sq.mean()) < FITS:
            candidate = weigh(segment, motion, known)
            if candidate is not None:
                yield candidate


def weigh(segment: FormationTicks, motion: ConditionalMotion, known: KnownContact) -> Candidate | None:
    """When elements touch, and what speaks for that; None if nothing does."""
    scales = segment.scales
    ticks = motion.evidence(known.c)
    ratio = scales.likelihood_exponent * ticks.log_ratio
    presence = most_probable(ratio, segment.log_change)
    if not presence.runs:
        return None
    run = longest(presence)
    rows = np.concatenate([np.arange(*one) for one in presence.runs])
    gain = float(ticks.gain[rows].sum())
    cost = price(known.model, known.x, motion.cut(*run), segment.window.cut(*run), scales)
    log_odds = presence.log_odds - scales.likelihood_exponent * min(cost, gain)
    rms = float(np.sqrt(ticks.chi_sq[rows].mean()))
    return Candidate(known, Presence(presence.runs, log_odds), gain, rms)


def best_of(candidates: Iterable[Candidate]) -> Candidate | None:
    """The most probable one that is probable at all."""
    sure = [one for one in candidates if one.presence.log_odds > SURE_NATS]
    return max(sure, key=lambda one: one.presence.log_odds) if sure else None


def longest(presence: Presence) -> Run:
    return max(presence.runs, key=lambda run: run.end - run.first)


def inseparable_kinds(
    segment: FormationTicks,
    motion: ConditionalMotion,
    best: Candidate,
    others: Sequence[Candidate],
    run: Run,
    new: int,
) -> tuple[Contact, ...]:
    """Kinds that explain as much as the ``best``, which puts ``new`` constraints on the motion.

    A kind that is contained in one of these explains as much if it has as many constraints. The elements of
    the best were refined on the ticks of ``run``; those of others that fit less well are refined there, too.
    """
    alike = {best.known.model.contact}
    for one in others:
        if one.rms > AS_WELL and one.gain > SAME_GAIN * best.gain:
            one, _ = refined(segment, motion, one, run)
        near = one.presence.log_odds > best.presence.log_odds - DECISIVE
        fits = one.rms < AS_WELL * max(1.0, best.rms) and one.gain > SAME_GAIN * best.gain
        if near or fits:
            alike.add(one.known.model.contact)
    contained = {kind for kind in CONTACTS for one in alike if one.contains(kind) and kind.codimension >= new}
    return tuple(kind for kind in CONTACTS if kind in contained and kind is not best.known.model.contact)
