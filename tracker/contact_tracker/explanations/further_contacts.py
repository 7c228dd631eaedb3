"""Further contacts in the ticks of a segment whose first contact is known (docs/theory.md, section 18)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.explanations.conditional_contact import (
    MIN_RATIO,
    RELAXED,
    TINY,
    ConditionalMotion,
    Presence,
    Run,
    coefficients,
    count_constraints,
    moments,
    most_probable,
    relaxed_ratio,
    search,
)
from contact_tracker.geometry.elements import ContactGeometry, Element, Origins, canonical, opposite
from contact_tracker.geometry.lifted_pose import T
from contact_tracker.hypotheses import refinement
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.evidence import (
    DECISIVE,
    SAME_FIT_RATIO,
    EvidenceParameters,
    complexity,
    weak_prior,
)
from contact_tracker.hypotheses.observability import fitted_contact
from contact_tracker.hypotheses.refit import accumulate_window
from contact_tracker.map.elements import is_same_element
from contact_tracker.map.map import EMPTY_MAP, Map, NamedElement
from contact_tracker.motion.window import DIRECTIONS, Window, used_directions
from contact_tracker.states import CONTACTS, Contact

MAX_FURTHER: Final = 2
"""Most further contacts of a segment."""
MIN_TICKS: Final = 20
SPAN_TICKS: Final = 60
STRIDE_TICKS: Final = 15
"""Constraints are searched in all ticks, and in spans of this length and stride."""
MAX_SPANS: Final = 2
SURE_NATS: Final = 2.5
"""Log odds (nats) against no contact from which a further contact, or a joint, is reported."""
MIN_COMPLEXITY: Final = 25.0
"""Least complexity (nats) of the elements of a single constraint in short runs of ticks."""
EQUAL_GAIN: Final = 0.9
MAX_RMS: Final = 1.5
"""Greatest RMS of whitened residuals of a contact's elements."""


@dataclass(frozen=True, eq=False)
class KnownContact:
    """A contact and the parameters x (S,) of its elements."""

    contact: Contact
    x: Array

    @property
    def model(self) -> ContactModel:
        """Its model."""
        return CONTACT_MODELS[self.contact.column]

    @cached_property
    def c(self) -> Array:
        """Coefficients (K, 25) of its constraints."""
        return coefficients(self.model, self.x)


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


class Candidate(NamedTuple):
    """Elements of a possible contact, the ticks in which it is present, its ``gain`` (nats) and ``rms``;
    ``fitted``: their fit by maximum likelihood (T26) to ``window``, if there is one."""

    elements: KnownContact
    presence: Presence
    gain: float
    rms: float
    fitted: refinement.Refined | None = None
    window: Window | None = None


class FormationTicks(NamedTuple):
    """The ticks of a segment, and the parameters to evaluate contacts on them."""

    window: Window
    scales: EvidenceParameters
    leave_per_s: float
    origins: Origins
    known_map: Map = EMPTY_MAP
    systematic: SystematicErrors = SystematicErrors()
    """Errors of the poses that are not noise."""

    @property
    def kinds(self) -> tuple[Contact, ...]:
        """Contact kinds that the map allows."""
        return tuple(filter(self.known_map.allows, CONTACTS))

    def numbered(self, run: Run) -> Run:
        """A run of rows, by the numbers of ticks."""
        return Run(int(self.window.index[run.first]), int(self.window.index[run.end - 1]) + 1)

    def geometry_of(self, candidate: Candidate) -> ContactGeometry | None:
        """Fitted elements with covariance in the user's frames, named as in the map; None if a complete map
        lacks them."""
        assert candidate.fitted is not None
        assert candidate.window is not None
        fit = candidate.fitted.bank, 0, candidate.elements.model, self.scales, candidate.window
        fitted = fitted_contact(*fit, self.origins, self.systematic, candidate.fitted.information)
        named = named_by(self.known_map, fitted.geometry)
        complete = self.known_map.object_complete, self.known_map.environment_complete
        unlisted = any(name is None and only for name, only in zip(named.names, complete, strict=True))
        return None if unlisted else named

    @property
    def log_change(self) -> Array:
        """(W,) log probability that a contact begins or ends before each tick; zero motion allows hardly
        any."""
        moved = self.window.motion_ratio * (self.leave_per_s * self.scales.tick_s)
        return np.asarray(np.log(-np.expm1(-np.maximum(moved, 1e-4))))


