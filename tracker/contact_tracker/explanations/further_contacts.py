"""Further contacts in the ticks of a segment whose first contact is known (docs/theory.md, section 18)."""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.explanations.conditional_contact import (
    RELAXED,
    TINY,
    ConditionalMotion,
    ExplainedTicks,
    KnownContact,
    Presence,
    Run,
    count_constraints,
    moments,
    most_probable,
    relaxed,
    search,
)
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.lifted_pose import T
from contact_tracker.hypotheses import refinement
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.births import name_listed
from contact_tracker.hypotheses.evidence import DECISIVE, SAME_FIT_RATIO, complexity, weak_prior
from contact_tracker.hypotheses.observability import fitted_contact
from contact_tracker.hypotheses.refit import accumulate_window
from contact_tracker.map.map import Map
from contact_tracker.motion.window import DIRECTIONS, used_directions
from contact_tracker.states import Contact

MAX_FURTHER: Final = 2
"""Most further contacts of a segment."""
MIN_TICKS: Final = 20
SPAN_TICKS: Final = 60
STRIDE_TICKS: Final = 15
"""Constraints are searched in all ticks, and in spans of this length and stride."""
SURE_NATS: Final = 2.5
"""Log odds (nats) against no contact from which a further contact, or a joint, is reported."""
MIN_COMPLEXITY: Final = 25.0
"""Least complexity (nats) of the elements of a single constraint in short runs of ticks."""
MIN_RATIO: Final = 2.0
"""Least ratio of free motion to squared residual for a constraint to be kept; at least one row of every
contact has it."""
EQUAL_GAIN: Final = 0.9
MAX_RMS: Final = 1.5
"""Greatest RMS of whitened residuals of a contact's elements."""


class Candidate(NamedTuple):
    """A possible contact: the ticks in which it is present, its ``gain`` (nats) and ``rms``, and its
    ``geometry``, once it is fitted by maximum likelihood (T26)."""

    known: KnownContact
    presence: Presence
    gain: float
    rms: float
    geometry: ContactGeometry | None = None

    @property
    def run(self) -> Run:
        """The longest run."""
        return max(self.presence.runs, key=lambda run: run.end - run.first)

    def is_present_after(self, motion: ConditionalMotion) -> bool:
        """Whether the contact is present in the newest tick of ``motion``."""
        return self.presence.runs[-1].end >= len(motion)


class Further(NamedTuple):
    """A further contact with ``log_odds`` (nats) against none, in ``runs`` by the numbers of ticks.

    ``inseparable`` are contact kinds that the map allows and that explain the motion as well.
    """

    known: KnownContact
    geometry: ContactGeometry
    runs: tuple[Run, ...]
    log_odds: float
    inseparable: tuple[Contact, ...]


Ranks = tuple[tuple[frozenset[int], int], ...]
"""Pairs of a set of further contacts (indices) that hold at once, and the number of constraints that these
and the first contact impose together."""


class Formation(NamedTuple):
    """The further contacts of a segment.

    ``is_open`` : whether the motion keeps more constraints than the contacts found explain.
    """

    further: tuple[Further, ...] = ()
    is_open: bool = False
    ranks: Ranks = ()

    @property
    def constraints(self) -> int:
        """Largest number of constraints of the contacts together; 0 without further ones."""
        return max((rank for _, rank in self.ranks), default=0)

    def constraints_with(self, number: int) -> int:
        """Largest number of constraints while a further contact holds."""
        return max(rank for numbers, rank in self.ranks if number in numbers)


NO_FORMATION: Final = Formation()


