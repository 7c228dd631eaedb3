"""Births of hypotheses: which elements a new contact may assume, and their rows before any data.

Elements are known, in the map, or new. A known vertex is hardly ever within a millimetre of a known table
by chance. So the birth rate of a contact of known elements is multiplied by the likelihood ratio of the pose
with the elements in contact against the elements anywhere (docs/theory.md, T29).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

import contact_tracker.hmm as hmm
from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.contacts.family import directions
from contact_tracker.geometry.elements import (
    ContactGeometry,
    Element,
    Pair,
    Plane,
    canonical,
    opposite,
)
from contact_tracker.geometry.lifted_pose import R
from contact_tracker.geometry.linalg import LEAST_SHARE
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.evidence import (
    DECISIVE,
    EvidenceParameters,
    gain_and_misfit,
    residual_noise,
)
from contact_tracker.map.association import MapView
from contact_tracker.map.elements import SAME, combined, mahalanobis
from contact_tracker.map.map import Map, NamedElement, Up
from contact_tracker.map.pairs import (
    Frame,
    NamedPair,
    PairPrior,
    known_entries,
    learned_pairs,
    named_pairs,
    pair_priors,
)
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, STATES, Contact


@dataclass(frozen=True, eq=False)
class BirthProposals:
    """n hypotheses of one contact that may begin, still without an onset."""

    rows: Bank
    """(n) hypotheses without data."""
    is_given: Bools
    """(n, S) which entries of x their prior fixes, see ``known_entries``."""
    are_both_known: Bools
    """(n,) whether their prior has both elements, so that a pose shows whether these touch."""

    @property
    def count(self) -> int:
        return len(self.rows)

    @property
    def log_share(self) -> Array:
        """Log share (n,) of the contact's birth weight."""
        return self.rows.log_likelihood

    @cached_property
    def prior_alone(self) -> "ProximityEvidence":
        """The evidence without a known pair: the prior alone."""
        if not self.count:
            return ProximityEvidence(np.zeros(0), _IMPOSSIBLE, np.zeros(2), self)
        return ProximityEvidence.of(self, self.log_share.copy(), np.zeros(2))

    def sharing(self, log_share: Array) -> "BirthProposals":
        """A copy with other log shares (n,)."""
        return replace(self, rows=self.rows.replace_columns(log_prior=log_share, log_likelihood=log_share))

    def pick(self, rows: NDArray[np.generic]) -> "BirthProposals":
        return BirthProposals(
            self.rows.pick(np.arange(self.count)[rows]), self.is_given[rows], self.are_both_known[rows]
        )


def make_proposals(
    model: ContactModel,
    pairs: Sequence[Pair],
    log_share: Sequence[float],
    known_pair_index: Sequence[int],
    are_both_known: Sequence[bool],
    elements_known: Sequence[bool] | None = None,
    cross: Array | None = None,
) -> BirthProposals:
    """One proposal for each of the ``pairs`` of elements, whose covariances are ``cross`` (``pair_priors``).

    Proposals whose directions the prior leaves open may search, and are protected from pruning during
    burn-in. The other parameters are columns of ``Bank``; by default elements are known as far as both are.
    """
    both_known = np.array(are_both_known, bool)
    fixed = both_known if elements_known is None else np.array(elements_known, bool)
    prior = pair_priors(model, pairs, cross)
    return with_prior(model, prior, np.array(log_share), np.array(known_pair_index), both_known, fixed)