def find_formation(segment: FormationTicks, first: KnownContact) -> Formation:
    """Find all further contacts; the ``first`` one lasts through the segment."""
    if len(segment.window) < MIN_TICKS:
        return NO_FORMATION
    free = ConditionalMotion.of(segment.window, segment.scales)
    further, is_open = _further_contacts(segment, first, free)
    return Formation(tuple(further), is_open, _ranks(free, segment.window.index, first, further))


def _ranks(motion: ConditionalMotion, index: Ints, first: KnownContact, further: Sequence[Further]) -> Ranks:
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


def _further_contacts(
    segment: FormationTicks, first: KnownContact, free: ConditionalMotion
) -> tuple[list[Further], bool]:
    """The further contacts of a segment, and whether the formation is open."""
    further, motion = list[Further](), free.keeping(first.c)
    while len(further) < MAX_FURTHER:
        spans = _promising_spans(motion)
        single = (search_span(segment, motion, model, span) for span, models in spans for model in models)
        best = best_of(filter(None, single))
        if best is None:
            return further, False
        run, models = longest_run(best.presence), (CONTACT_MODELS[kind.column] for kind in segment.kinds)
        rivals = [*filter(None, (search_span(segment, motion, model, run) for model in models))]
        best = best_of(allowed(segment, [best, *rivals]))
        if best is None:
            return further, True
        best = refine(segment, motion, best, longest_run(best.presence))
        if best is None:
            return further, True
        run = longest_run(best.presence)
        span = segment.numbered(run)
        holding = [contact.known for contact in further if any(map(span.overlaps, contact.runs))]
        confirmed = confirm(segment, motion, best, [first, *holding], run)
        if confirmed is None:
            return further, True
        geometry, _, new = confirmed
        inseparable = inseparable_kinds(segment, motion, best, rivals, run, new)
        runs = tuple(map(segment.numbered, best.presence.runs))
        further.append(Further(best.elements, geometry, runs, best.presence.log_odds, inseparable))
        for kept in best.presence.runs:
            motion = motion.keeping(best.elements.c, *kept)
    return further, False


def allowed(segment: FormationTicks, candidates: Iterable[Candidate]) -> list[Candidate]:
    """The candidates whose kinds the map allows."""
    return [candidate for candidate in candidates if candidate.elements.contact in segment.kinds]


def refine(segment: FormationTicks, motion: ConditionalMotion, best: Candidate, run: Run) -> Candidate | None:
    """The candidate with its elements refitted by maximum likelihood to ``run``.

    None if the refitted elements have no evidence beside the contacts that ``motion`` keeps: the likelihood
    ignores these, so the fit may end at the elements of one of them.
    """
    model, window = best.elements.model, segment.window.cut(*run)
    bank = blank(model, 1).replace_columns(x=best.elements.x[None])
    bank = accumulate_window(bank, model, window, segment.scales)
    fitted = refinement.refine(bank, model, window, segment.scales)
    refined = evaluate(segment, motion, KnownContact(model.contact, fitted.bank.x[0]))
    return None if refined is None else refined._replace(fitted=fitted, window=window)


