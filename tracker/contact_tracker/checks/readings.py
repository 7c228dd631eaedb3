"""Other readings of the numbers of poses: mistakes that leave positions and orientations valid, each alone.

A reading undoes one mistake: angles taken in a wrong order, quaternions in another order or inverted, axes of
positions that are not those of orientations, orientations that are later or earlier than positions.
"""

from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import permutations, product
from math import pi
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from contact_tracker.arrays import Array
from contact_tracker.config.table_reading import QUATERNION
from contact_tracker.geometry import linalg
from contact_tracker.motion.poses import AS_GIVEN, Poses, ReadAs

DELAYS_MS: Final = (-100, -70, -50, -35, -20, -10, -5, 5, 10, 20, 35, 50, 70, 100)
"""Delays (ms) of orientations against positions; ``with_delay`` refines them."""
LEAST_VOLUME: Final = 1e-3
"""Lower bound of the ratio of volumes, for poses at which a reading is singular."""


class Turns(NamedTuple):
    """Quaternions (N, 4), and the log (N,) of the factor by which the reading changes volumes of
    orientations: a reading that maps many orientations to nearly one explains them all, without evidence."""

    quat_xyzw: Array
    log_volume: Array


class Angles(NamedTuple):
    """Three angles about axes of the body in turn.

    Parameters
    ----------
    axes : three letters, the first and the third may be the same.
    places : index of each angle among three numbers; those about x, y and z, if the axes differ.
    """

    axes: str
    places: tuple[int, int, int]

    @property
    def is_proper(self) -> bool:
        """Whether the first and the third axis are one."""
        return self.axes[0] == self.axes[2]

    @property
    def is_by_axis(self) -> bool:
        """Whether each number is the angle about the axis of its name; always for two equal axes."""
        return self.is_proper or all("xyz"[place] == axis for axis, place in zip(*self, strict=True))

    def rotation(self, numbers: Array) -> Rotation:
        """Rotations (N) by three numbers (N, 3), in rad."""
        return Rotation.from_euler(self.axes.upper(), numbers[:, self.places])


def angles_in(order: str) -> Angles:
    """Angles in an order of SciPy: ``xyz`` about fixed axes, ``XYZ`` about those of the body."""
    axes = order.lower()
    first, second, third = map("xyz".index, axes)
    places = (0, 1, 2) if first == third else (first, second, third)
    return Angles(axes, places) if order.isupper() else Angles(axes[::-1], places[::-1])


class Numbers(NamedTuple):
    """Three numbers (N, 3) from which orientations were made, and the log density (N,) of orientations per
    volume of numbers."""

    values: Array
    log_volume: Array