def with_prior(
    model: ContactModel,
    prior: PairPrior,
    log_share: Array,
    known_pair_index: NDArray[np.int64],
    are_both_known: Bools,
    elements_known: Bools,
) -> BirthProposals:
    """One proposal for each of n priors on x.

    Elements known from other sources than this motion (``elements_known``) cannot follow it.
    """
    empty, is_given = blank(model, 0), known_entries(model, prior.mean, prior.information)
    needs_search = np.asarray(
        ~is_given[:, directions(model.family.FORM)].all(axis=1)
    )  # the rest is a linear problem
    is_informed = prior.information.any(axis=(1, 2))
    rows = blank(model, len(is_given)).replace_columns(
        prior_index=np.where(is_informed, 1 + np.arange(len(is_given)), 0),
        known_pair_index=known_pair_index,
        elements_known=np.array(elements_known, np.int64),
        needs_search=needs_search,
        prior_mean=prior.mean,
        prior_information=prior.information,
        line_anchor=prior.line_points_m,
        log_prior=log_share,
        log_likelihood=log_share,
        onset=0,
    )
    return BirthProposals(replace(rows, onsets=empty.onsets), is_given, are_both_known)


@lru_cache(maxsize=16)
def uninformed_proposal(model: ContactModel) -> BirthProposals:
    """The proposal of new elements, without a prior."""
    return make_proposals(model, [(None, None)], [0.0], [0], [False])


class Birth(NamedTuple):
    """Hypotheses of one contact that begin in a tick.

    Entries of x without prior start from the best hypothesis so far (a face opposite to a known one is
    parallel to it); in an empty bank they start from fixed directions in the body's frame.
    """

    proposals: BirthProposals
    """With the prior of each."""
    onset: int
    """Index of the tick."""
    onset_ns: int
    """Time at which the tick began."""
    number: int
    """Number of the first hypothesis; the next ones have the next numbers."""
    log_birth_weight: float
    """Log weight of the contact's birth."""
    lag_history: Array
    """(L, 7) probabilities of the states before."""
    turn: Array
    """(3, 3) orientation of the body."""


def add(bank: Bank, model: ContactModel, birth: Birth) -> Bank:
    """The bank with the birth's hypotheses added."""
    begins, old = birth.proposals, len(bank)
    if not begins.count:
        return bank
    is_given = begins.is_given
    words = np.concatenate([bank.words, begins.rows.words])
    onsets = replace(bank.onsets, words=np.pad(bank.onsets.words, ((0, 1), (0, 0))))
    onsets.rows["onset"][-1], onsets.rows["onset_ns"][-1] = birth.onset, birth.onset_ns
    past = join_histories(bank.lag_history, birth.lag_history, begins.count, np.arange(len(words)))
    extended = Bank(words, bank.layout, onsets, past)
    new = Bank(words[old:], bank.layout, onsets, past[old:])
    if old:
        best = bank.best_row
        x, new.rows["row_weight"][:] = bank.x[best], bank.row_weight[best]
    else:
        x = model.turned(new.rows["x"], birth.turn)
    new.rows["x"][:] = model.faced(np.where(is_given, begins.rows.prior_mean, x), is_given, birth.turn)
    new.rows["onset"][:] = birth.onset
    new.rows["number"][:] = birth.number + np.arange(begins.count)
    new.rows["log_birth_weight"][:] = birth.log_birth_weight
    return extended


def join_histories(past: Array, of_new: Array, count: int, rows: Ints) -> Array:
    """Lag histories (R, L, 7) of ``rows`` of: the old hypotheses, ``past`` (H, L, 7), then ``count`` new ones
    with the common history ``of_new`` (L, 7)."""
    if not past.shape[1]:
        return np.empty((len(rows), *past.shape[1:]))
    return np.concatenate([past, of_new[None].repeat(count, axis=0)])[rows]


