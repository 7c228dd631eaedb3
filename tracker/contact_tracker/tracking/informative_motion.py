"""Suggested motions: small motions that would distinguish states that the motion so far does not.

A motion that one contact allows and another forbids separates the two. Its expected evidence (docs/theory.md,
T50; nats) is that of the residual it would leave in the fit of the other contact, against the noise of a tick
and the uncertainty of that fit's geometry: 1/2 r' (G P G' + N)^-1 r, with the residuals r (K,) after the
motion, their slopes G (K, S) by the geometry, its covariance P (S, S) and the noise N. Where the label's
evidence is ahead and a state is open only since the motion has not used all directions that the label leaves
(T24), the motion is one that uses the direction that was used least; its evidence is the label's lead.

Each motion is across those for the states before it: a contact that has just begun may explain any single
motion, so that only several directions at once tell the states apart soon.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import null_space

from contact_tracker.arrays import Array
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.lifted_pose import R, T, lift
from contact_tracker.geometry.linalg import from_rotation_vectors, matrices
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.hypotheses.gauss_newton import per_metre
from contact_tracker.hypotheses.observability import information_spectrum, perturbed_rows
from contact_tracker.motion.window import LEVER_M, LEVERS_M, STRIDE_TICKS, twist_power
from contact_tracker.states import Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.state import FilterState

TURN_RAD: Final = radians(15.0)
"""A motion is proposed up to this turn, or a shift as long as it turns ``LEVER_M``: small enough to be made
by hand without leaving contact. With 5 deg v-f is not distinguished from e-e (4 nats a move)."""
SHIFT_M: Final = TURN_RAD * LEVER_M
SMALL: Final = 0.1
"""A turn smaller than this share of the shift is left out; in the text also a shift smaller than this share
of the turn."""
PROJECTIONS: Final = 3
"""Newton steps by which a motion along the tangent is brought back into the contact that allows it."""


@dataclass(frozen=True, eq=False)
class InformativeMotion:
    """A small motion that would tell two states apart.

    Parameters
    ----------
    allowed_by, forbidden_by : the states; if the object can be moved so, ``forbidden_by`` loses evidence.
    turn_body_rad, turn_world_rad : (3,) rotation vector about the body's and the world's axes.
    point_body_m, point_world_m : (3,) a point on the axis of the turn.
    shift_body_m, shift_world_m : (3,) shift of that point, along the axis if there is a turn.
    evidence_nats : expected against ``forbidden_by``, of one tick at the end of the motion.
    """

    allowed_by: Contact
    forbidden_by: Contact
    turn_body_rad: Array
    turn_world_rad: Array
    point_body_m: Array
    point_world_m: Array
    shift_body_m: Array
    shift_world_m: Array
    evidence_nats: float

    @property
    def states(self) -> frozenset[Contact]:
        """The two states that it would tell apart."""
        return frozenset((self.allowed_by, self.forbidden_by))

    def to_json(self) -> dict[str, Any]:
        """An entry of ``suggestions``."""
        arrays = {name: value.tolist() for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        states = {"allowed_by": self.allowed_by.value, "forbidden_by": self.forbidden_by.value}
        return {**states, **arrays, "evidence_nats": self.evidence_nats}

    def __str__(self) -> str:
        angle_rad = float(np.linalg.norm(self.turn_world_rad))
        shift_m = float(np.linalg.norm(self.shift_world_m))
        parts = []
        if angle_rad > 0.0:
            axis, point = _text(self.turn_world_rad / angle_rad), _text(self.point_world_m)
            parts.append(f"turn about {axis} through {point} m by {degrees(angle_rad):.2g} deg")
        if shift_m > SMALL * LEVER_M * angle_rad:
            parts.append(f"shift along {_text(self.shift_world_m / shift_m)} by {1e3 * shift_m:.2g} mm")
        return f"{' and '.join(parts)} (world): {self.allowed_by} or {self.forbidden_by}"


def informative_motions(state: FilterState) -> tuple[InformativeMotion, ...]:
    """The most informative motion for each state that the motion does not distinguish from the label, across
    the others, the most informative first; without states that no motion would distinguish."""
    belief = state.belief
    if belief is None or not belief.inseparable or not len(state.window):
        return ()
    label = belief.contact
    onset = state.onset_of(label)
    fits = dict(_fits(state, onset, (label, *belief.inseparable)))
    lead_nats = -ambiguity.competing_evidence(state.banks, label, onset, state.ticks - 1).evidence
    motions, named = [], np.zeros((0, 6))
    for rival in belief.inseparable:
        pairs = ((label, rival), (rival, label))
        candidates = [motion for pair in pairs for motion in _between(state, fits, pair, named)]
        ahead_nats = float(min(lead_nats[rival.column], ambiguity.MOST_NATS))
        if ahead_nats > DECISIVE:
            candidates += _unused(state, fits, onset, (label, rival), named, ahead_nats)
        for motion, twist in sorted(candidates, key=lambda candidate: -candidate[0].evidence_nats)[:1]:
            motions.append(motion)
            named = np.concatenate([named, [twist / np.linalg.norm(twist)]])
    return tuple(sorted(motions, key=lambda motion: -motion.evidence_nats))


class _Fit(NamedTuple):
    """The fit of one contact: geometry x (S,) with its covariance (S, S), and the noise (K,) of its
    residuals in a tick."""

    model: ContactModel
    x: Array
    covariance: Array
    variance: Array
    moves: Array
    """(K, 6, C) change of the residuals' coefficients by turns and shifts."""

    def residual(self, zeta: Array) -> Array:
        """(K,) at a lifted pose (25,)."""
        return np.asarray(self.model.family.rows(self.x) @ self.model.lifted(zeta))

    def jacobian(self, zeta: Array) -> Array:
        """(K, 6) by turns about the body's axes in units of length (times ``LEVER_M``), and shifts."""
        return np.asarray(self.moves @ self.model.lifted(zeta) / np.repeat([LEVER_M, 1.0], 3))

    def precision(self, zeta: Array) -> Array:
        """Inverse covariance (K, K) of the residuals at a pose, by noise and the uncertainty of x."""
        slopes = self.model.family.rows_derivative(self.x) @ self.model.lifted(zeta)
        return np.asarray(np.linalg.inv(np.diag(self.variance) + slopes @ self.covariance @ slopes.T))


