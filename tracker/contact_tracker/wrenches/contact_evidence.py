"""Evidence of measured wrenches for each state in a window of time (docs/theory.md, T39 to T41), and the
elements through which the forces act.

Motion of few degrees of freedom is consistent with very different elements of one contact: an object that
turns on an edge could also have a face whose normal is the axis. The forces distinguish these.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.geometry.elements import Element, Line, Pair, Point, face_towards, shifted
from contact_tracker.geometry.linalg import EYE, cross, cross_matrix, dot, sphere_tangent, unit
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.wrenches.load import REACH_M, Load, contact_wrenches
from contact_tracker.wrenches.wrenches import TickWrenches

FLOOR_M: Final = 0.5e-3
"""Standard deviation of lines of action from their element (m): compliance, and tremor within ticks."""
TWIST_M: Final = 1e-3
"""Moment about the line of action over force (m) of a point contact."""
WANDER_M: Final = 1.5e-3
"""Standard deviation from tick to tick of an unconstrained line of action (m)."""
CONE_RAD: Final = float(np.radians(4.0))
"""Deviation of forces from the normal by friction (rad)."""
REPEATED: Final = 0.1
"""Share of a tick's evidence on a direction that is independent, as friction follows the motion."""
PARALLEL_RAD: Final = float(np.radians(0.7))
"""Error of an orientation, including the compliance of a face (rad)."""
EXPONENT: Final = 0.2
"""Power of the likelihoods of wrenches, since consecutive ticks are correlated."""
ANGLES: Final = 36
REFINEMENTS: Final = 2


@dataclass(frozen=True, eq=False)
class LinesOfAction:
    """Forces and moments of ticks in one frame about its origin.

    Parameters
    ----------
    force_n, moment_nm : (T, 3).
    variance_m2 : (T,) of the position across the force, independent from tick to tick.
    common_n, common_nm : (T, 3, P) derivatives of forces and moments by P standard errors that all ticks
    share.
    """

    force_n: Array
    moment_nm: Array
    variance_m2: Array
    common_n: Array
    common_nm: Array

    @property
    def direction(self) -> Array:
        """(T, 3) unit vectors of the forces."""
        return unit(self.force_n)

    @property
    def excess(self) -> Array:
        """(T,) variance (m^2) of unconstrained lines, including the noise."""
        return self.variance_m2 + WANDER_M**2

    @property
    def row_gain(self) -> float:
        """Largest log evidence of one constraint in all ticks."""
        return float(0.5 * np.log(self.excess / self.variance_m2).sum())

    def in_world_frame(self, rotation: Array, origin_m: Array) -> "LinesOfAction":
        """The lines in the world frame, for bodies with ``rotation`` (T, 3, 3) and frames at ``origin_m`` (T,
        3); about the mean of these."""
        force = np.einsum("tij,tj->ti", rotation, self.force_n)
        moment = np.einsum("tij,tj->ti", rotation, self.moment_nm)
        about = origin_m - origin_m.mean(axis=0)
        moment = moment + cross(about, force)
        common_n = rotation @ self.common_n
        common_nm = rotation @ self.common_nm + cross_matrix(about) @ common_n
        return LinesOfAction(force, moment, self.variance_m2, common_n, common_nm)

    def through_point(self) -> tuple[Point, float]:
        """The point of the frame through which all lines pass, and the log evidence that they do."""
        strength = np.linalg.norm(self.force_n, axis=1)
        across = cross_matrix(self.direction)
        design = across @ np.concatenate([cross_matrix(self.force_n) * REACH_M, self.common_nm], axis=2)
        design /= strength[:, None, None]
        target = np.einsum("tij,tj->ti", across, self.moment_nm) / strength[:, None]
        weight = 1.0 / self.variance_m2 - 1.0 / self.excess
        information = np.einsum("t,tji,tjk->ik", weight, design, design) + np.eye(design.shape[2])
        pull = np.einsum("t,tji,tj->i", weight, design, target)
        best = np.linalg.solve(information, pull)
        squares = float(weight @ dot(target, target) - pull @ best)
        evidence = 2.0 * self.row_gain - 0.5 * squares - 0.5 * float(np.linalg.slogdet(information)[1])
        covariance = REACH_M**2 / EXPONENT * np.linalg.inv(information)[:3, :3]
        return Point(-REACH_M * best[:3], covariance), evidence

    def twist(self) -> float:
        """Log evidence that there is no moment about the lines themselves, as with little friction no contact
        has one; at most zero."""
        strength = np.linalg.norm(self.force_n, axis=1)
        twist_m = dot(self.direction, self.moment_nm) / strength
        common = np.einsum("ti,tij->tj", self.direction, self.common_nm) / strength[:, None]
        least = self.variance_m2 - FLOOR_M**2 + TWIST_M**2
        weight = 1.0 / least - 1.0 / (least + WANDER_M**2)
        pull = common.T @ (weight * twist_m)
        information = (common.T * weight) @ common + np.eye(common.shape[1])
        return float(-0.5 * (weight @ twist_m**2 - pull @ np.linalg.solve(information, pull)))

    def along_lines(self) -> "LineFits":
        """Log likelihoods, by direction, that all lines intersect one line of the frame normal to the mean
        force."""
        weight = (1.0 / self.variance_m2 - 1.0 / self.excess) / dot(self.force_n, self.force_n)
        rows = np.concatenate(
            [self.moment_nm[..., None], self.common_nm, cross_matrix(self.force_n) * REACH_M], axis=2
        )
        moments = np.einsum("t,tia,tjb->iajb", weight, rows, rows)
        normal = unit(self.direction.sum(axis=0))
        first, second = sphere_tangent(normal).T
        middle, half = 0.5 * np.pi, 0.5 * np.pi
        directions, values, cell = np.zeros((0, 3)), np.zeros(0), np.pi / ANGLES
        for level in range(REFINEMENTS + 1):
            angle = middle + half * (2.0 * np.arange(ANGLES) + 1.0 - ANGLES) / ANGLES
            trial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
            likelihood = _log_likelihood(moments, trial, normal)
            directions, values = np.concatenate([directions, trial]), np.append(values, likelihood)
            cell, middle = 2.0 * half / ANGLES, angle[likelihood.argmax()]
            if level < REFINEMENTS:
                half *= 6.0 / ANGLES
        top = likelihood.max()
        log_mean = top + float(np.log(np.exp(likelihood - top).sum() * cell / np.pi))
        return LineFits(directions, values, normal, self.row_gain + log_mean, self.row_gain)