class Given:
    """The orientations of poses as read, and the three numbers from which they may have been made."""

    def __init__(self, poses: Poses) -> None:
        self.quat_xyzw = poses.quat_xyzw
        self.time_s = 1e-9 * (poses.stamp_ns - poses.stamp_ns[0])
        self.between = Slerp(self.time_s, Rotation.from_quat(poses.quat_xyzw))
        self._numbers = dict[tuple[Angles | None, bool], Numbers]()

    def numbers(self, made_of: Angles | None, folds: bool) -> Numbers:
        """The numbers of angles ``made_of``, or of rotation vectors if None. Each orientation has two
        triples; ``folds`` selects the unusual one, which numbers that were no such angles may have been."""
        if (made_of, folds) not in self._numbers:
            self._numbers[made_of, folds] = self._angles(made_of, folds) if made_of else self._vectors(folds)
        return self._numbers[made_of, folds]

    def _angles(self, made_of: Angles, folds: bool) -> Numbers:
        matrix = linalg.matrices(self.quat_xyzw)
        i, j = ("xyz".index(axis) for axis in made_of.axes[:2])
        k = 3 - i - j
        sign = 1.0 if (j - i) % 3 == 1 else -1.0
        if made_of.is_proper:
            middle = np.arccos(np.clip(matrix[:, i, i], -1.0, 1.0))
            first = np.arctan2(matrix[:, j, i], -sign * matrix[:, k, i])
            third = np.arctan2(matrix[:, i, j], sign * matrix[:, i, k])
        else:
            middle = np.arcsin(np.clip(sign * matrix[:, i, k], -1.0, 1.0))
            first = np.arctan2(-sign * matrix[:, j, k], matrix[:, k, k])
            third = np.arctan2(-sign * matrix[:, i, j], matrix[:, i, i])
        log_volume = _log(np.sin(middle) if made_of.is_proper else np.cos(middle))
        angles = np.stack([first, middle, third], axis=1)
        if folds:
            turned = np.array([pi, 0.0 if made_of.is_proper else pi, pi]) + angles * [1.0, -1.0, 1.0]
            angles = (turned + pi) % (2.0 * pi) - pi
        values = np.empty_like(angles)
        values[:, made_of.places] = angles
        return Numbers(values, log_volume)

    def _vectors(self, folds: bool) -> Numbers:
        vector = linalg.rotation_vectors(self.quat_xyzw)
        angle = np.linalg.norm(vector, axis=1, keepdims=True) + linalg.TINY
        if folds:
            vector, angle = vector * (1.0 - 2.0 * pi / angle), 2.0 * pi - angle
        return Numbers(vector, _log_sinc(angle[:, 0]))


class Reading(NamedTuple):
    """One reading.

    Parameters
    ----------
    text : the likely mistake, and its remedy.
    axes : (3, 3) matrix by which positions are multiplied.
    turns : function that gives the orientations.
    delay_ms : delay of orientations against positions.
    turn_scale : factor of turns and of the noise of orientations.
    """

    text: str
    axes: Array | None = None
    turns: Callable[[Given], Turns] = lambda orientations: _unchanged(orientations.quat_xyzw)
    delay_ms: float = 0.0
    turn_scale: float = 1.0


def with_delay(delay_ms: float) -> Reading:
    """The reading in which orientations are later than positions by ``delay_ms``."""
    late = "later" if delay_ms > 0.0 else "earlier"
    sign = "-" if delay_ms > 0.0 else "+"
    return Reading(
        f"orientations are {abs(delay_ms):.0f} ms {late} than positions: interpolate them, with their times "
        f"{sign} {abs(delay_ms):.0f} ms, at the times of positions",
        turns=partial(_later, 1e-3 * delay_ms),
        delay_ms=delay_ms,
    )


def _later(delay_s: float, orientations: Given) -> Turns:
    """Orientations at the time ``delay_s`` after each pose; the first or last one beyond the ends."""
    time_s = orientations.time_s
    return _unchanged(orientations.between(np.clip(time_s + delay_s, 0.0, time_s[-1])).as_quat())


def _unchanged(quat_xyzw: Array) -> Turns:
    """Orientations of a reading that does not change volumes."""
    return Turns(quat_xyzw, np.zeros(len(quat_xyzw)))


def _log(volume: Array) -> Array:
    return np.asarray(np.log(np.maximum(np.abs(volume), LEAST_VOLUME)))


def _log_sinc(angle: Array) -> Array:
    """(N,) log density of orientations per volume of rotation vectors of these lengths."""
    return _log(np.square(np.sinc(0.5 * angle / pi)))


def _by_angles(angles: Angles, made_of: Angles | None, folds: bool, orientations: Given) -> Turns:
    """Rotations by the numbers of ``made_of``, taken as other ``angles``."""
    numbers = orientations.numbers(made_of, folds)
    middle = numbers.values[:, angles.places[1]]
    volume = np.sin(middle) if angles.is_proper else np.cos(middle)
    return Turns(angles.rotation(numbers.values).as_quat(), _log(volume) - numbers.log_volume)


