"""The steps of a recording: its segments with the probabilities of all contacts, deviations of boundaries and
touching elements; whether steps of two recordings touch the same elements, and the distances of these."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import asin, cos, degrees, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.map.association import MapView, Sighting, log_evidence
from contact_tracker.map.elements import Key
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.text import SURE_PROBABILITY
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Segment

LEAST_PROBABILITY: Final = 1e-6
"""Least probability of a contact in a step or belief: none is excluded. 1e-4 gives the same results."""


@dataclass(frozen=True, eq=False)
class Step:
    """A segment of a recording as a step of its task.

    Parameters
    ----------
    segment : the segment.
    probability : (7,) of the contacts in the order of ``STATES``, the mean of the smoothed beliefs.
    log_probability : (7,) that of a single contact in all its ticks, which count as one: the mean of the
        logarithms, in which a tick that excludes a contact weighs more than a doubtful boundary.
    p_any : probability that its contact holds in any of its ticks, as if these were independent.
    start_s, end_s : times since the recording's first pose.
    boundary_sd_s : standard deviations of start and end, from the beliefs of the ticks around them.
    sighting : the estimate of the touching elements from the motion; None if the contact is not sure enough.
    """

    segment: Segment
    probability: Array
    log_probability: Array
    p_any: float
    start_s: float
    end_s: float
    boundary_sd_s: tuple[float, float]
    sighting: Sighting | None

    @property
    def contact(self) -> Contact:
        return self.segment.contact

    @property
    def is_open(self) -> bool:
        """Whether the motion leaves the contact open."""
        return bool(self.segment.inseparable)


def steps_of(outcome: Outcome) -> list[Step]:
    """The steps of a recording in order of time; they cover all of it."""
    segments, beliefs, origin_ns = outcome.segments, outcome.beliefs, outcome.origin_ns
    stamps_ns, probability = beliefs.stamp_ns, beliefs.probability
    steps, bounds = [], _boundary_sd_s(segments, stamps_ns, probability)
    for number, segment in enumerate(segments):
        rows = slice(*np.searchsorted(stamps_ns, [segment.start_ns, segment.end_ns + 1]).tolist())
        ticks, p_any = np.eye(len(STATES))[segment.contact.column][None], 1.0
        if rows.start < rows.stop:
            ticks = probability[rows]
            p_any = 1.0 - float(np.prod(1.0 - probability[rows, segment.contact.column]))
            p_free = probability[rows, Contact.FREE.column]
            if segment.contact is Contact.FREE and p_free.max() > SURE_PROBABILITY:
                segment = replace(segment, inseparable=())  # the object was free, whatever it touched beside
        mean = np.maximum(ticks.mean(axis=0), LEAST_PROBABILITY)
        log_p = np.log(np.maximum(ticks, LEAST_PROBABILITY)).mean(axis=0)
        log_p -= np.logaddexp.reduce(log_p)
        span_s = [(stamp_ns - origin_ns) * 1e-9 for stamp_ns in (segment.start_ns, segment.end_ns)]
        sds = bounds[number], bounds[number + 1]
        sighting = sighting_of(segment, outcome.learned_world)
        p_any = max(p_any, LEAST_PROBABILITY)
        steps.append(Step(segment, mean / mean.sum(), log_p, p_any, span_s[0], span_s[1], sds, sighting))
    return steps


def sighting_of(segment: Segment, touched: GrowingMap | None) -> Sighting | None:
    """The map's sighting of a segment: that of its contact with the longest common time, if there is one."""
    common = [
        (min(sighting.stamp_ns, segment.end_ns) - max(sighting.onset_ns, segment.start_ns), number)
        for number, sighting in enumerate(() if touched is None else touched.sightings)
        if sighting.estimate.contact is segment.contact
    ]
    longest, number = max(common, default=(0, 0))
    return None if touched is None or longest <= 0 else touched.sightings[number]