class TickInput(NamedTuple):
    """The prediction for a tick before its evidence, with the hypotheses that begin in it, numbered one
    contact after the other."""

    proposals: tuple[BirthProposals, ...]
    """Per contact."""
    onset: int
    """Index of the tick."""
    onset_ns: int
    """Time at which it began."""
    number: int
    """Number of the first hypothesis of the first contact."""
    lag_history: Array
    """(7, L, 7) per state: probabilities of the states before."""
    window: Window
    """The latest ticks, this one included."""
    window_before: Window
    """The window before this tick."""
    hazard_exposure: float
    """Exposure to change, in ticks of motion."""
    log_transition: Array
    """(7, 7) log probabilities of a change before the tick, from row to column."""
    log_survival: Array
    """(7,) log probabilities of staying in each state through it."""
    log_birth_weight: Array
    """(7,) log birth weights."""
    speed_evidence: float
    """Evidence (nats) for free motion by the speed; ``log_transition`` and the birth weights contain it."""

    def birth(self, column: int) -> Birth:
        """The births of one contact."""
        number = self.number + sum(begins.count for begins in self.proposals[:column])
        weight, turn = float(self.log_birth_weight[column]), self.window.zeta[-1, R].reshape(3, 3)
        times = self.onset, self.onset_ns
        return Birth(self.proposals[column], *times, number, weight, self.lag_history[column], turn)


def propose_births(
    model: ContactModel, known_map: Map, view: MapView | None, incident_share: float, frame: Frame
) -> BirthProposals:
    """Proposals of a contact for the next tick. Their shares add up to one, unless there are none.

    If ``known_map`` leaves both elements open, they may be elements of the learned map ``view``. These were
    estimated from the motion at other times, so the prior contains all knowledge of them, and free motion is
    as predictable as for a new contact. ``incident_share`` is the prior probability of the elements of the
    last contact, or of elements incident with them if the contact needs other kinds.
    """
    assumed = named_pairs(known_map, model)
    if not assumed:
        return uninformed_proposal(model).pick(np.zeros(0, np.int64))
    pairs, near_m = [pair.pair(frame) for pair in assumed], np.array(frame.near_m)
    log_share, number = [pair.log_share for pair in assumed], list(range(len(assumed)))
    is_certain = [pair.is_certain for pair in assumed]
    unknown = next((i for i, pair in enumerate(assumed) if pair.object is pair.environment is None), None)
    if view is None or unknown is None:
        return make_proposals(model, pairs, log_share, number, is_certain)
    log_unknown, incident = log_share[unknown], view.incident_pair(model, near_m)
    if incident is not None and incident_share:
        pairs.append(incident)
        is_certain.append(False)
        log_share.append(log_unknown + np.log(incident_share))
        log_unknown += np.log1p(-incident_share)
    log_p_new, learned = learned_pairs(view, model, near_m)
    log_share[unknown] = log_unknown + log_p_new
    independent = np.zeros((len(pairs), *learned.cross.shape[1:]))
    pairs += learned.pairs
    return make_proposals(
        model,
        pairs,
        log_share + (log_unknown + learned.log_share).tolist(),
        number + [unknown] * (len(pairs) - len(assumed)),
        is_certain + learned.are_both_known.tolist(),
        is_certain + [False] * len(learned.pairs),
        np.concatenate([independent, learned.cross]),
    )


def propose_measured(model: ContactModel, known_map: Map, measured: Pair, frame: Frame) -> BirthProposals:
    """Proposals of a contact with elements that were ``measured`` otherwise than by motion (object in the
    body frame, surroundings in the world frame), where the map does not give them.

    If a normal of the surroundings is measured and the direction up is known, the more certain one counts.
    """
    body, world = (None if element is None else NamedElement("measured", element) for element in measured)
    if known_map.up is not None and world is not None and not _is_surer_than_up(world, known_map.up):
        world = None
    assumed = named_pairs(known_map, model)
    return make_proposals(
        model,
        [_fill_open(pair, body, world).pair(frame) for pair in assumed],
        [pair.log_share for pair in assumed],
        range(len(assumed)),
        [pair.is_certain for pair in assumed],
    )


def _is_surer_than_up(measured: NamedElement, up: Up) -> bool:
    """Whether a measured face has a smaller deviation than faces that point up; other elements have none."""
    element = measured.element
    if not isinstance(element, Plane) or element.covariance is None:
        return True
    return bool(np.trace(element.covariance[:3, :3]) < 2.0 * up.spread_rad**2)