@dataclass(frozen=True, eq=False)
class LineFits:
    """Unit directions (N, 3) of lines normal to the mean force with direction ``normal`` (3,), their log
    likelihoods (N,), the marginal log ``evidence``, and the largest log evidence of one constraint."""

    direction: Array
    log_likelihood: Array
    normal: Array
    evidence: float
    row_gain: float

    @property
    def best(self) -> Array:
        """(3,) the most likely direction."""
        return np.asarray(self.direction[self.log_likelihood.argmax()])

    @property
    def angle_variance(self) -> float:
        """Variance (rad^2) of the direction about the best one."""
        side = np.cross(self.normal, self.best)
        angle = np.arctan2(self.direction @ side, self.direction @ self.best)
        angle = (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi  # opposite directions are one line
        angle, first = np.unique(angle, return_index=True)
        weight = np.exp(EXPONENT * (self.log_likelihood[first] - self.log_likelihood.max()))
        spacing = np.gradient(angle)  # angles are denser near the best one
        weight *= spacing
        return float(weight @ angle**2 / weight.sum() + spacing.min() ** 2 / 12.0)

    def across(self, axis: Array) -> float:
        """Least loss of log evidence if the line has to cross the direction ``axis`` (3,); parallel lines
        constrain the same coordinate, which counts once."""
        shared = (self.direction @ axis) ** 2
        return float((self.log_likelihood - self.log_likelihood.max() - shared * self.row_gain).max())


def _log_likelihood(moments: Array, direction: Array, normal: Array) -> Array:
    """Log likelihoods (N,) of lines with ``direction`` (N, 3); positions and errors are marginalised.

    ``moments`` (3, C, 3, C): second moments of rows (3, C), the moment and its derivatives by common errors
    and by a shift of the line, whose parts along the ``normal`` and across it and the line count.
    """
    count, shifts = moments.shape[1], slice(moments.shape[1] - 3, None)
    normals = np.broadcast_to(normal, direction.shape)
    basis = np.zeros((len(direction), count, count - 1))  # from a row to one with shifts across the line
    basis[:, : count - 3, : count - 3] = np.eye(count - 3)
    basis[:, shifts, shifts] = np.stack([normals, cross(normals, direction)], axis=2)
    along = np.einsum("ni,iajb,nj->nab", direction, moments, direction, optimize=True)
    products = np.asarray(basis.swapaxes(1, 2) @ along @ basis)
    information = products[:, 1:, 1:] + np.eye(count - 2)
    pull = products[:, 1:, 0]
    solved = np.asarray(np.linalg.solve(information, pull[..., None])[..., 0], float)
    squares = products[:, 0, 0] - dot(pull, solved)
    return np.asarray(-0.5 * squares - 0.5 * np.linalg.slogdet(information)[1])


def fixed_direction(direction: Array) -> float:
    """Log likelihood that unit vectors (T, 3) are one direction, up to friction."""
    mean = direction.sum(axis=0)
    return float(-0.5 * REPEATED * (len(direction) - mean @ mean / len(direction)) / CONE_RAD**2)


def fixed_in_both(direction: Array, rotation: Array) -> float:
    """Log likelihood that they are one direction of the body that rotations (T, 3, 3) do not move."""
    count, mean = len(direction), rotation.mean(axis=0)
    turned = EYE - mean.T @ mean
    information = REPEATED * count * (EYE / CONE_RAD**2 + turned / PARALLEL_RAD**2)
    pull = REPEATED * direction.sum(axis=0) / CONE_RAD**2
    return float(-0.5 * (REPEATED * count / CONE_RAD**2 - pull @ np.linalg.solve(information, pull)))


FEWEST_TICKS: Final = 3
FREE_SD_N: Final = 0.5
"""Residual force of a free object (N): inertia in the tremor of a hand."""
FREE_CLIP: Final = (-2.0, 3.0)
"""Bounds (nats) of a tick's evidence for contact: a contact force may be small."""
SIGNIFICANT: Final = 5.0
"""Least force, in standard deviations, whose line of action is used."""
BEGINNING_S: Final = 2.0
"""Time (s) after which the free-motion filter has estimated the strength of motion."""
MISFIT_NATS: Final = -10.0
"""If all contacts fit worse than this (nats) although there is a force, the window has several contacts."""


class WindowEvidence(NamedTuple):
    """Evidence of the wrenches in a window of time.

    Parameters
    ----------
    log_evidence : (7,) of each state, to the power ``EXPONENT``, against free motion.
    elements : the elements through which the forces act, by contact; empty where they are too small.
    """

    log_evidence: Array
    elements: Mapping[Contact, Pair]


@dataclass(frozen=True, eq=False)
class WrenchEvidence:
    """The wrenches of all ticks of a recording, of a hand that carries a ``load``, and the evidence of any
    window of them."""

    ticks: TickWrenches
    load: Load

    @cached_property
    def contact(self) -> tuple[Array, Array, Array, Array]:
        """Contact forces, moments and their errors, see ``contact_wrenches``."""
        return contact_wrenches(self.ticks, self.load)

    def _forces(self, rows: Ints) -> tuple[Array, Array]:
        """Contact forces (n, 3) in the ticks ``rows``, and their variance (n,) per axis, by noise and by the
        load's errors."""
        force, _, errors, _ = (values[rows] for values in self.contact)
        return force, self.ticks.force_variance[rows] + np.square(errors).sum(axis=(1, 2)) / 3.0

    def of_window(self, first_ns: int, last_ns: int) -> WindowEvidence | None:
        """The evidence from ``first_ns`` to ``last_ns``; None if there are too few measurements, or no
        contact fits them.

        The first and the last tick are left out, as they may be of another contact.
        """
        rows = self._measured(first_ns, last_ns)
        if len(rows) < FEWEST_TICKS:
            return None
        contact, (kinds, elements) = self._against_free(rows), self._of_kinds(rows)
        if contact > 0.0 and kinds.max() < MISFIT_NATS:
            return None  # several contacts one after the other, or at once
        return WindowEvidence(EXPONENT * np.append(contact + kinds, 0.0), elements)

    def shows_contact_at_start(self) -> bool:
        """Whether a contact force is measured in the first ``BEGINNING_S``; not if too few are measured."""
        first_ns = int(self.ticks.stamp_ns[0])
        rows = self._measured(first_ns, first_ns + int(BEGINNING_S * 1e9))
        return len(rows) >= FEWEST_TICKS and self._against_free(rows) > 0.0

    def _measured(self, first_ns: int, last_ns: int) -> Ints:
        """Rows of the ticks with wrenches in this time, without its first and last tick."""
        first, end = self.ticks.stamp_ns.searchsorted([first_ns, last_ns + 1])
        rows = np.arange(first + 1, end - 1)
        return rows[self.ticks.is_measured[rows]]

    @cached_property
    def _typical_square(self) -> float:
        """Typical squared contact force: the median of all ticks (N^2)."""
        measured = self.contact[0][self.ticks.is_measured]
        return float(np.median(dot(measured, measured))) + FREE_SD_N**2

    def _against_free(self, rows: Ints) -> float:
        """Log ratio (nats) of any contact force to no force in the ticks ``rows``."""
        force, variance = self._forces(rows)
        square = dot(force, force)
        typical = self._typical_square
        variance = np.minimum(FREE_SD_N**2 + variance, typical)
        ratio = 0.5 * square * (1.0 / variance - 1.0 / typical) - 1.5 * np.log(typical / variance)
        return float(np.clip(ratio, *FREE_CLIP).sum())

    def _of_kinds(self, rows: Ints) -> tuple[Array, Mapping[Contact, Pair]]:
        """Log evidence (6,) of the contacts, and their elements, from the significant lines of action."""
        force, variance = self._forces(rows)
        strong = dot(force, force) > SIGNIFICANT**2 * 3.0 * variance
        rows, force = rows[strong], force[strong]
        if len(rows) < FEWEST_TICKS:
            return np.zeros(len(CONTACTS)), {}
        _, moment, common_n, common_nm = (values[rows] for values in self.contact)
        square, ticks = dot(force, force), self.ticks.at(rows)
        foot, rotation = cross(force, moment) / square[:, None], ticks.rotation
        place = (ticks.moment_variance + dot(foot, foot) * ticks.force_variance) / square
        middle = foot.mean(axis=0)  # the prior of elements is centred where the force acts
        common_nm = common_nm - cross_matrix(middle) @ common_n
        body = LinesOfAction(force, moment - cross(middle, force), place + FLOOR_M**2, common_n, common_nm)
        origin_m = np.einsum("tij,j->ti", rotation, middle) + ticks.position_m
        world = body.in_world_frame(rotation, origin_m)
        body_fixed, world_fixed = fixed_direction(body.direction), fixed_direction(world.direction)
        edge, ridge, twist = body.along_lines(), world.along_lines(), body.twist()
        (vertex, vertex_gain), (peak, peak_gain) = body.through_point(), world.through_point()
        mean = rotation.mean(axis=0)
        crossing = max(ridge.across(mean @ edge.best), edge.across(mean.T @ ridge.best))
        faces = body.direction.mean(axis=0), world.direction.mean(axis=0)
        elements = acting_elements(faces, (edge, ridge), (vertex, peak), (middle, origin_m.mean(axis=0)))
        evidence = (
            fixed_in_both(body.direction, rotation),
            edge.evidence + world_fixed,
            ridge.evidence + body_fixed,
            vertex_gain + twist + world_fixed,
            peak_gain + twist + body_fixed,
            edge.evidence + ridge.evidence + crossing + twist,
        )
        return np.array(evidence), elements


FRICTION_RAD: Final = float(np.radians(10.0))
"""Standard deviation (rad) of the mean force from the normal by friction: if a hand drags an object to one
side, a coefficient of 0.3 tilts the force by 17 deg."""
MOST_RAD: Final = float(np.radians(20.0))
"""Largest standard deviation (rad) of a direction that is used."""


def acting_elements(
    faces: tuple[Array, Array],
    lines: tuple[LineFits, LineFits],
    points: tuple[Point, Point],
    origins_m: tuple[Array, Array],
) -> Mapping[Contact, Pair]:
    """The elements of the object (body frame) and of the surroundings (world frame) by contact; None for an
    unknown element.

    Parameters
    ----------
    faces : mean directions (3,) of the contact force on the object, in the body's and in the world's axes.
    lines, points : in frames with these axes, whose origins are at ``origins_m`` in the body and the world.
    """
    body, world = (
        {"f": face_towards(unit(face), FRICTION_RAD), "e": _line(line, place), "v": shifted(point, place)}
        for face, line, point, place in zip((-faces[0], faces[1]), lines, points, origins_m, strict=True)
    )
    return {contact: (body[contact.value[0]], world[contact.value[2]]) for contact in CONTACTS}


def _line(fits: LineFits, origin_m: Array) -> Element | None:
    variance = fits.angle_variance
    if variance > MOST_RAD**2:
        return None
    direction, normal, covariance = fits.best, fits.normal, np.zeros((6, 6))
    side = np.cross(normal, direction)
    covariance[:3, :3] = variance * np.outer(side, side) + FRICTION_RAD**2 * np.outer(normal, normal)
    covariance[3:, 3:] = REACH_M**2 * (EYE - np.outer(direction, direction))
    return Line(direction, origin_m, covariance)
