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
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Pair, Point, face_towards
from contact_tracker.geometry.vectors import EYE, cross, cross_matrix, dot, unit
from contact_tracker.states import STATES, Contact
from contact_tracker.wrenches.line_of_action import (
    FLOOR_M,
    REACH_M,
    LineFits,
    LinesOfAction,
    PointFit,
    fixed_direction,
    fixed_in_both,
)
from contact_tracker.wrenches.load import ContactWrenches

Array = NDArray[np.float64]

EXPONENT: Final = 0.2
"""Power of the likelihoods of wrenches, as consecutive ticks are correlated."""
FEWEST_TICKS: Final = 3
FREE_SD_N: Final = 0.5
"""Residual force of a free object (N): inertia in the tremor of a hand."""
FREE_CLIP: Final = (-2.0, 3.0)
"""Bounds of a tick's evidence (nats) for and against free motion: a contact force may be small."""
SIGNIFICANT: Final = 5.0
"""Least force, in standard deviations, that has a line of action."""
BEGINNING_S: Final = 2.0
"""Time after which the free-motion filter knows the strength of motion."""
MISFIT_NATS: Final = -10.0
"""If all contacts fit worse than this although there is a force, the window has no single contact."""


class WindowEvidence(NamedTuple):
    """What wrenches show in a window of time.

    Parameters
    ----------
    log_evidence : (7,) of each state, to the power ``EXPONENT``, against free motion.
    elements : the elements through which the forces act, by contact; empty where they are too small.
    """

    log_evidence: Array
    elements: Mapping[Contact, Pair]


@dataclass(frozen=True, eq=False)
class WrenchEvidence:
    """Contact wrenches of all ticks of a recording, and the evidence of any window of them."""

    wrenches: ContactWrenches

    def of_window(self, first_ns: int, last_ns: int) -> WindowEvidence | None:
        """The evidence from ``first_ns`` to ``last_ns``; None if there are too few measurements, or no
        contact fits them.

        The first and the last tick are left out, as they may be of another contact.
        """
        rows = self._measured(first_ns, last_ns)
        if len(rows) < FEWEST_TICKS:
            return None
        contact = self._against_free(rows)
        kinds, elements = self._of_kinds(rows)
        if contact > 0.0 and kinds.max() < MISFIT_NATS:
            return None  # several contacts one after the other, or at once
        return WindowEvidence(EXPONENT * np.append(contact + kinds, 0.0), elements)

    def shows_contact_at_start(self) -> bool:
        """Whether a contact force is measured in the first ``BEGINNING_S``; not if too few are measured."""
        first_ns = int(self.wrenches.ticks.stamp_ns[0])
        rows = self._measured(first_ns, first_ns + int(BEGINNING_S * 1e9))
        return len(rows) >= FEWEST_TICKS and self._against_free(rows) > 0.0

    def _measured(self, first_ns: int, last_ns: int) -> NDArray[np.int64]:
        """Rows of the ticks with wrenches, without the first and the last of this time."""
        first, end = self.wrenches.ticks.stamp_ns.searchsorted([first_ns, last_ns + 1])
        rows = np.arange(first + 1, end - 1)
        return rows[self.wrenches.is_measured[rows]]

    @cached_property
    def _typical_square(self) -> float:
        """Typical squared contact force: the median of all ticks (N^2)."""
        measured = self.wrenches.force_n[self.wrenches.is_measured]
        return float(np.median(dot(measured, measured))) + FREE_SD_N**2

    def _against_free(self, rows: NDArray[np.int64]) -> float:
        """Log ratio of any contact force to none."""
        force = self.wrenches.force_n[rows]
        square = dot(force, force)
        typical = self._typical_square
        variance = np.minimum(FREE_SD_N**2 + self.wrenches.force_variance(rows), typical)
        ratio = 0.5 * square * (1.0 / variance - 1.0 / typical) - 1.5 * np.log(typical / variance)
        return float(np.clip(ratio, *FREE_CLIP).sum())

    def _of_kinds(self, rows: NDArray[np.int64]) -> tuple[Array, Mapping[Contact, Pair]]:
        """Log evidence (6,) of each contact, and its elements, by the lines of action that are
        significant."""
        wrenches = self.wrenches
        force, variance = wrenches.force_n[rows], wrenches.force_variance(rows)
        strong = dot(force, force) > SIGNIFICANT**2 * 3.0 * variance
        rows, force = rows[strong], force[strong]
        if len(rows) < FEWEST_TICKS:
            return np.zeros(len(STATES) - 1), {}
        moment, rotation, square = wrenches.moment_nm[rows], wrenches.ticks.rotation[rows], dot(force, force)
        foot = cross(force, moment) / square[:, None]
        place = (wrenches.moment_noise[rows] + dot(foot, foot) * wrenches.force_noise[rows]) / square
        middle = foot.mean(axis=0)  # the prior of elements is centred where the force acts
        of_force, of_moment = (errors[rows] for errors in wrenches.load_errors)
        body = LinesOfAction(
            force,
            moment - cross(middle, force),
            place + FLOOR_M**2,
            of_force,
            of_moment - cross_matrix(middle) @ of_force,
        )
        origin_m = np.einsum("tij,j->ti", rotation, middle) + wrenches.ticks.position_m[rows]
        world = body.in_world_frame(rotation, origin_m)
        of_body, of_world = fixed_direction(body.direction), fixed_direction(world.direction)
        edge, ridge, twist = body.along_lines(), world.along_lines(), body.twist()
        vertex, peak = body.through_point(), world.through_point()
        mean = rotation.mean(axis=0)
        crossing = max(ridge.across(mean @ edge.best), edge.across(mean.T @ ridge.best))
        faces = body.direction.mean(axis=0), world.direction.mean(axis=0)
        elements = acting_elements(
            faces, (edge, ridge), (vertex, peak), (middle, origin_m.mean(axis=0)), EXPONENT
        )
        evidence = np.array(
            [
                fixed_in_both(body.direction, rotation),
                edge.evidence + of_world,
                ridge.evidence + of_body,
                vertex.evidence + twist + of_world,
                peak.evidence + twist + of_body,
                edge.evidence + ridge.evidence + crossing + twist,
            ]
        )
        return evidence, elements