def _fill_open(pair: NamedPair, object: NamedElement | None, environment: NamedElement | None) -> NamedPair:
    """The ``pair`` with these elements where it leaves them open."""
    environment = pair.environment or environment
    return NamedPair(pair.object or object, environment, pair.log_share, None if environment else pair.up)


def name_listed(geometry: ContactGeometry, known_map: Map, is_by_motion: bool = True) -> ContactGeometry:
    """The geometry with the names of the listed elements with which it agrees within the uncertainty of both
    (T28); an estimate that ``is_by_motion`` alone is combined with them."""
    body_is_open, world_is_open = geometry.has_open_offset
    return ContactGeometry(
        _name_nearest(geometry.object, known_map.listed_object, body_is_open, is_by_motion),
        _name_nearest(geometry.environment, known_map.listed_environment, world_is_open, is_by_motion),
    )


def _name_nearest(
    estimate: Element, listed: Sequence[NamedElement], is_open: bool, is_by_motion: bool
) -> Element:
    """The estimate of one element, with the name of the nearest ``listed`` one; of several parallel faces
    none is nearest if its offset ``is_open``. The solid side of an estimated plane is unknown."""
    senses, agreeing = (estimate, opposite(estimate)), list[tuple[float, int]]()
    for number, named in enumerate(listed):
        if type(named.element) is type(estimate) and not named.is_covered:
            distance = min(mahalanobis(sense, named.element) for sense in senses)
            if distance <= SAME:
                agreeing.append((distance, number))
    if not agreeing or (is_open and len(agreeing) > 1):
        return canonical(estimate)
    named = listed[min(agreeing)[1]]
    if is_by_motion or is_open:
        return replace(combined(named.element, estimate), name=named.name)
    return replace(estimate, name=named.name)


def name_elements(geometry: ContactGeometry, pair: NamedPair) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``pair``, with the names in the map."""
    faces = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
    return ContactGeometry(
        _name_element(geometry.object, pair.object, faces),
        _name_element(geometry.environment, pair.environment, faces),
    )


def _name_element(element: Element, map_element: NamedElement | None, faces: bool) -> Element:
    """The element with its name. If both are ``faces``, motion does not determine the offset, which is then
    the map's."""
    if map_element is None:
        return canonical(element)
    if faces and isinstance(element, Plane) and isinstance(map_element.element, Plane):
        assert element.covariance is not None
        assert map_element.element.covariance is not None
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = element.covariance[:3, :3]
        covariance[3, 3] = map_element.element.covariance[3, 3]
        side = 1.0 if element.normal @ map_element.element.normal > 0 else -1.0
        normal, offset_m = side * element.normal, map_element.element.offset_m
        return Plane(normal, offset_m, covariance, element.unobserved, map_element.name)
    return replace(element, name=map_element.name)


ANY_DIRECTION: Final = 1.0 / 3.0
"""Variance of the cosine of the angle between independent, uniform directions."""
_IMPOSSIBLE: Final = -1e3
_HOPELESS: Final = -50.0
MOST_BIRTHS: Final = 100
"""Largest number of known pairs of one contact, the most probable, that begin in a tick. Two boxes of known
size have some 70 at most; without a limit hundreds of known edges, any two of which nearly cross, take
gigabytes."""
NEAR_ENDS: Final = 0.1
"""Share of a segment's poses that may belong to the motion before or after it. By `contact-tracker evaluate`
0.52 of the time of 15 everyday recordings is open with 0.02, and 0.49 with 0.1, 0.2 and 0.5; but with 0.5 a
box that is tilted and lifted between rests is surely f-f throughout."""
MOST_POSES: Final = 50
"""Number of poses of a segment, at equal intervals, that show whether elements of the map touch. With 10,
0.505 of that time is open instead of 0.494; 200 is as 50."""
FREE: Final = Contact.FREE.column
FACES: Final = Contact.FF.column
ON_A_PLANE: Final = tuple(contact.column for contact in (Contact.EF, Contact.FE, Contact.VF, Contact.FV))