def confirm(
    segment: FormationTicks,
    motion: ConditionalMotion,
    candidate: Candidate,
    holding: Sequence[KnownContact],
    run: Run,
) -> tuple[ContactGeometry, int, int] | None:
    """The geometry of a contact in ``run`` beside those that are ``holding``, the number of constraints of
    all together, and how many of them are new.

    None if it adds none, or a complete map lacks its elements, or the motion does not use all freedom that
    the contacts leave: there are further constraints, which they do not explain.
    """
    part, fewer = motion.cut(*run), holding[0].contact.codimension
    if len(holding) > 1:
        fewer = count_constraints(part.moved, [contact.c for contact in holding])
    constraints = count_constraints(part.moved, [contact.c for contact in (*holding, candidate.elements)])
    geometry = segment.geometry_of(candidate)
    uses_freedom = used_directions(segment.window.cut(*run)) >= DIRECTIONS - constraints
    if geometry is None or constraints <= fewer or not uses_freedom:
        return None
    return geometry, constraints, constraints - fewer


def _promising_spans(motion: ConditionalMotion) -> list[tuple[Run, list[ContactModel]]]:
    """Spans that may keep a further constraint, largest gain first, with the models of its kinds."""
    ticks = len(motion)
    spans = [Run(0, ticks)]
    if ticks > SPAN_TICKS + STRIDE_TICKS:
        starts = [*range(0, ticks - SPAN_TICKS, STRIDE_TICKS), ticks - SPAN_TICKS]
        spans += [Run(start, start + SPAN_TICKS) for start in starts]
    rated = []
    for span in spans:
        part = motion.cut(*span)
        ratios = _ratios(part)
        if ratios:
            rated.append((len(part) * float(np.log1p(max(ratios.values()))), span, [*ratios]))
    rated.sort(key=lambda entry: -entry[0])
    return [(span, models) for _, span, models in rated[:MAX_SPANS]]


def promising_kinds(motion: ConditionalMotion) -> tuple[float, list[ContactModel]]:
    """The largest gain (nats) of a further single constraint, and the kinds that the ticks may keep.

    In few ticks a constraint counts only if its gain can exceed the complexity of its elements.
    """
    least = float(np.expm1(2.0 * MIN_COMPLEXITY / len(motion)))
    ratios = {model: ratio for model, ratio in _ratios(motion).items() if ratio > least}
    return 0.5 * len(motion) * float(np.log1p(max(ratios.values(), default=0.0))), [*ratios]


def _ratios(motion: ConditionalMotion) -> dict[ContactModel, float]:
    ratios = {model: relaxed_ratio(moments(model, motion)) for model in RELAXED}
    return {model: ratio for model, ratio in ratios.items() if ratio > MIN_RATIO}


def search_span(
    segment: FormationTicks, motion: ConditionalMotion, model: ContactModel, span: Run
) -> Candidate | None:
    """The best elements of ``model`` in one span, evaluated on all ticks; None if they do not fit it."""
    part, window = motion.cut(*span), segment.window.cut(*span)
    elements = KnownContact(model.contact, search(model, part, window, segment.scales.reach_m))
    if np.sqrt(part.evidence(elements.c).chi_sq.mean()) < MAX_RMS:
        return evaluate(segment, motion, elements)
    return None


def elements_complexity(
    model: ContactModel,
    x: Array,
    motion: ConditionalMotion,
    window: Window,
    scales: EvidenceParameters,
    gain: float,
    noise_factor: float = 1.0,
) -> float:
    """Complexity (nats, T19) of elements x (S,) fitted to ``window`` with ``noise_factor`` times its noise;
    ``gain``: mean gain of its ticks (nats).

    Excludes the information of the first tick and of the free-motion prediction
    (``evidence.complexity``).
    """
    family = model.family
    anchors = model.anchors(window.zeta[:, T].mean(axis=0))[None]
    prior = weak_prior(family, anchors, scales.reach_m)
    c = coefficients(model, x)
    noise = np.sqrt(np.square(motion.gradients(c) * motion.noise_sd[:, None]).sum(axis=2)) + TINY  # (W, K)
    along = family.tangent(x[None], anchors)[0].T @ family.rows_derivative(x[None])[0]  # (K, P, C)
    slopes = along @ model.lifted(motion.new).T / (noise_factor * noise.T[:, None])  # (K, P, W)
    hessian = slopes @ slopes.swapaxes(1, 2)
    ticks = max(float(window.motion_ratio.sum()), 1.0)
    share = scales.prior_predictive_share * model.needed / ticks * np.exp(-2.0 * gain / family.ROWS)
    first_hessian = slopes[:, :, 0].T @ slopes[:, :, 0]
    at, shares = (x[None], x[None], anchors), np.full((1, family.ROWS), min(share, 1.0))
    return float(complexity(family, *at, hessian[None], first_hessian[None], shares, prior)[0])