def _boundary_sd_s(
    segments: Sequence[Segment], stamps_ns: NDArray[np.int64], probability: Array
) -> list[float]:
    """Standard deviations (S + 1,) of the boundaries of S segments.

    The probability p of the first label at a tick is that of a boundary later than the tick: for a normal
    distribution, the sum of p (1 - p) times the tick is sd / sqrt(pi). The ends of the recording have 0.
    """
    tick_s = float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else 0.0
    sds_s = [0.0]
    for first, second in pairwise(segments):
        middles = [(segment.start_ns + segment.end_ns) // 2 for segment in (first, second)]
        p = probability[slice(*np.searchsorted(stamps_ns, middles).tolist()), first.contact.column]
        spread_s = 0.0 if first.contact is second.contact else float((p * (1.0 - p)).sum()) * tick_s
        sds_s.append(sqrt(np.pi * spread_s**2 + tick_s**2 / 12.0))
    return [*sds_s, 0.0]


class Distance(NamedTuple):
    """The distance of two elements near the object (m) and the angle between them (rad), with standard
    deviations; NaN if unknown."""

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
    first: Sequence[Step], second: Sequence[Step], first_map: GrowingMap, second_map: GrowingMap
) -> Array:
    """Log evidence (n, m, 2, 2) that two steps touch with the same element of the object (0) or another one
    (1), and likewise of the surroundings, relative to both being other ones; NaN without sightings of both.

    It is the evidence of the map (docs/theory.md, T46): the likelihood of the motion of the second step given
    the elements as estimated from the first, against elements with a vague prior.
    """
    evidence = np.full((len(first), len(second), 2, 2), np.nan)
    for i, first_step in enumerate(first):
        prior = None if first_step.sighting is None else _map_of(first_step.sighting, first_map, second_map)
        if prior is None:
            continue
        view, keys = prior
        for j, second_step in enumerate(second):
            if second_step.sighting is not None and second_step.contact is first_step.contact:
                choices = [[(None, 0.0), (key, 0.0)] for key in keys]
                log_p = log_evidence(second_step.sighting, view, choices, second_map.reach_m)
                evidence[i, j] = (log_p - log_p[0, 0])[::-1, ::-1]
    return evidence


def distances(
    first: Step, second: Step, first_map: GrowingMap, second_map: GrowingMap, near_m: tuple[Array, Array]
) -> tuple[Distance, Distance]:
    """Distances of the elements of two steps, for the object near ``near_m[0]`` (3,) in the body frame, for
    the surroundings near ``near_m[1]`` (3,) in the world frame.

    For two faces the motion shows only the difference of the offsets; it counts as distance in the
    surroundings, as if the object's face were the same.
    """
    if first.segment.geometry is None or second.segment.geometry is None:
        return UNKNOWN, UNKNOWN
    first_pair, second_pair = first.segment.geometry, second.segment.geometry
    gaps = (
        _distance(first_pair.object, second_pair.object, near_m[0]),
        _distance(first_pair.environment, second_pair.environment, near_m[1]),
    )
    if not any(first_pair.has_open_offset) or first.sighting is None or second.sighting is None:
        return gaps
    prior = _map_of(first.sighting, first_map, second_map)
    if prior is None:
        return gaps
    view, keys = prior
    residual, derivative = second.sighting.linearised((view.elements[keys[0]], view.elements[keys[1]]))
    rows = np.concatenate([np.arange(view.slots[key].start, view.slots[key].stop) for key in keys])
    spread = derivative @ view.covariance[np.ix_(rows, rows)] @ derivative.T
    spread += np.linalg.pinv(second.sighting.information, hermitian=True)
    height = {"shift_m": abs(float(residual[-1])), "shift_sd_m": sqrt(max(float(spread[-1, -1]), 0.0))}
    return gaps[0]._replace(shift_m=np.nan, shift_sd_m=np.nan), gaps[1]._replace(**height)


def _map_of(
    sighting: Sighting, first_map: GrowingMap, second_map: GrowingMap
) -> tuple[MapView, tuple[Key, Key]] | None:
    """A map that has only the elements of a sighting, with the origins of the second map, and their keys."""
    learned = GrowingMap(first_map.reach_m, origins=first_map.origins).insert(sighting).learned
    start = GrowingMap(second_map.reach_m).with_prior(learned)
    view = (start if second_map.origins is None else start.at_origins(second_map.origins)).whole
    keys = sorted(view.elements)
    return (view, (keys[0], keys[1])) if [side for side, _ in keys] == [0, 1] else None


def _distance(first: Element, second: Element, near_m: Array) -> Distance:
    """The distance of two elements of the same kind; of faces along the normal at ``near_m`` (3,)."""
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
            return Distance(*shift, *_angle(turn - x[:3], covariance[:3, :3]))
        case Plane(), Plane():
            off = (y if x[:3] @ y[:3] >= 0.0 else -y) - x
            row = np.append(near_m, -1.0)
            sd = sqrt(max(float(row @ covariance @ row), 0.0))
            return Distance(abs(float(row @ off)), sd, *_angle(off[:3], covariance[:3, :3]))
    return UNKNOWN


def _length(vector: Array, covariance: Array) -> tuple[float, float]:
    """The length of a vector, and its standard deviation along it."""
    size = float(np.linalg.norm(vector))
    unit = vector / max(size, np.finfo(float).tiny)
    return size, sqrt(max(float(unit @ covariance @ unit), 0.0))


def _angle(difference: Array, covariance: Array) -> tuple[float, float]:
    """The angle between two directions by the difference of their unit vectors, and its standard
    deviation."""
    chord, sd = _length(difference, covariance)
    half_rad = asin(min(0.5 * chord, 1.0))
    return 2.0 * half_rad, sd / cos(half_rad)
