"""How well the lines of action of a window meet a fixed point, a fixed line, or keep a direction.

All of it comes from sums over ticks, so any window is a difference of two of them (docs/theory.md, T36, T37).
Evidence is against lines of action that wander by ``WANDER_M`` from tick to tick; it has the price of what is
fitted, by Laplace's approximation for points and by integration over all directions for lines.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.vectors import EYE, cross, dot, sphere_tangent, unit
from contact_tracker.wrenches.load import skew

Array = NDArray[np.float64]

FLOOR_M: Final = 0.5e-3
"""Lines of action pass their element no nearer than this: contacts give way, and ticks hold tremor."""
TWIST_M: Final = 1e-3
"""Moment about the line of action over the force that a contact at a point has."""
WANDER_M: Final = 1.5e-3
"""Standard deviation from tick to tick where nothing holds a line of action."""
REACH_M: Final = 0.3
"""Prior distance of elements from the origin of the window's frame."""
CONE_RAD: Final = float(np.radians(4.0))
"""Deviation of forces from the normal, by friction."""
REPEATED: Final = 0.1
"""Share of what a tick says of a direction that it says anew: friction follows the motion."""
PARALLEL_RAD: Final = float(np.radians(0.7))
"""Error of an orientation, with what gives way in a face."""
ANGLES: Final = 36
REFINEMENTS: Final = 2


@dataclass(frozen=True, eq=False)
class LinesOfAction:
    """Forces and moments (T, 3) of ticks in one frame about its origin, and the variance (T,) of their place
    across the force (m^2)."""

    force_n: Array
    moment_nm: Array
    variance_m2: Array

    @property
    def direction(self) -> Array:
        """(T, 3) unit vectors."""
        return unit(self.force_n)

    @property
    def excess(self) -> Array:
        """(T,) variance of what wanders, with the noise."""
        return self.variance_m2 + WANDER_M**2

    @property
    def row_gain(self) -> float:
        """What a row earns in all ticks that it holds."""
        return float(0.5 * np.log(self.excess / self.variance_m2).sum())

    def through_point(self) -> float:
        """Log evidence that all go through one point of the frame."""
        strength = np.linalg.norm(self.force_n, axis=1)
        across = skew(self.direction)
        design = across @ skew(self.force_n) / strength[:, None, None]
        target = np.einsum("tij,tj->ti", across, self.moment_nm) / strength[:, None]
        weight = 1.0 / self.variance_m2 - 1.0 / self.excess
        prior = EYE / REACH_M**2
        information = np.einsum("t,tji,tjk->ik", weight, design, design) + prior
        pull = np.einsum("t,tji,tj->i", weight, design, target)
        squares = float(weight @ dot(target, target) - pull @ np.linalg.solve(information, pull))
        price = 0.5 * (np.linalg.slogdet(information)[1] - np.linalg.slogdet(prior)[1])
        return 2.0 * self.row_gain - 0.5 * squares - float(price)

    def twist(self) -> float:
        """Log evidence that there is no moment about the lines themselves: only against, not in favour, since
        little friction leaves none in any contact."""
        twist_m = dot(self.force_n, self.moment_nm) / dot(self.force_n, self.force_n)
        least = self.variance_m2 - FLOOR_M**2 + TWIST_M**2
        return float(-0.5 * (twist_m**2 * (1.0 / least - 1.0 / (least + WANDER_M**2))).sum())

    def along_lines(self) -> "LineFits":
        """Log likelihoods that all meet one line of the frame, which is normal to the mean force, by its
        direction."""
        strength_sq = dot(self.force_n, self.force_n)
        weight = (1.0 / self.variance_m2 - 1.0 / self.excess) / strength_sq
        rows = np.concatenate([self.moment_nm, self.force_n], axis=1)
        moments = np.einsum("t,ti,tj->ij", weight, rows, rows)
        normal = unit(self.direction.sum(axis=0))
        first, second = sphere_tangent(normal).T
        middle, half = 0.5 * np.pi, 0.5 * np.pi
        directions, values, cell = np.zeros((0, 3)), np.zeros(0), np.pi / ANGLES
        for level in range(REFINEMENTS + 1):
            angle = middle + half * (2.0 * np.arange(ANGLES) + 1.0 - ANGLES) / ANGLES
            some = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
            found = _log_likelihood(moments, some, normal)
            directions, values = np.concatenate([directions, some]), np.append(values, found)
            cell, middle = 2.0 * half / ANGLES, angle[found.argmax()]
            if level < REFINEMENTS:
                half *= 6.0 / ANGLES
        top = found.max()
        log_mean = top + float(np.log(np.exp(found - top).sum() * cell / np.pi))
        return LineFits(directions, values, self.row_gain + log_mean, self.row_gain)


@dataclass(frozen=True, eq=False)
class LineFits:
    """Unit directions (N, 3) of lines, their log likelihoods (N,), the ``evidence`` of all with the price of
    what is fitted, and what its one row earns at most."""

    direction: Array
    log_likelihood: Array
    evidence: float
    row_gain: float

    @property
    def best(self) -> Array:
        """(3,) the likeliest direction."""
        return np.asarray(self.direction[self.log_likelihood.argmax()])

    def across(self, other: Array) -> float:
        """What is lost, at least, where the line crosses the direction ``other`` (3,): lines that are parallel
        constrain the same coordinate, and it counts once."""
        shared = (self.direction @ other) ** 2
        return float((self.log_likelihood - self.log_likelihood.max() - shared * self.row_gain).max())


def _log_likelihood(moments: Array, direction: Array, normal: Array) -> Array:
    """(N,) of lines with ``direction`` (N, 3), their places being integrated over: m = a n + b n x d."""
    side = cross(normal, direction)
    by_moment, mixed, by_force = moments[:3, :3], moments[:3, 3:], moments[3:, 3:]
    squares = dot(direction @ by_moment, direction)
    up, along = direction @ mixed @ normal, dot(direction @ mixed, side)
    prior = REACH_M**-2
    aa, bb, ab = normal @ by_force @ normal + prior, dot(side @ by_force, side) + prior, side @ by_force @ normal
    determinant = aa * bb - ab**2
    left = squares - (bb * up**2 - 2.0 * ab * up * along + aa * along**2) / determinant
    return np.asarray(-0.5 * left - 0.5 * np.log(determinant / prior**2))


def fixed_direction(direction: Array) -> float:
    """Log likelihood that unit vectors (T, 3) are one direction, but for friction."""
    mean = direction.sum(axis=0)
    return float(-0.5 * REPEATED * (len(direction) - mean @ mean / len(direction)) / CONE_RAD**2)


def fixed_in_both(direction: Array, rotation: Array) -> float:
    """The same of one direction of the body, which its rotations (T, 3, 3) keep fixed in the world as well."""
    count, mean = len(direction), rotation.mean(axis=0)
    turned = EYE - mean.T @ mean
    information = REPEATED * count * (EYE / CONE_RAD**2 + turned / PARALLEL_RAD**2)
    pull = REPEATED * direction.sum(axis=0) / CONE_RAD**2
    return float(-0.5 * (REPEATED * count / CONE_RAD**2 - pull @ np.linalg.solve(information, pull)))
