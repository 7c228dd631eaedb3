"""Meeting known elements: how it changes which contacts are likely to begin (docs/theory.md, T29).

That a vertex whose place is known is within a millimetre of a known table hardly happens by chance. A contact
of known elements therefore begins most likely at poses that have them touch: its rate of beginning is
multiplied by how much likelier the pose is if they touch than if they may be anywhere.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from contact_tracker import hmm
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses.birth import BirthProposals
from contact_tracker.hypotheses.evidence import EvidenceParameters, residual_noise
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES, Contact

ANY_DIRECTION: Final = 1.0 / 3.0
"""Variance of the cosine of the angle between directions that have nothing to do with each other."""
_IMPOSSIBLE: Final = -1e3
_HOPELESS: Final = -50.0
FREE: Final = Contact.FREE.column


class ProximityEvidence(NamedTuple):
    """What a tick says of a contact that may begin with it.

    ``log_share`` (n,) of each of its beginnings, adding up to one; ``log_odds`` of meeting any of them
    against being anywhere; ``gain`` (2,) of that what one angle and what the distance is worth, where they
    vanish.
    """

    log_share: Array
    log_odds: float
    gain: Array

    def of(self, begins: BirthProposals) -> BirthProposals:
        """``begins`` with their shares of the contact's weight, given where the object is."""
        return begins.sharing(self.log_share).pick(self.log_share > _HOPELESS)


def proximity_evidence(
    model: ContactModel, begins: BirthProposals, newest: Window, scales: EvidenceParameters
) -> ProximityEvidence:
    """Weigh what may begin of one contact by the newest tick."""
    if not begins.count:
        return ProximityEvidence(np.zeros(0), _IMPOSSIBLE, np.zeros(2))
    log_share, certain = begins.log_share.copy(), begins.rows.elements_known
    gain = np.zeros(2)
    if certain.any():
        row_gain, log_ratio = _touching_evidence(model, begins.pick(certain), newest, scales)
        log_share[certain] += log_ratio
        gain[:] = row_gain[:, :-1].mean() if model.family.ROWS > 1 else 0.0, row_gain[:, -1].mean()
    log_odds = float(hmm.log_sum_exp(log_share))
    return ProximityEvidence(log_share - log_odds, log_odds, gain)


def _touching_evidence(
    model: ContactModel, begins: BirthProposals, newest: Window, scales: EvidenceParameters
) -> tuple[Array, Array]:
    """Gain (n, K) of each row if it vanishes, and the log-likelihood ratio (n,) of touching and anywhere."""
    family, zeta = model.family, newest.zeta[-1]
    measurement = model.measure(begins.rows.prior_mean, newest.zeta[-1:])
    noise = residual_noise(measurement, newest.cut(-1, None))[..., 0] + _spread(model, begins, zeta)
    anywhere = np.full(family.ROWS, ANY_DIRECTION)
    anywhere[-1] = scales.reach_m**2
    ratio = anywhere / noise
    gain = 0.5 * np.log1p(ratio)
    misfit = 0.5 * measurement.residual[:, :, 0] ** 2 / noise * (ratio / (1.0 + ratio))
    return gain, (gain - misfit).sum(axis=1)


def _spread(model: ContactModel, begins: BirthProposals, zeta: Array) -> Array:
    """Variance (n, K) of the residuals by how exactly the elements are known."""
    family, lifted, x = model.family, model.lifted(zeta), begins.rows.prior_mean
    anchors = np.where(np.isnan(begins.rows.line_anchor), model.anchors(zeta[9:12]), begins.rows.line_anchor)
    tangent = family.tangent(x, anchors)
    along = np.swapaxes(tangent, -1, -2)
    jacobian = (along[:, None] @ family.rows_derivative(x) @ lifted[:, None])[..., 0]
    jacobian[:, -1] /= np.sqrt(family.scale_sq(x, np.outer(lifted, lifted)))[:, None]
    covariance = np.linalg.inv(along @ begins.rows.prior_information @ tangent)
    return np.asarray(np.einsum("bkp,bpq,bkq->bk", jacobian, covariance, jacobian))


def reweight_transitions(
    change: Array, stay: Array, meetings: Sequence[ProximityEvidence]
) -> tuple[Array, Array]:
    """Rates of change (7, 7) and of staying (7,), in logs, given where the object is.

    What the state before and the new one have in common has been met already. Each row with its stay still
    adds up to what it did: nothing is earned by leaving and coming back.
    """
    gain = np.zeros_like(change)
    for j, contact_evidence in enumerate(meetings):
        for i, state in enumerate(STATES):
            shared = _shared_rows(state, STATES[j])
            gain[i, j] = contact_evidence.log_odds - contact_evidence.gain @ [
                max(shared - 1, 0),
                min(shared, 1),
            ]
    moved = change + gain
    kept = np.where(np.arange(len(STATES)) == FREE, -np.inf, stay)  # free stays by the matrix
    before, after = (np.logaddexp(hmm.log_sum_exp(rows, axis=1), kept) for rows in (change, moved))
    return moved - (after - before)[:, None], stay - (after - before)


def _shared_rows(before: Contact, after: Contact) -> int:
    """How many constraints both contacts have in common, elements contained in each other."""
    return max(state.codimension for state in STATES if before.contains(state) and after.contains(state))