def find_formation(ticks: ExplainedTicks, first: KnownContact) -> Formation:
    """Find all further contacts; the ``first`` one lasts through the segment."""
    if len(ticks) < MIN_TICKS:
        return NO_FORMATION
    free, spans = ConditionalMotion.of(ticks), [Run(0, len(ticks))]
    if len(ticks) > SPAN_TICKS + STRIDE_TICKS:
        starts = [*range(0, len(ticks) - SPAN_TICKS, STRIDE_TICKS), len(ticks) - SPAN_TICKS]
        spans += [Run(start, start + SPAN_TICKS) for start in starts]
    further, is_open, motion = list[Further](), False, free.keeping(first.c)
    while len(further) < MAX_FURTHER:
        search = begin_search(motion, spans)
        while search is not None and search.kinds:
            search = search.advance(motion)
        found, is_open = conclude_search(search, motion, first, further)
        if found is None:
            break
        further.append(found)
        motion = keeping(motion, found.known, found.runs)
    return Formation(tuple(further), is_open, _ranks(free, first, further))


def keeping(motion: ConditionalMotion, contact: KnownContact, runs: Iterable[Run]) -> ConditionalMotion:
    """The motion that keeps a contact as well in ``runs``, by the numbers of ticks."""
    for run in runs:
        motion = motion.keeping(contact.c, *motion.ticks.window.index.searchsorted(run).tolist())
    return motion


def _ranks(motion: ConditionalMotion, first: KnownContact, further: Sequence[Further]) -> Ranks:
    index = motion.ticks.window.index
    holds = np.zeros((len(motion), len(further)), bool)
    for number, contact in enumerate(further):
        for run in contact.runs:
            holds[(index >= run.first) & (index < run.end), number] = True
    ranks = list[tuple[frozenset[int], int]]()
    for pattern in np.unique(holds, axis=0):
        numbers = np.flatnonzero(pattern).tolist()
        if numbers:
            contacts = [first.c, *(further[number].known.c for number in numbers)]
            ranks.append((frozenset(numbers), count_constraints(motion.moved, contacts)))
    return tuple(ranks)


class ContactSearch(NamedTuple):
    """A search for one more contact, which fits one contact kind after the other.

    Attributes
    ----------
    run : ticks to which elements are fitted, by their numbers.
    kinds : contact kinds that are still to be fitted.
    fitted : elements of the kinds before.
    best : the contact whose rivals are fitted; None while single constraints are.
    """

    run: Run
    kinds: tuple[Contact, ...]
    fitted: tuple[KnownContact, ...] = ()
    best: KnownContact | None = None

    def advance(self, motion: ConditionalMotion, lasts: bool = False) -> "ContactSearch | None":
        """The search after the fit of one more kind; None without a sure contact."""
        rows = Run(*motion.ticks.window.index.searchsorted(self.run).tolist())
        if rows.first == rows.end:  # the ticks have left the window
            return None
        kind, *kinds = self.kinds
        part, fitted = motion.cut(*rows), self.fitted
        elements = KnownContact(kind, search(CONTACT_MODELS[kind.column], part))
        if np.sqrt(part.evidence(elements.c).chi_sq.mean()) < MAX_RMS:
            fitted = (*fitted, elements)
        if kinds or self.best is not None:
            return self._replace(kinds=tuple(kinds), fitted=fitted)
        return _search_rivals(motion, fitted, lasts)


def begin_search(
    motion: ConditionalMotion, spans: Iterable[Run], known: Iterable[KnownContact] = (), lasts: bool = False
) -> ContactSearch | None:
    """The search for a contact beside those that ``motion`` keeps; None if nothing promises one.

    Parameters
    ----------
    spans : in which contacts are searched, if none of those with ``known`` elements holds.
    lasts : whether the contact has to hold in the newest tick.
    """
    if (search := _search_rivals(motion, known, lasts)) is not None:
        return search
    span, models = _most_promising(motion, spans)
    kinds = tuple(model.contact for model in models)
    return ContactSearch(motion.ticks.numbered(span), kinds) if kinds else None


def _search_rivals(
    motion: ConditionalMotion, contacts: Iterable[KnownContact], lasts: bool
) -> ContactSearch | None:
    """The search for rivals of the most probable of these contacts; None if none is sure."""
    best = _best(_held(motion, contacts, lasts))
    if best is None:
        return None
    return ContactSearch(motion.ticks.numbered(best.run), motion.ticks.kinds, (), best.known)