def evaluate(segment: FormationTicks, motion: ConditionalMotion, elements: KnownContact) -> Candidate | None:
    """The runs in which elements touch and the log odds of contact; None without a run."""
    scales = segment.scales
    ticks = motion.evidence(elements.c)
    ratio = scales.likelihood_exponent * ticks.log_ratio
    presence = most_probable(ratio, segment.log_change)
    if not presence.runs:
        return None
    run = longest_run(presence)
    rows = np.concatenate([np.arange(*present) for present in presence.runs])
    gain = float(ticks.gain[rows].sum())
    part, mean = (motion.cut(*run), segment.window.cut(*run)), float(ticks.gain[slice(*run)].mean())
    cost = elements_complexity(elements.model, elements.x, *part, scales, mean)
    log_odds = presence.log_odds - scales.likelihood_exponent * min(cost, gain)
    rms = float(np.sqrt(ticks.chi_sq[rows].mean()))
    return Candidate(elements, Presence(presence.runs, log_odds), gain, rms)


def best_of(candidates: Iterable[Candidate]) -> Candidate | None:
    """The most probable candidate with log odds above ``SURE_NATS``; None without one."""
    sure = [candidate for candidate in candidates if candidate.presence.log_odds > SURE_NATS]
    return max(sure, key=lambda candidate: candidate.presence.log_odds) if sure else None


def longest_run(presence: Presence) -> Run:
    return max(presence.runs, key=lambda run: run.end - run.first)


def inseparable_kinds(
    segment: FormationTicks,
    motion: ConditionalMotion,
    best: Candidate,
    rivals: Sequence[Candidate],
    run: Run,
    new: int,
) -> tuple[Contact, ...]:
    """Contact kinds that explain the motion as well as ``best``, which adds ``new`` constraints to it.

    A kind contained in one of these counts if it has at least ``new`` constraints. As the best was refined
    on ``run``, rivals that fit less well are refined there as well.
    """
    alike = {best.elements.contact}
    for rival in rivals:
        if rival.rms > SAME_FIT_RATIO and rival.gain > EQUAL_GAIN * best.gain:
            rival = refine(segment, motion, rival, run) or rival
        near = rival.presence.log_odds > best.presence.log_odds - DECISIVE
        fits = rival.rms < SAME_FIT_RATIO * max(1.0, best.rms) and rival.gain > EQUAL_GAIN * best.gain
        if near or fits:
            alike.add(rival.elements.contact)
    kinds = (kind for kind in segment.kinds if kind.codimension >= new and kind is not best.elements.contact)
    return tuple(kind for kind in kinds if any(contact.contains(kind) for contact in alike))


def named_by(known_map: Map, geometry: ContactGeometry) -> ContactGeometry:
    """The geometry with the names of elements of the map that agree with it within their uncertainty."""
    return ContactGeometry(
        _named(geometry.object, known_map.listed_object),
        _named(geometry.environment, known_map.listed_environment),
    )


def _named(element: Element, named: Sequence[NamedElement]) -> Element:
    for listed in (entry for entry in named if not entry.is_covered):
        for side in (element, opposite(element)):  # the solid side of a plane is unknown
            if type(listed.element) is type(side) and is_same_element(side, listed.element):
                return replace(side, name=listed.name)
    return canonical(element)