def _by_vector(made_of: Angles, folds: bool, orientations: Given) -> Turns:
    """Rotations by the numbers as rotation vectors; of both triples the one with at most half a turn."""
    numbers, folded = orientations.numbers(made_of, folds), orientations.numbers(made_of, not folds)
    is_long = np.linalg.norm(numbers.values, axis=1) > pi
    vector = np.where(is_long[:, None], folded.values, numbers.values)
    log_volume = _log_sinc(np.linalg.norm(vector, axis=1))
    return Turns(Rotation.from_rotvec(vector).as_quat(), log_volume - numbers.log_volume)


def _in_radians(made_of: Angles, is_vector: bool, orientations: Given) -> Turns:
    """Rotations by the numbers that were taken for degrees, as radians of angles or of a rotation vector;
    impossible where they exceed one turn."""
    values = np.degrees(orientations.numbers(made_of, False).values)
    turned = Rotation.from_rotvec(values) if is_vector else made_of.rotation(values)
    is_far = np.abs(values).max(axis=1) > 2.0 * pi
    return Turns(turned.as_quat(), np.where(is_far, _IMPOSSIBLE, 0.0))


_IMPOSSIBLE: Final = -1e6
"""Log ratio of volumes where a reading is impossible."""


def _of_quaternions(order: tuple[int, ...], sign: float, orientations: Given) -> Turns:
    return _unchanged(orientations.quat_xyzw[:, order] * [sign, sign, sign, 1.0])


_W_FIRST: Final = "like w x y z in fields that are x y z w"
_W_LAST: Final = "like x y z w in fields that are w x y z"
_INVERTED: Final = "and inverted (rotation of the world in the body): reorder and conjugate them"
_QUATERNIONS: Final = (
    (f"{_W_FIRST}: reorder them", (1, 2, 3, 0), 1.0),
    (f"{_W_FIRST}, {_INVERTED}", (1, 2, 3, 0), -1.0),
    (f"{_W_LAST}: reorder them", (3, 0, 1, 2), 1.0),
    (f"{_W_LAST}, {_INVERTED}", (3, 0, 1, 2), -1.0),
)


def _by_quaternions(read_as: ReadAs) -> Iterator[Reading]:
    """Quaternions in other orders, if orientations are quaternions, and inverse orientations."""
    table, names = read_as.table, read_as.turn
    inverted = "inverted (rotation of the world in the body)"
    numbering = "rows" if table.matrix == "columns" else "columns"
    texts = {
        None: f"quaternions look {inverted}: conjugate them",
        "matrix": f"matrices look transposed: read them by {read_as.command(matrix=numbering)}",
    }
    inverse = texts.get(table.kind, f"orientations look {inverted}: invert them")
    yield Reading(inverse, turns=partial(_of_quaternions, (0, 1, 2, 3), -1.0))
    for text, order, sign in _QUATERNIONS if table.kind is None else ():
        if names and sign > 0.0:
            columns = {role: names[i] for role, i in zip(QUATERNION, order, strict=True)}
            text = f"{text.partition(':')[0]}: read them by {read_as.command(columns=columns)}"
        yield Reading(f"quaternions look {text}", turns=partial(_of_quaternions, order, sign))


def _all_angles() -> Iterator[tuple[str, Angles]]:
    """Code that makes rotations of three numbers a, b, c as angles, with these angles: in the 24 orders of
    Euler angles, and named after their axes in four further orders."""
    axes = "xyz"
    for first, second, third in permutations(axes):
        for order in (first + second + third, first + second + first):
            yield f'from_euler("{order.upper()}", [a, b, c])', Angles(order, (0, 1, 2))
            yield f'from_euler("{order}", [a, b, c])', Angles(order[::-1], (2, 1, 0))
        named = angles_in((first + second + third).upper())
        if second != "y":
            numbers = ", ".join("abc"[i] for i in named.places)
            yield f'from_euler("{named.axes.upper()}", [{numbers}])', named