def _held(motion: ConditionalMotion, contacts: Iterable[KnownContact], lasts: bool) -> list[Candidate]:
    """The contacts that are present in some ticks, or if one has to last, in the newest tick."""
    found = [candidate for contact in contacts if (candidate := evaluate(motion, contact)) is not None]
    return [candidate for candidate in found if not lasts or candidate.is_present_after(motion)]


def conclude_search(
    search: ContactSearch | None,
    motion: ConditionalMotion,
    first: KnownContact,
    further: Sequence[Further],
    lasts: bool = False,
) -> tuple[Further | None, bool]:
    """The most probable contact of a search beside the ``first`` and ``further`` ones, and whether there is
    one that no contact explains."""
    if search is None or search.best is None:
        return None, False
    kinds, rivals = motion.ticks.kinds, _held(motion, search.fitted, lasts)
    candidates = (*_held(motion, [search.best], lasts), *rivals)
    best = _best(found for found in candidates if found.known.contact in kinds)
    refined = None if best is None else refine(motion, best)
    if refined is None or refined.geometry is None or (lasts and not refined.is_present_after(motion)):
        return None, True
    best, part = refined, motion.cut(*refined.run)
    run, *runs = map(motion.ticks.numbered, (best.run, *best.presence.runs))
    holding = [first.c, *(contact.known.c for contact in further if any(map(run.overlaps, contact.runs)))]
    fewer, constraints = (
        count_constraints(part.moved, contacts) for contacts in (holding, [*holding, best.known.c])
    )
    uses_freedom = used_directions(part.ticks.window) >= DIRECTIONS - constraints
    if constraints <= fewer or not uses_freedom:  # what the motion keeps beyond that is not explained
        return None, True
    inseparable = _inseparable_kinds(motion, best, rivals, constraints - fewer)
    return Further(best.known, refined.geometry, tuple(runs), best.presence.log_odds, inseparable), False


def refine(motion: ConditionalMotion, best: Candidate) -> Candidate | None:
    """The candidate with its elements refitted by maximum likelihood to its longest run.

    None if the refitted elements have no evidence beside the contacts that ``motion`` keeps: the likelihood
    ignores these, so the fit may end at the elements of one of them.
    """
    model, ticks = best.known.model, motion.ticks.cut(*best.run)
    bank = blank(model, 1).replace_columns(x=best.known.x[None])
    bank = accumulate_window(bank, model, ticks.window, ticks.scales)
    fit, information = refinement.refine(bank, model, ticks.window, ticks.scales)
    refined = evaluate(motion, KnownContact(model.contact, fit.x[0]))
    if refined is None:
        return None
    parts = ticks.window, ticks.origins, ticks.systematic, information
    geometry = named_by(ticks.known_map, fitted_contact(fit, 0, model, ticks.scales, *parts).geometry)
    return refined._replace(geometry=geometry)


def _most_promising(motion: ConditionalMotion, spans: Iterable[Run]) -> tuple[Run, list[ContactModel]]:
    """The span with the largest gain of a further single constraint, with the kinds that this may keep. In
    few ticks a gain counts only if it can exceed the complexity of elements."""
    most, best = 0.0, (Run(0, len(motion)), list[ContactModel]())
    for span in spans:
        part = motion.cut(*span)
        least = max(MIN_RATIO, float(np.expm1(2.0 * MIN_COMPLEXITY / len(part))))
        ratios = {model: float(relaxed(moments(model, part))[0][-1]) for model in RELAXED}
        gain = len(part) * float(np.log1p(max(ratios.values())))
        if gain > most and max(ratios.values()) > least:
            most, best = gain, (span, [model for model, ratio in ratios.items() if ratio > least])
    return best