def _fits(state: FilterState, onset: int, contacts: tuple[Contact, ...]) -> Iterator[tuple[Contact, _Fit]]:
    """The fits of contacts with about this onset, if there are any."""
    rows = ambiguity.best_since(state.banks, onset, state.ticks - 1)
    for contact in contacts:
        if contact is Contact.FREE:
            continue
        bank, model = state.banks[contact.column], CONTACT_MODELS[contact.column]
        row = rows[contact.column]
        if row is None:
            continue
        hypothesis, beyond = bank.single(row), state.model.noise.extra_contact_variance[contact.column]
        variance = state.window.with_error(beyond).usual_variance
        x, spectrum = hypothesis.x[0], information_spectrum(hypothesis, model, state.scales, variance)
        weight = per_metre(model.family, hypothesis.second_moment[0], hypothesis.row_weight[0], x)
        noise = variance[0] / np.maximum(weight, np.finfo(float).tiny)
        yield contact, _Fit(model, x, spectrum.covariance, noise, perturbed_rows(hypothesis, model))


def _between(
    state: FilterState, fits: dict[Contact, _Fit], pair: tuple[Contact, Contact], named: Array
) -> Iterator[tuple[InformativeMotion, Array]]:
    """The motion along the constraints of the first contact that violates the second one most, across the
    twists (n, 6) that are ``named`` already; and its twist."""
    allowed_by, forbidden_by = pair
    forbids, allows = fits.get(forbidden_by), fits.get(allowed_by)
    if forbids is None or (allows is None and allowed_by is not Contact.FREE):
        return
    zeta = state.window.zeta[-1]
    jacobian = forbids.jacobian(zeta)
    kept = np.zeros((1, 6)) if allows is None else allows.jacobian(zeta)
    free = null_space(np.concatenate([kept, named]))
    if not free.size:
        return
    root = np.linalg.cholesky(forbids.precision(zeta))
    twist = free @ np.linalg.svd(root.T @ jacobian @ free)[2][0]
    ends = (_reached(zeta, sign * _within_limits(twist), allows) for sign in (1.0, -1.0))
    moved, twist = max(ends, key=lambda end: _evidence(forbids, end[0]))
    evidence_nats = _evidence(forbids, moved)
    if evidence_nats > DECISIVE:
        yield _described(state, zeta, twist, pair, evidence_nats), twist