def _by_three_numbers(read_as: ReadAs) -> Iterator[Reading]:
    """Other readings of the three numbers that the user named, or else of angles about fixed axes."""
    table = read_as.table
    order, _, unit = (table.euler or "xyz").partition(":")
    made_of = None if table.rotation_vector else angles_in(order)
    name = partial(_as_option, read_as, order, unit)
    taken = "taken for angles about fixed x, y, z: take"
    fault = f"orientations look like three numbers a, b, c that were {taken}"
    for folds in (False, True):
        for code, angles in _all_angles():
            # both triples of an orientation may give one orientation in the other angles as well
            middle = (angles.is_proper, angles.places[1])
            is_alike = made_of and middle == (made_of.is_proper, made_of.places[1])
            if angles != made_of and not (folds and is_alike):
                text = f"{fault} Rotation.{code} of SciPy" if table.kind in (None, "matrix") else name(angles)
                yield Reading(text, turns=partial(_by_angles, angles, made_of, folds))
        if made_of is not None and unit == "deg" and not folds:
            ways = ("", {"euler": f"{order}:rad"}), (" of a rotation vector", {"rotation_vector": True})
            for words, stated in ways:
                if not (words and read_as.has_angles):
                    text = f"angles look like radians{words}, not degrees: read them by "
                    turns = partial(_in_radians, made_of, bool(words))
                    yield Reading(text + read_as.command(**stated), turns=turns, turn_scale=180.0 / pi)
        if made_of is not None:
            text = f"{fault} Rotation.from_rotvec([a, b, c]) of SciPy"
            if table.euler is not None:
                remedy = f"read them by {read_as.command(rotation_vector=True)}"
                if read_as.has_angles:
                    remedy = "their columns are named as angles, so check how they were exported"
                text = f"orientations look like rotation vectors, not like angles: {remedy}"
            yield Reading(text, turns=partial(_by_vector, made_of, folds))


def _as_option(read_as: ReadAs, order: str, unit: str, angles: Angles) -> str:
    """The likely mistake with angles in this order, and the command for other angles."""
    fault = f"angles look like those of another order than {order}"
    if read_as.table.euler is None:
        fault, unit = "orientations look like angles, not like rotation vectors", "rad"
    is_about_body = not angles.is_proper or angles.places == (0, 1, 2)
    name = angles.axes.upper() if is_about_body else angles.axes[::-1]
    option = f"{name}:{unit}" if unit else name
    text = f"{fault}: read them by {read_as.command(euler=option)}"
    if angles.is_by_axis:
        return text
    roles = [f"r{axis}" for _, axis in sorted(zip(angles.places, angles.axes, strict=True))]
    if read_as.turn:
        columns = dict(zip(roles, read_as.turn, strict=True))
        return f"{fault}: read them by {read_as.command(euler=option, columns=columns)}"
    return f"{text}, with the columns of rx, ry and rz as {', '.join(roles)}"


def _by_axes() -> Iterator[Reading]:
    """Positions with turned axes; those of opposite sign fit alike and stand for mirrored axes as well."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.diag(signs) @ np.eye(3)[list(order)]
        if np.linalg.det(axes) > 0.0 and not (axes == np.eye(3)).all():
            axes_text, mirrored = (_named(order, sign * np.array(signs)) for sign in (1.0, -1.0))
            text = "the axes of positions are not those of orientations: take positions as"
            yield Reading(f"{text} {axes_text}, or as {mirrored} if an axis is mirrored", axes=axes)


def _named(order: tuple[int, ...], signs: Array) -> str:
    parts = (("" if sign > 0.0 else "-") + "xyz"[i] for i, sign in zip(order, signs, strict=True))
    return f"({', '.join(parts)})"


AS_THEY_ARE: Final = Reading("")


@cache
def readings_of(read_as: ReadAs = AS_GIVEN) -> tuple[Reading, ...]:
    """All readings of poses read in this way; the first leaves them as they are."""
    turned = *_by_quaternions(read_as), *_by_three_numbers(read_as)
    return AS_THEY_ARE, *turned, *_by_axes(), *map(with_delay, DELAYS_MS)