def elements_complexity(
    contact: KnownContact, motion: ConditionalMotion, gain: float, noise_factor: float = 1.0
) -> float:
    """Complexity (nats, T19) of elements fitted to the ticks with ``noise_factor`` times their noise;
    ``gain``: mean gain of a tick (nats).

    Excludes the information of the first tick and of the free-motion prediction
    (``evidence.complexity``).
    """
    model, x, window, scales = contact.model, contact.x[None], motion.ticks.window, motion.ticks.scales
    family, anchors = model.family, model.anchors(window.zeta[:, T].mean(axis=0))[None]
    rows = motion.gradients(contact.c) * motion.ticks.noise_sd[:, None]
    noise = noise_factor * np.linalg.norm(rows, axis=2) + TINY  # (W, K)
    along = family.tangent(x, anchors)[0].T @ family.rows_derivative(x)[0]  # (K, P, C)
    slopes = along @ model.lifted(motion.new).T / noise.T[:, None]  # (K, P, W)
    hessian = slopes @ slopes.swapaxes(1, 2)
    ticks = max(float(window.motion_ratio.sum()), 1.0)
    share = scales.prior_predictive_share * model.needed / ticks * np.exp(-2.0 * gain / family.ROWS)
    first_hessian = slopes[:, :, 0].T @ slopes[:, :, 0]
    shares, prior = np.full((1, family.ROWS), min(share, 1.0)), weak_prior(family, anchors, scales.reach_m)
    return float(complexity(family, x, x, anchors, hessian[None], first_hessian[None], shares, prior)[0])


def evaluate(motion: ConditionalMotion, contact: KnownContact) -> Candidate | None:
    """The runs in which elements touch and the log odds of contact; None without a run."""
    ticks, exponent = motion.evidence(contact.c), motion.ticks.scales.likelihood_exponent
    presence = most_probable(exponent * ticks.log_ratio, motion.ticks.log_change)
    if not presence.runs:
        return None
    rows = np.concatenate([np.arange(*run) for run in presence.runs])
    gain, rms = float(ticks.gain[rows].sum()), float(np.sqrt(ticks.chi_sq[rows].mean()))
    found = Candidate(contact, presence, gain, rms)
    cost = elements_complexity(contact, motion.cut(*found.run), float(ticks.gain[slice(*found.run)].mean()))
    return found._replace(presence=presence._replace(log_odds=presence.log_odds - exponent * min(cost, gain)))


def _best(candidates: Iterable[Candidate]) -> Candidate | None:
    """The most probable candidate with log odds above ``SURE_NATS``; None without one."""
    sure = [candidate for candidate in candidates if candidate.presence.log_odds > SURE_NATS]
    return max(sure, key=lambda candidate: candidate.presence.log_odds, default=None)


def _inseparable_kinds(
    motion: ConditionalMotion, best: Candidate, rivals: Iterable[Candidate], new: int
) -> tuple[Contact, ...]:
    """Contact kinds that explain the motion as well as ``best``, which adds ``new`` constraints to it.

    A kind contained in one of these counts if it has at least ``new`` constraints. As the best was refined
    on its run, rivals that fit less well are refined as well.
    """
    alike = {best.known.contact}
    for rival in rivals:
        if rival.rms > SAME_FIT_RATIO and rival.gain > EQUAL_GAIN * best.gain:
            rival = refine(motion, rival) or rival
        near = rival.presence.log_odds > best.presence.log_odds - DECISIVE
        fits = rival.rms < SAME_FIT_RATIO * max(1.0, best.rms) and rival.gain > EQUAL_GAIN * best.gain
        if near or fits:
            alike.add(rival.known.contact)
    kinds = (kind for kind in motion.ticks.kinds if kind.codimension >= new)
    others = (kind for kind in kinds if kind is not best.known.contact)
    return tuple(kind for kind in others if any(contact.contains(kind) for contact in alike))


def named_by(known_map: Map, geometry: ContactGeometry) -> ContactGeometry | None:
    """The geometry with the names of elements of the map that agree with it within their uncertainty; None if
    a complete map lacks them."""
    named = name_listed(geometry, known_map)
    complete = known_map.object_complete, known_map.environment_complete
    is_unlisted = any(name is None and only for name, only in zip(named.names, complete, strict=True))
    return None if is_unlisted else named
