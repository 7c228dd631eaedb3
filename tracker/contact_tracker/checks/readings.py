"""Other readings of the numbers of poses: mistakes that leave positions and orientations valid, each alone.

A reading undoes one mistake: angles taken in a wrong order, quaternions in another order or inverted, axes of
positions that are not those of orientations, orientations that are later or earlier than positions.
"""

from collections.abc import Callable, Iterator
from functools import cached_property, partial
from itertools import permutations, product
from math import pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry import rotation
from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

DELAYS_MS: Final = (-100, -70, -50, -35, -20, -10, -5, 5, 10, 20, 35, 50, 70, 100)
"""Delays of orientations against positions. What lies between is found by ``with_delay``."""
LEAST_VOLUME: Final = 1e-3
"""Bound of the ratio of volumes, for poses at which a reading is singular."""


class Turns(NamedTuple):
    """Quaternions (N, 4), and the log of the ratio (N,) by which the reading changes volumes of
    orientations: one that maps many of them to nearly one explains all of them, and nothing."""

    quat_xyzw: Array
    log_volume: Array


class Given:
    """The orientations of poses as they are, and as angles."""

    def __init__(self, poses: Poses) -> None:
        self.quat_xyzw = poses.quat_xyzw
        self.time_s = 1e-9 * (poses.stamp_ns - poses.stamp_ns[0])
        self._about = dict[tuple[str, int, bool], Array]()

    @cached_property
    def angles(self) -> Array:
        """(N, 3) about the fixed axes x, y, z, the middle one of at most a quarter turn."""
        matrix = rotation.matrices(self.quat_xyzw)
        middle = -np.arcsin(np.clip(matrix[:, 2, 0], -1.0, 1.0))
        first = np.arctan2(matrix[:, 2, 1], matrix[:, 2, 2])
        return np.stack([first, middle, np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])], axis=1)

    @cached_property
    def other_angles(self) -> Array:
        """The same rotations by a middle angle of more than a quarter turn, which numbers that were no angles
        in this order may have been."""
        turned = np.array([pi, pi, pi]) + self.angles * [1.0, -1.0, 1.0]
        return np.asarray((turned + pi) % (2.0 * pi) - pi)

    def about(self, axis: str, place: int, folds: bool) -> Array:
        """Rotations (N, 4) about an axis by one of ``angles`` or ``other_angles``."""
        key = axis, place, folds
        if key not in self._about:
            half = 0.5 * (self.other_angles if folds else self.angles)[:, place]
            quat = np.zeros((len(half), 4))
            quat[:, "xyz".index(axis)], quat[:, 3] = np.sin(half), np.cos(half)
            self._about[key] = quat
        return self._about[key]

    @cached_property
    def log_volume(self) -> Array:
        """(N,) log density of orientations per volume of ``angles``."""
        return _log(np.cos(self.angles[:, 1]))


class Reading(NamedTuple):
    """One reading.

    Parameters
    ----------
    text : what is likely wrong, and what to do.
    axes : (3, 3) by which positions are multiplied.
    turns : the orientations; None leaves them as they are.
    delay_ms : of orientations against positions.
    """

    text: str
    axes: Array | None = None
    turns: Callable[[Given], Turns] | None = None
    delay_ms: float = 0.0


def read_turns(reading: Reading, given: Given) -> Turns:
    """The orientations in a reading."""
    if reading.turns is not None:
        return reading.turns(given)
    zero = np.zeros(len(given.time_s))
    if reading.delay_ms:
        return Turns(_later(given, 1e-3 * reading.delay_ms), zero)
    return Turns(given.quat_xyzw, zero)


def with_delay(delay_ms: float) -> Reading:
    """The reading in which orientations are this much later than positions."""
    late = "later" if delay_ms > 0.0 else "earlier"
    sign = "-" if delay_ms > 0.0 else "+"
    return Reading(
        f"orientations are {abs(delay_ms):.0f} ms {late} than positions: interpolate them, with their times "
        f"{sign} {abs(delay_ms):.0f} ms, at the times of positions",
        delay_ms=delay_ms,
    )


def _later(given: Given, delay_s: float) -> Array:
    """Orientations of the time ``delay_s`` after each pose; at the ends the last and the first."""
    time_s = given.time_s
    wanted = np.clip(time_s + delay_s, 0.0, time_s[-1])
    before = np.clip(np.searchsorted(time_s, wanted, "right") - 1, 0, len(time_s) - 2)
    share = ((wanted - time_s[before]) / (time_s[before + 1] - time_s[before]))[:, None]
    first, second = given.quat_xyzw[before], given.quat_xyzw[before + 1]
    nearer = np.where((first * second).sum(axis=1, keepdims=True) < 0.0, -second, second)
    between = first * (1.0 - share) + nearer * share
    return np.asarray(between / np.linalg.norm(between, axis=1, keepdims=True))


def _log(volume: Array) -> Array:
    return np.asarray(np.log(np.maximum(np.abs(volume), LEAST_VOLUME)))


