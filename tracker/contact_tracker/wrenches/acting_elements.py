"""Elements through which measured forces act, for each contact (docs/theory.md, T39 and T40).

Motion of few degrees of freedom is consistent with very different elements of one contact: an object that
turns on an edge could also have a face whose normal is the axis. The forces distinguish these.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Pair, Point, face_towards
from contact_tracker.geometry.vectors import EYE, unit
from contact_tracker.states import Contact
from contact_tracker.wrenches.line_of_action import REACH_M, LineFits, PointFit

Array = NDArray[np.float64]

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