FRICTION_RAD: Final = float(np.radians(10.0))
"""Standard deviation of the mean force from the normal, by friction: a hand that drags an object to one side
with a coefficient of 0.3 turns it by 17 deg."""
MOST_RAD: Final = float(np.radians(20.0))
"""Largest standard deviation of a direction that is used."""


def acting_elements(
    faces: tuple[Array, Array],
    lines: tuple[LineFits, LineFits],
    points: tuple[PointFit, PointFit],
    origins_m: tuple[Array, Array],
    exponent: float,
) -> Mapping[Contact, Pair]:
    """The elements of the object (body frame) and of the surroundings (world frame) by contact; None for one
    that is not known.

    Parameters
    ----------
    faces : mean directions (3,) of the contact force on the object, in the body's and in the world's axes.
    lines, points : in frames with these axes, whose origins are at ``origins_m`` in the body and the world.
    exponent : power of the likelihoods, as consecutive ticks are correlated.
    """
    ours, theirs = (
        {
            "f": face_towards(unit(face), FRICTION_RAD),
            "e": _line(line, origin_m, exponent),
            "v": _point(point, origin_m, exponent),
        }
        for face, line, point, origin_m in zip((-faces[0], faces[1]), lines, points, origins_m, strict=True)
    )
    return {
        contact: (ours[contact.value[0]], theirs[contact.value[2]])
        for contact in Contact
        if contact is not Contact.FREE
    }


def _line(fits: LineFits, origin_m: Array, exponent: float) -> Element | None:
    variance = fits.angle_variance(exponent)
    if variance > MOST_RAD**2:
        return None
    direction, normal, covariance = fits.best, fits.normal, np.zeros((6, 6))
    side = np.cross(normal, direction)
    covariance[:3, :3] = variance * np.outer(side, side) + FRICTION_RAD**2 * np.outer(normal, normal)
    covariance[3:, 3:] = REACH_M**2 * (EYE - np.outer(direction, direction))
    return Line(direction, origin_m, covariance)


def _point(fit: PointFit, origin_m: Array, exponent: float) -> Element:
    return Point(origin_m + fit.point_m, fit.covariance_m2 / exponent)