def weigh_births(
    proposals: Sequence[BirthProposals],
    window: Window,
    extra_variance: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
) -> tuple[tuple[BirthProposals, ...], Array, Array]:
    """Weigh the ``proposals`` of all contacts by the newest tick of the ``window``; returns them with the log
    odds (6,) and gains (6, 2) of each contact, see ``ProximityEvidence``.

    ``extra_variance`` is the noise variance (m^2, rad^2) of each contact beyond that of the window.
    """
    weighed, log_odds, gain = list[BirthProposals](), np.zeros(len(proposals)), np.zeros((len(proposals), 2))
    if uses_kernels := compiled.in_use():
        from contact_tracker.hypotheses.compiled import calls

        ticks = calls.ticks_of(window)
        limits = calls.birth_limits(ANY_DIRECTION, scales.reach_m, _HOPELESS, MOST_BIRTHS)
    for column, (model, begins, variance) in enumerate(
        zip(CONTACT_MODELS, proposals, extra_variance, strict=True)
    ):
        pairs = _known_pairs(model, begins)
        if len(pairs.x) and uses_kernels:
            log_odds[column], gain[column], kept, words = calls.weigh_births(
                calls.model_of(model, scales.reach_m),
                begins.rows.words,
                begins.are_both_known,
                *pairs,
                ticks,
                variance,
                limits,
            )
            past = begins.rows.lag_history[: len(kept)]
            rows = Bank(words, begins.rows.layout, begins.rows.onsets, past)
            weighed.append(BirthProposals(rows, begins.is_given[kept], begins.are_both_known[kept]))
            continue
        newest = window.cut(-1).with_error(variance) if len(pairs.x) else window
        evidence = proximity_evidence(model, begins, newest, scales) if len(pairs.x) else begins.prior_alone
        log_odds[column], gain[column] = evidence.log_odds, evidence.gain
        weighed.append(evidence.proposals)
    return tuple(weighed), log_odds, gain


def share_with_faces(log_odds: Array, gain: Array, share: float) -> tuple[Array, Array]:
    """The log odds (6,) and gains (6, 2) of ``weigh_births``, with those of f-f raised by edges and vertices.

    If a known edge or vertex touches a known plane, an unknown face that contains it also does, with this
    prior ``share``. Otherwise an object on a new face would seem to stand on an edge.
    """
    likeliest = max(ON_A_PLANE, key=log_odds.__getitem__)
    shared = log_odds[likeliest] + np.log(share)
    if shared <= log_odds[FACES] or log_odds[FACES] <= _IMPOSSIBLE:
        return log_odds, gain
    log_odds, gain = log_odds.copy(), gain.copy()
    log_odds[FACES], gain[FACES] = shared, gain[likeliest]
    return log_odds, gain


class ProximityEvidence(NamedTuple):
    """Evidence of the newest tick for the birth of one contact, in numpy."""

    log_share: Array
    """(n,) posterior log share of each proposal; they add up to one."""
    log_odds: float
    """Log-likelihood ratio of touching by any proposal against being anywhere."""
    gain: Array
    """(2,) part of the log odds that a vanishing angle and a vanishing distance contribute."""
    proposals: BirthProposals
    """The proposals with their shares given the pose; negligible ones, and known pairs beyond
    ``MOST_BIRTHS``, are left out."""

    @classmethod
    def of(cls, begins: BirthProposals, log_share: Array, gain: Array) -> Self:
        """The evidence by the log prior share of each proposal times its likelihood ratio (n,)."""
        log_odds = float(hmm.log_sum_exp(log_share))
        log_share = log_share - log_odds
        kept = log_share > _HOPELESS
        known_rows = (kept & begins.are_both_known).nonzero()[0]
        if len(known_rows) > MOST_BIRTHS:
            kept[known_rows[log_share[known_rows].argsort(kind="stable")[:-MOST_BIRTHS]]] = False
        share = log_share[kept]
        return cls(log_share, log_odds, gain, begins.pick(kept).sharing(share - hmm.log_sum_exp(share)))