def _by_angles(order: str, places: tuple[int, int, int], folds: bool, given: Given) -> Turns:
    """Rotations about the body's axes in this order, of the angles at ``places``."""
    first, second, third = (given.about(*one, folds) for one in zip(order, places, strict=True))
    quat = rotation.product(rotation.product(first, second), third)
    angle = (given.other_angles if folds else given.angles)[:, places[1]]
    middle = np.sin(angle) if order[0] == order[2] else np.cos(angle)
    return Turns(quat, _log(middle) - given.log_volume)


def _by_vector(folds: bool, given: Given) -> Turns:
    """Rotation vectors: those of the two that are of at most half a turn."""
    vector, other = (given.other_angles, given.angles) if folds else (given.angles, given.other_angles)
    is_long = np.linalg.norm(vector, axis=1) > pi
    vector = np.where(is_long[:, None], other, vector)
    angle = np.linalg.norm(vector, axis=1)
    volume = np.square(np.sinc(0.5 * angle / pi))
    return Turns(rotation.from_rotation_vectors(vector), _log(volume) - given.log_volume)


def _of_quaternions(order: tuple[int, ...], sign: float, given: Given) -> Turns:
    quat = given.quat_xyzw[:, order] * [sign, sign, sign, 1.0]
    return Turns(quat, np.zeros(len(quat)))


_W_FIRST: Final = "like w x y z in fields that are x y z w"
_W_LAST: Final = "like x y z w in fields that are w x y z"
_INVERTED: Final = "and inverted (rotation of the world in the body): reorder and conjugate them"
_QUATERNIONS: Final = (
    ("inverted (rotation of the world in the body): conjugate them", (0, 1, 2, 3), -1.0),
    (f"{_W_FIRST}: reorder them", (1, 2, 3, 0), 1.0),
    (f"{_W_FIRST}, {_INVERTED}", (1, 2, 3, 0), -1.0),
    (f"{_W_LAST}: reorder them", (3, 0, 1, 2), 1.0),
    (f"{_W_LAST}, {_INVERTED}", (3, 0, 1, 2), -1.0),
)


def _by_quaternions() -> Iterator[Reading]:
    for text, order, sign in _QUATERNIONS:
        yield Reading(f"quaternions look {text}", turns=partial(_of_quaternions, order, sign))


def _orders() -> Iterator[tuple[str, str, tuple[int, int, int]]]:
    """Code that makes rotations of three numbers, the order of the body's axes, and the places of their
    angles: the 24 orders of Euler angles, and angles named after their axes in the four orders beside."""
    axes = "xyz"
    for first, second, third in permutations(axes):
        for order in (first + second + third, first + second + first):
            yield f'from_euler("{order.upper()}", [a, b, c])', order, (0, 1, 2)
            yield f'from_euler("{order}", [a, b, c])', order[::-1], (2, 1, 0)
        places = axes.index(first), axes.index(second), axes.index(third)
        if second != "y":
            numbers = ", ".join("abc"[i] for i in places)
            yield (
                f'from_euler("{(first + second + third).upper()}", [{numbers}])',
                first + second + third,
                places,
            )


def _by_three_numbers() -> Iterator[Reading]:
    what = "orientations look like three numbers a, b, c that were taken for angles about fixed x, y, z: take"
    for folds in (False, True):
        for code, order, places in _orders():
            keeps_fold = places[1] == 1 and order[0] != order[2]
            if (order, places) != ("zyx", (2, 1, 0)) and not (folds and keeps_fold):
                yield Reading(
                    f"{what} Rotation.{code} of SciPy", turns=partial(_by_angles, order, places, folds)
                )
        yield Reading(f"{what} Rotation.from_rotvec([a, b, c]) of SciPy", turns=partial(_by_vector, folds))


def _by_axes() -> Iterator[Reading]:
    """Turned axes; positions of opposite sign fit alike, so that they stand for mirrored axes as well."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.zeros((3, 3))
        axes[range(3), order] = signs
        if np.linalg.det(axes) > 0.0 and not (axes == np.eye(3)).all():
            one, other = (_named(order, sign * np.array(signs)) for sign in (1.0, -1.0))
            what = "the axes of positions are not those of orientations: take positions as"
            yield Reading(f"{what} {one}, or as {other} if an axis is mirrored", axes=axes)


def _named(order: tuple[int, ...], signs: Array) -> str:
    parts = (("" if sign > 0.0 else "-") + "xyz"[i] for i, sign in zip(order, signs, strict=True))
    return f"({', '.join(parts)})"


READINGS: Final = (
    Reading(""),
    *_by_quaternions(),
    *_by_three_numbers(),
    *_by_axes(),
    *map(with_delay, DELAYS_MS),
)
"""The first leaves poses as they are."""
UNITS: Final = (
    Reading("m"),
    Reading("cm", axes=1e-2 * np.eye(3)),
    Reading("mm", axes=1e-3 * np.eye(3)),
)
"""Units of positions."""