def _unused(
    state: FilterState,
    fits: dict[Contact, _Fit],
    onset: int,
    pair: tuple[Contact, Contact],
    named: Array,
    evidence_nats: float,
) -> Iterator[tuple[InformativeMotion, Array]]:
    """The motion in the direction that the label, first of the ``pair``, leaves free and that was used least
    since its onset, across the twists (n, 6) that are ``named`` already; and its twist."""
    window = state.window.since(onset)
    fit = fits.get(pair[0])
    if fit is None or len(window) <= STRIDE_TICKS:
        return
    used, zeta = twist_power(window), state.window.zeta[-1]
    free = null_space(np.concatenate([fit.jacobian(zeta), named]))
    if not free.size:
        return
    turn, shift = zeta[R].reshape(3, 3) @ free[:3], free[3:]
    at_centre = shift - np.cross(turn.T / LEVER_M, zeta[T] - used.centre_m).T
    twists = np.concatenate([at_centre, turn])
    power = twists.T @ (used.power * np.outer(LEVERS_M, LEVERS_M)) @ twists
    _, twist = _reached(zeta, _within_limits(free @ np.linalg.eigh(power)[1][:, 0]), fit)
    yield _described(state, zeta, twist, pair, evidence_nats), twist


def _within_limits(twist: Array) -> Array:
    """A twist (6,), turn times ``LEVER_M`` and shift, as far as it goes within ``SHIFT_M`` each."""
    turn, shift = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
    return np.asarray(_without_small_turn(twist) * SHIFT_M / max(turn, shift))


def _without_small_turn(twist: Array) -> Array:
    """A twist (6,) without a turn that is small beside the shift, as its axis would be far away."""
    turn, shift = np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])
    return np.append(np.zeros(3), twist[3:]) if turn < SMALL * shift else twist


def _reached(zeta: Array, twist: Array, allows: _Fit | None) -> tuple[Array, Array]:
    """The lifted pose (25,) after a twist, and the twist, both brought back into the contact."""
    moved = _moved(zeta, twist)
    if allows is None:
        return moved, twist
    aim = allows.residual(zeta)  # what noise leaves at the pose stays
    for _ in range(PROJECTIONS):
        twist = twist - np.linalg.pinv(allows.jacobian(moved)) @ (allows.residual(moved) - aim)
        moved = _moved(zeta, twist)
    return moved, twist


def _moved(zeta: Array, twist: Array) -> Array:
    """The lifted pose (25,) after a turn about the body's axes and a shift along the world's."""
    turn = matrices(from_rotation_vectors(twist[:3] / LEVER_M))
    return lift(zeta[R].reshape(3, 3) @ turn, zeta[T] + twist[3:])


def _evidence(forbids: _Fit, zeta: Array) -> float:
    """Expected evidence (nats) of a tick at a lifted pose (25,) against a fit."""
    residual = forbids.residual(zeta)
    return float(0.5 * residual @ forbids.precision(zeta) @ residual)


def _described(
    state: FilterState, zeta: Array, twist: Array, states: tuple[Contact, Contact], evidence_nats: float
) -> InformativeMotion:
    """A finite twist (6,) as a turn about an axis in space and a shift along it, or as a shift alone."""
    twist = _without_small_turn(twist)
    rotation, origins = zeta[R].reshape(3, 3), state.origins
    turn, shift, point = rotation @ (twist[:3] / LEVER_M), twist[3:], zeta[T]
    angle = float(np.linalg.norm(turn))
    if angle > 0.0:
        axis = turn / angle
        across = shift - axis * (axis @ shift)
        point = point + 0.5 * (across + np.cross(axis, across) / np.tan(0.5 * angle))
        shift = shift - across
    return InformativeMotion(
        *states,
        rotation.T @ turn,
        turn,
        rotation.T @ (point - zeta[T]) + origins.body_m,
        point + origins.world_m,
        rotation.T @ shift,
        shift,
        evidence_nats,
    )


def _text(vector: Array) -> str:
    return f"({' '.join(f'{0.0 + round(float(part), 2):.2f}' for part in vector)})"