class _KnownPairs(NamedTuple):
    """The m of n proposals of one contact whose elements are both known."""

    x: Array
    """(m, S) their elements."""
    deviation: Array
    """(m, K, P, C) changes of the residuals' coefficients c by one standard deviation of the elements, in
    each of P independent directions."""


def proximity_evidence(
    model: ContactModel, begins: BirthProposals, newest: Window, scales: EvidenceParameters
) -> ProximityEvidence:
    """Weigh the birth proposals of one contact by the newest tick: the reference of the compiled kernel."""
    pairs = _known_pairs(model, begins)
    if not len(pairs.x):
        return begins.prior_alone
    log_share = begins.log_share.copy()
    row_gain, log_ratio = _touching_evidence(model, pairs, newest, scales)
    log_share[begins.are_both_known] += log_ratio
    angle = row_gain[:, :-1].mean() if model.family.ROWS > 1 else 0.0
    return ProximityEvidence.of(begins, log_share, np.array([angle, row_gain[:, -1].mean()]))


def _touching_evidence(
    model: ContactModel, pairs: _KnownPairs, newest: Window, scales: EvidenceParameters
) -> tuple[Array, Array]:
    """Gain (m, K) of each row if it vanishes, and the log-likelihood ratio (m,) of touching against
    anywhere."""
    family, zeta = model.family, newest.zeta[-1]
    measurement = model.measure(pairs.x, newest.zeta[-1:])
    noise = residual_noise(measurement, newest.cut(-1, None))[..., 0] + _spread(model, pairs, zeta)
    anywhere = np.full(family.ROWS, ANY_DIRECTION)
    anywhere[-1] = scales.reach_m**2
    gain, misfit = gain_and_misfit(measurement.residual[:, :, 0] ** 2, noise, anywhere)
    return gain, (gain - misfit).sum(axis=1)


def _spread(model: ContactModel, pairs: _KnownPairs, zeta: Array) -> Array:
    """Variance (m, K) of the residuals due to the uncertainty of the known elements."""
    lifted = model.lifted(zeta)
    variance = ((pairs.deviation @ lifted) ** 2).sum(axis=-1)
    variance[:, -1] /= model.family.scale_sq(pairs.x, np.outer(lifted, lifted))
    return np.asarray(variance)


@lru_cache(maxsize=128)  # of six contacts in up to 16 filters, and of labels and places that recur
def _known_pairs(model: ContactModel, begins: BirthProposals) -> _KnownPairs:
    """The known pairs, with the terms of their evidence that do not depend on the pose."""
    rows = begins.rows.pick(begins.are_both_known.nonzero()[0])
    # known lines have anchors of their own, and other elements need none
    anchors = np.where(np.isnan(rows.line_anchor), 0.0, rows.line_anchor)
    tangent = model.family.tangent(rows.prior_mean, anchors)
    along = np.swapaxes(tangent, -1, -2)
    deviations = _deviations(along @ rows.prior_information @ tangent)
    by_tangent = along[:, None] @ model.family.rows_derivative(rows.prior_mean)
    return _KnownPairs(rows.prior_mean, deviations[:, None] @ by_tangent)


