"""Whether steps of two recordings touch the same elements, and how far apart those are that they touch."""

from collections.abc import Sequence
from math import degrees, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.map.association import MapView, Sighting, log_evidence
from contact_tracker.map.elements import Key
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.sequences.steps import Step

Array = NDArray[np.float64]


class Distance(NamedTuple):
    """How far two elements are apart near the object (m), and the angle between them (rad), with standard
    deviations; NaN where it is not known."""

    shift_m: float = np.nan
    shift_sd_m: float = np.nan
    turn_rad: float = np.nan
    turn_sd_rad: float = np.nan

    @property
    def figures(self) -> tuple[tuple[float, float, str], tuple[float, float, str]]:
        """Distance and angle, each with its standard deviation and unit."""
        shift_mm, shift_sd_mm = 1e3 * self.shift_m, 1e3 * self.shift_sd_m
        return (shift_mm, shift_sd_mm, "mm"), (degrees(self.turn_rad), degrees(self.turn_sd_rad), "deg")


UNKNOWN: Final = Distance()


def place_evidence(
    first: Sequence[Step], second: Sequence[Step], ours: GrowingMap, theirs: GrowingMap
) -> Array:
    """Log evidence (n, m, 2, 2) that two steps touch the same element of the object (0) or another one (1),
    and of the surroundings, relative to both being others; NaN where the motion does not say it of both.

    It is that of the map (docs/theory.md, T46): how well the motion of the second step agrees with the
    elements as the first one has shown them, against elements of which nothing is known.
    """
    found = np.full((len(first), len(second), 2, 2), np.nan)
    for i, one in enumerate(first):
        shown = None if one.sighting is None else _as_shown(one.sighting, ours, theirs)
        if shown is None:
            continue
        view, keys = shown
        for j, other in enumerate(second):
            if other.sighting is not None and other.contact is one.contact:
                choices = [[(None, 0.0), (key, 0.0)] for key in keys]
                evidence = log_evidence(other.sighting, view, choices, theirs.reach_m)
                found[i, j] = (evidence - evidence[0, 0])[::-1, ::-1]
    return found


def distances(
    one: Step, other: Step, ours: GrowingMap, theirs: GrowingMap, near_m: tuple[Array, Array]
) -> tuple[Distance, Distance]:
    """How far the elements of two steps are apart: the object's near (3,) in the body frame, and those of the
    surroundings near (3,) in the world frame.

    Of two faces the motion shows the difference of the offsets alone: it is given for the surroundings, as if
    the object's face were the same.
    """
    if one.segment.geometry is None or other.segment.geometry is None:
        return UNKNOWN, UNKNOWN
    before, after = one.segment.geometry, other.segment.geometry
    found = (
        _distance(before.object, after.object, near_m[0]),
        _distance(before.environment, after.environment, near_m[1]),
    )
    if not any(before.has_open_offset) or one.sighting is None or other.sighting is None:
        return found
    shown = _as_shown(one.sighting, ours, theirs)
    if shown is None:
        return found
    view, keys = shown
    residual, derivative = other.sighting.linearised((view.elements[keys[0]], view.elements[keys[1]]))
    rows = np.concatenate([np.arange(view.slots[key].start, view.slots[key].stop) for key in keys])
    spread = derivative @ view.covariance[np.ix_(rows, rows)] @ derivative.T
    spread += np.linalg.pinv(other.sighting.information, hermitian=True)
    height = {"shift_m": abs(float(residual[-1])), "shift_sd_m": sqrt(max(float(spread[-1, -1]), 0.0))}
    return found[0]._replace(shift_m=np.nan, shift_sd_m=np.nan), found[1]._replace(**height)


def _as_shown(
    sighting: Sighting, ours: GrowingMap, theirs: GrowingMap
) -> tuple[MapView, tuple[Key, Key]] | None:
    """A map of the elements of one contact alone, with the origins of another recording, and their keys."""
    learned = GrowingMap(ours.reach_m, origins=ours.origins).insert(sighting).learned
    start = GrowingMap(theirs.reach_m).with_prior(learned)
    view = (start if theirs.origins is None else start.at_origins(theirs.origins)).whole
    keys = sorted(view.elements)
    return (view, (keys[0], keys[1])) if [side for side, _ in keys] == [0, 1] else None


def _distance(first: Element, second: Element, near_m: Array) -> Distance:
    """The distance of two elements of one kind, of faces along the normal at ``near_m`` (3,)."""
    first, second = by_foot(first, near_m), by_foot(second, near_m)
    if first.covariance is None or second.covariance is None:
        return UNKNOWN
    x, y, covariance = numbers(first), numbers(second), first.covariance + second.covariance
    match first, second:
        case Point(), Point():
            return Distance(*_length(y - x, covariance))
        case Line(), Line():
            turn = y[:3] if x[:3] @ y[:3] >= 0.0 else -y[:3]
            shift = _length(y[3:] - x[3:], covariance[3:, 3:])
            return Distance(*shift, *_length(turn - x[:3], covariance[:3, :3]))
        case Plane(), Plane():
            off = (y if x[:3] @ y[:3] >= 0.0 else -y) - x
            row = np.append(near_m, -1.0)
            sd = sqrt(max(float(row @ covariance @ row), 0.0))
            return Distance(abs(float(row @ off)), sd, *_length(off[:3], covariance[:3, :3]))
    return UNKNOWN


def _length(vector: Array, covariance: Array) -> tuple[float, float]:
    """The length of a vector, and its standard deviation along it."""
    size = float(np.linalg.norm(vector))
    unit = vector / max(size, np.finfo(float).tiny)
    return size, sqrt(max(float(unit @ covariance @ unit), 0.0))
