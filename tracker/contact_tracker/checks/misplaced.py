"""Test whether known elements are where they are given: how far contacts have to move them.

A known element is a prior with its standard deviations. If it is wrong by more than these, but by less than
what refutes it, contacts are still found on it, at a compromise between the given place and the true one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import degrees, sqrt
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.checks.clearance import CHECK
from contact_tracker.checks.repeatability import Difference, difference
from contact_tracker.geometry.elements import ContactGeometry, Element
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.map import NamedElement, PriorMap
from contact_tracker.tracking.belief import Segment

SIGMAS: Final = 6.0
"""Standard deviations by which both elements of a contact are moved together. On nine of the shared physics
recordings it is at most 2.0 with exact elements, and 5.4 with such that are wrong by one."""
LEAST: Final = 0.5
"""Probability of a contact from which on it counts."""
LEAST_M: Final = 5e-5
LEAST_DEG: Final = 0.05
"""Smaller movements are not given."""


class Misplaced(NamedTuple):
    """The contact that moves known elements furthest: by ``sigmas`` together, and each, by its name."""

    sigmas: float = 0.0
    moved: tuple[tuple[str, Difference], ...] = ()


def advance(found: Misplaced, knowledge: PriorMap, segments: Iterable[Segment]) -> Misplaced:
    """Advance by the next segments."""
    sides = _by_name(knowledge.object), _by_name(knowledge.environment)
    if not any(sides):
        return found
    for segment in segments:
        first = segment.geometry, segment.probability
        for where, probability in (first, *((one.geometry, one.probability) for one in segment.further)):
            if where is None or probability < LEAST:
                continue
            moved = _moved(where, *sides)
            sigmas = sqrt(sum(by.sigmas**2 for _, by in moved))
            if sigmas > found.sigmas:
                found = Misplaced(sigmas, moved)
    return found


def findings(found: Misplaced) -> tuple[Finding, ...]:
    """The finding that known elements are elsewhere."""
    if found.sigmas <= SIGMAS:
        return ()
    places = ", ".join(f"{name} by {_size(by)}" for name, by in found.moved if _size(by))
    text = (
        f"contacts move what is given by {found.sigmas:.0f} of its standard deviations ({places}): {CHECK}, "
        "or give larger standard deviations"
    )
    return (Finding("knowledge", text, False),)


def _by_name(known: Iterable[NamedElement]) -> dict[str, Element]:
    return {one.name: one.element for one in known}


def _moved(
    where: ContactGeometry, object: Mapping[str, Element], environment: Mapping[str, Element]
) -> tuple[tuple[str, Difference], ...]:
    """By how much the known elements of a contact are moved, in standard deviations of what is given."""
    found = list[tuple[str, Difference]]()
    for element, given in ((where.object, object), (where.environment, environment)):
        known = None if element.name is None else given.get(element.name)
        if known is None or known.covariance is None:
            continue
        exact = replace(element, covariance=np.zeros_like(known.covariance))
        found.append((str(element.name), difference(exact, known)))
    return tuple(found)


def _size(by: Difference) -> str:
    """A movement in words; empty if it is small."""
    sizes = [f"{1e3 * by.distance_m:.2g} mm"] * (by.distance_m > LEAST_M)
    sizes += [f"{degrees(by.angle_rad):.2g} deg"] * (degrees(by.angle_rad) > LEAST_DEG)
    return " and ".join(sizes)