def map_evidence(
    model: ContactModel, begins: BirthProposals, window: Window, scales: EvidenceParameters
) -> tuple[Array, int]:
    """Log-likelihood ratio (7,) of the poses in the ``window``, if one of the known pairs that ``begins``
    proposes touches in all but a share ``NEAR_ENDS`` of them, against poses with the constraints of each
    state that the contact contains (T29); 0 for other states, and without known pairs whose distance is
    known. Also the number of that proposal, -1 without one."""
    pairs = _known_pairs(model, begins)
    assert window.frames is not None
    rows = np.flatnonzero(window.frames)
    if not len(pairs.x) or not len(rows):
        return np.zeros(len(STATES)), -1
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, MOST_POSES).round().astype(int))]
    poses = [_touching_evidence(model, pairs, window.cut(row, row + 1), scales) for row in rows.tolist()]
    row_gain, log_ratio = (np.quantile(part, NEAR_ENDS, axis=0) for part in zip(*poses, strict=True))
    is_located = row_gain[:, -1] > DECISIVE  # a hand may hold a face parallel to another one at any distance
    if not is_located.any():
        return np.zeros(len(STATES)), -1
    best = int(np.where(is_located, log_ratio, -np.inf).argmax())
    against = _against_contained(model, row_gain[best], float(log_ratio[best]))
    against[FREE] -= row_gain[best, :-1].sum()  # ... and so at this distance
    return against, int(np.flatnonzero(begins.are_both_known)[best])


def _against_contained(model: ContactModel, row_gain: Array, log_ratio: float) -> Array:
    """The log-likelihood ratio of touching against the states that the contact contains (7,), without that of
    the constraints that these have as well, from the gain (K,) of each row; 0 for other states."""
    contained = np.array([model.contact.contains(state) and state is not model.contact for state in STATES])
    gain = np.array([row_gain[:-1].mean() if model.family.ROWS > 1 else 0.0, row_gain[-1]])
    shared = (_SHARED_ROWS[:, model.contact.column] * gain).sum(axis=-1)
    return np.where(contained, log_ratio - shared, 0.0)


def prepare_weights(proposals: Sequence[BirthProposals]) -> None:
    """Compute the terms of the weights of all proposals that do not depend on the pose."""
    for model, begins in zip(CONTACT_MODELS, proposals, strict=True):
        _known_pairs(model, begins)


def _deviations(information: Array) -> Array:
    """Independent changes (m, P, P), a row each, by one standard deviation of parameters with this
    information (m, P, P)."""
    diagonal = information.diagonal(axis1=1, axis2=2)
    scale = 1.0 / np.sqrt(
        np.maximum(diagonal, LEAST_SHARE * diagonal.max(axis=1, keepdims=True, initial=0.0))
    )
    even = scale[:, :, None] * information * scale[:, None]
    values, axes = np.linalg.eigh(0.5 * (even + even.swapaxes(1, 2)))
    values = np.maximum(values, LEAST_SHARE * values[:, -1:])
    return np.asarray((axes / np.sqrt(values)[:, None]).swapaxes(1, 2) * scale[:, None])


def reweight_transitions(change: Array, stay: Array, log_odds: Array, gain: Array) -> tuple[Array, Array]:
    """Log rates of change (7, 7) and of staying (7,), given the pose.

    ``log_odds`` (6,) and ``gain`` (6, 2) are from ``weigh_births``.

    Constraints that the old and the new state share carry no new evidence. Each row together with its stay
    keeps its sum, so that leaving a state and coming back gains nothing.
    """
    moved = change.copy()
    moved[:, : len(log_odds)] += log_odds - (_SHARED_ROWS * gain).sum(axis=-1)
    kept = stay.copy()
    kept[FREE] = -np.inf  # free stays by the matrix
    old_sum = np.logaddexp(np.logaddexp.reduce(change, axis=1), kept)
    new_sum = np.logaddexp(np.logaddexp.reduce(moved, axis=1), kept)
    return moved - (new_sum - old_sum)[:, None], stay - (new_sum - old_sum)


def _shared_rows(before: Contact, after: Contact) -> tuple[int, int]:
    """Number of angles and number of distances that both contacts constrain."""
    shared = max(state.codimension for state in STATES if before.contains(state) and after.contains(state))
    return max(shared - 1, 0), min(shared, 1)


_SHARED_ROWS: Final = np.array([[_shared_rows(old, new) for new in CONTACTS] for old in STATES])
"""(7, 6, 2) ``_shared_rows`` of each state and each next contact."""
