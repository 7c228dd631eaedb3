"""Birth rates of contacts of known elements, given how near they are (docs/theory.md, T29).

A known vertex is hardly ever within a millimetre of a known table by chance. So the birth rate of a contact
of known elements is multiplied by the likelihood ratio of the pose if they touch against if they may be
anywhere.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.births import BirthProposals
from contact_tracker.hypotheses.evidence import EvidenceParameters, residual_noise
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, STATES, Contact

ANY_DIRECTION: Final = 1.0 / 3.0
"""Variance of the cosine of the angle between independent, uniform directions."""
_IMPOSSIBLE: Final = -1e3
_HOPELESS: Final = -50.0
_ROUNDING: Final = 1e-14
"""Eigenvalues below this share of the largest are rounding errors."""
MOST_BIRTHS: Final = 100
"""Most known pairs of one contact that begin in a tick, the most probable ones. A box of known size beside
another has some 70 at most; without a limit hundreds of known edges, any two of which nearly cross, take
gigabytes."""
FREE: Final = Contact.FREE.column
FACES: Final = Contact.FF.column
ON_A_PLANE: Final = tuple(one.column for one in (Contact.EF, Contact.FE, Contact.VF, Contact.FV))


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
    for column, (model, begins, beyond) in enumerate(
        zip(CONTACT_MODELS, proposals, extra_variance, strict=True)
    ):
        pairs = _known_pairs(model, begins)
        if len(pairs.x) and uses_kernels:
            log_odds[column], gain[column], kept, words = calls.weigh_births(
                calls.model_of(model, scales.reach_m),
                begins.rows.words,
                *pairs,
                ticks,
                beyond,
                limits,
            )
            past = begins.rows.lag_history[: len(kept)]
            rows = Bank(words, begins.rows.layout, begins.rows.onsets, past)
            weighed.append(BirthProposals(rows, begins.is_given[kept], begins.are_both_known[kept]))
            continue
        newest = window.cut(-1).with_error(beyond) if len(pairs.x) else window
        own = proximity_evidence(model, begins, newest, scales) if len(pairs.x) else _prior_alone(begins)
        log_odds[column], gain[column] = own.log_odds, own.gain
        weighed.append(own.proposals)
    return tuple(weighed), log_odds, gain


def share_with_faces(log_odds: Array, gain: Array, share: float) -> tuple[Array, Array]:
    """The log odds (6,) and gains (6, 2) of ``weigh_births`` with what those of other contacts say of f-f.

    Where a known edge or vertex touches a known plane, so does a face that holds it and is not known yet,
    with this prior ``share``. Without it, what stands on a new face would be what stands on an edge.
    """
    most = max(ON_A_PLANE, key=log_odds.__getitem__)
    shared = log_odds[most] + np.log(share)
    if shared <= log_odds[FACES] or log_odds[FACES] <= _IMPOSSIBLE:
        return log_odds, gain
    log_odds, gain = log_odds.copy(), gain.copy()
    log_odds[FACES], gain[FACES] = shared, gain[most]
    return log_odds, gain


class ProximityEvidence(NamedTuple):
    """Evidence of the newest tick for the birth of one contact, in numpy."""

    log_share: Array
    """(n,) posterior log share of each proposal; they add up to one."""
    log_odds: float
    """Log-likelihood ratio of touching by any proposal against being anywhere."""
    gain: Array
    """(2,) part of it that one angle, and that the distance, contributes where it vanishes."""
    proposals: BirthProposals
    """The proposals with their shares given the pose; negligible ones, and known pairs beyond
    ``MOST_BIRTHS``, are left out."""

    @classmethod
    def of(cls, begins: BirthProposals, log_share: Array, gain: Array) -> Self:
        """The evidence by the log prior share of each proposal times its likelihood ratio (n,)."""
        log_odds = float(hmm.log_sum_exp(log_share))
        log_share = log_share - log_odds
        kept = log_share > _HOPELESS
        known = (kept & begins.are_both_known).nonzero()[0]
        if len(known) > MOST_BIRTHS:
            kept[known[log_share[known].argsort(kind="stable")[:-MOST_BIRTHS]]] = False
        own = log_share[kept]
        return cls(log_share, log_odds, gain, begins.pick(kept).sharing(own - hmm.log_sum_exp(own)))


class _KnownPairs(NamedTuple):
    """The proposals of one contact whose elements are both known: m of n."""

    is_known: NDArray[np.bool_]
    """(n,) which they are."""
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
        return _prior_alone(begins)
    log_share = begins.log_share.copy()
    row_gain, log_ratio = _touching_evidence(model, pairs, newest, scales)
    log_share[pairs.is_known] += log_ratio
    angle = row_gain[:, :-1].mean() if model.family.ROWS > 1 else 0.0
    return ProximityEvidence.of(begins, log_share, np.array([angle, row_gain[:, -1].mean()]))


@lru_cache(maxsize=8 * len(CONTACT_MODELS))
def _prior_alone(begins: BirthProposals) -> ProximityEvidence:
    """The evidence where no pair is known, so that no pose says more than the prior."""
    if not begins.count:
        return ProximityEvidence(np.zeros(0), _IMPOSSIBLE, np.zeros(2), begins)
    return ProximityEvidence.of(begins, begins.log_share.copy(), np.zeros(2))


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
    ratio = anywhere / noise
    gain = 0.5 * np.log1p(ratio)
    misfit = 0.5 * measurement.residual[:, :, 0] ** 2 / noise * (ratio / (1.0 + ratio))
    return gain, (gain - misfit).sum(axis=1)


def _spread(model: ContactModel, pairs: _KnownPairs, zeta: Array) -> Array:
    """Variance (m, K) of the residuals due to the uncertainty of the known elements."""
    lifted = model.lifted(zeta)
    variance = ((pairs.deviation @ lifted) ** 2).sum(axis=-1)
    variance[:, -1] /= model.family.scale_sq(pairs.x, np.outer(lifted, lifted))
    return np.asarray(variance)


@lru_cache(maxsize=8 * len(CONTACT_MODELS))  # proposals are the same in many ticks and trackers
def _known_pairs(model: ContactModel, begins: BirthProposals) -> _KnownPairs:
    """What the evidence needs of the known pairs, apart from the pose."""
    is_known = begins.are_both_known
    rows = begins.rows.pick(is_known.nonzero()[0])
    # known lines have anchors of their own, and other elements need none
    anchors = np.where(np.isnan(rows.line_anchor), 0.0, rows.line_anchor)
    tangent = model.family.tangent(rows.prior_mean, anchors)
    along = np.swapaxes(tangent, -1, -2)
    deviations = _deviations(along @ rows.prior_information @ tangent)
    by_tangent = along[:, None] @ model.family.rows_derivative(rows.prior_mean)
    return _KnownPairs(is_known, rows.prior_mean, deviations[:, None] @ by_tangent)


def _deviations(information: Array) -> Array:
    """Independent changes (m, P, P), a row each, by one standard deviation of parameters with this
    information (m, P, P)."""
    known = information.diagonal(axis1=1, axis2=2)
    scale = 1.0 / np.sqrt(np.maximum(known, _ROUNDING * known.max(axis=1, keepdims=True, initial=0.0)))
    even = scale[:, :, None] * information * scale[:, None]
    values, axes = np.linalg.eigh(0.5 * (even + even.swapaxes(1, 2)))
    values = np.maximum(values, _ROUNDING * values[:, -1:])
    return np.asarray((axes / np.sqrt(values)[:, None]).swapaxes(1, 2) * scale[:, None])


def reweight_transitions(change: Array, stay: Array, log_odds: Array, shown: Array) -> tuple[Array, Array]:
    """Log rates of change (7, 7) and of staying (7,), given the pose.

    ``log_odds`` (6,) and the gains ``shown`` (6, 2) are those of ``weigh_births``.

    Constraints that the old and the new state share carry no new evidence. Each row together with its stay
    keeps its sum, so that leaving a state and coming back gains nothing.
    """
    moved = change.copy()
    moved[:, : len(log_odds)] += log_odds - (_SHARED_ROWS * shown).sum(axis=-1)
    kept = np.where(np.arange(len(STATES)) == FREE, -np.inf, stay)  # free stays by the matrix
    before = np.logaddexp(np.logaddexp.reduce(change, axis=1), kept)
    after = np.logaddexp(np.logaddexp.reduce(moved, axis=1), kept)
    return moved - (after - before)[:, None], stay - (after - before)


def _shared_rows(before: Contact, after: Contact) -> tuple[int, int]:
    """How many angles and distances both contacts constrain in common, elements contained in each other."""
    shared = max(state.codimension for state in STATES if before.contains(state) and after.contains(state))
    return max(shared - 1, 0), min(shared, 1)


_SHARED_ROWS: Final = np.array([[_shared_rows(one, other) for other in CONTACTS] for one in STATES])
"""(7, 6, 2)"""
