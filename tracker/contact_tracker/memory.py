"""Elements met before: the desk is recognised at the second touch (docs/theory.md, T28).

What was found with confidence, of the surroundings in the world's frame and of the object in the body's, is
offered to the hypotheses that begin later, with the accuracy at which it is known. Who recognises an element
has fewer unknowns to pay for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from contact_tracker.assumptions import Assumption
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry import Array, ContactGeometry, Element, Line, Plane, Point
from contact_tracker.knowledge import Known

SURE: Final = 0.9
"""An element is kept that belongs to a contact of so much probability."""
LEARN_TICKS: Final = 5
"""An element is looked at again after so many ticks."""
KEPT: Final = 2
"""So many elements of each kind and side are remembered, the latest."""
LENGTH_M: Final = 0.2
"""How far the ends of an edge are from its point nearest to the body."""
LOOSE_M: Final = 0.3e-3
LOOSE_RAD: Final = 2e-3
"""Real elements are not quite the same at the second touch."""


@dataclass(frozen=True, eq=False)
class Memory:
    """Elements with the onset (ns) of the contact in which they were met, the latest last."""

    object: tuple[tuple[int, Known], ...] = ()
    environment: tuple[tuple[int, Known], ...] = ()

    def learn(self, geometry: ContactGeometry, onset_ns: int, position_m: Array) -> "Memory":
        """Remember the elements of a contact; what it has taught before is replaced.

        ``position_m`` (3,) of the body's origin in the world tells on which side of a face it is.
        """
        ours = _loosened(_outward(geometry.object, np.zeros(3), inside=True))
        theirs = _loosened(_outward(geometry.environment, position_m, inside=False))
        return Memory(_kept(self.object, onset_ns, ours), _kept(self.environment, onset_ns, theirs))

    def knows(self, onset_ns: int) -> bool:
        """Whether the contact that began then has taught something."""
        return any(onset == onset_ns for onset, _ in (*self.object, *self.environment))

    def assumptions(self, model: ContactModel) -> tuple[Assumption, ...]:
        """Pairs of elements met before, or of one and an unknown one; all weigh the same."""
        ours, theirs = model.contact.value[0], model.contact.value[2]
        return tuple(
            Assumption(o, e, 0.0)
            for o, e in product(_of(self.object, ours), _of(self.environment, theirs))
            if o is not None or e is not None
        )


def _kept(met: Sequence[tuple[int, Known]], onset_ns: int, element: Element) -> tuple[tuple[int, Known], ...]:
    if element.name is not None:  # the user knows it anyway
        return tuple(met)
    known = Known("met before", element)
    others = [(onset, old) for onset, old in met if onset != onset_ns]
    alike = [pair for pair in others if pair[1].kind == known.kind]
    forgotten = alike[: max(len(alike) - KEPT + 1, 0)]
    return (*(pair for pair in others if pair not in forgotten), (onset_ns, known))


def _of(met: Sequence[tuple[int, Known]], kind: str) -> list[Known | None]:
    """Elements of a kind that were met; and of the element met last a vertex that may be anywhere on that
    edge, or an edge that goes through that vertex."""
    same: list[Known | None] = [None, *(known for _, known in met if known.kind == kind)]
    edges = [known for _, known in met if known.kind == "e" and kind == "v"]
    same = [*same, *(Known(known.name, _on(known.element)) for known in edges[-1:])]
    points = [known for _, known in met[-1:] if known.kind == "v" and kind == "e"]
    return [*same, *(Known(known.name, _through(known.element)) for known in points)]


def _through(vertex: Element) -> Line:
    """An edge that goes through a vertex; its direction is unknown, and zero."""
    assert isinstance(vertex, Point)
    assert vertex.covariance is not None
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = vertex.covariance
    return Line(np.zeros(3), vertex.point_m, covariance)


def _on(edge: Element) -> Point:
    """A point of an edge."""
    assert isinstance(edge, Line)
    assert edge.covariance is not None
    turned, shifted = edge.covariance[:3, :3], edge.covariance[3:, 3:]
    along = np.outer(edge.direction, edge.direction)
    return Point(edge.point_m, shifted + LENGTH_M**2 * (along + turned))


def _outward(element: Element, position_m: Array, inside: bool) -> Element:
    """A plane with its normal out of the body that it bounds; the object's origin is taken to be in it."""
    if not isinstance(element, Plane):
        return element
    height = float(element.normal @ position_m) - element.offset_m
    if (height > 0) != inside:
        return element
    flip = np.diag([-1.0, -1.0, -1.0, -1.0])
    moved = None if element.covariance is None else flip @ element.covariance @ flip
    return replace(element, normal=-element.normal, offset_m=-element.offset_m, covariance=moved)


def _loosened(element: Element) -> Element:
    turn, shift = LOOSE_RAD**2, LOOSE_M**2
    assert element.covariance is not None
    match element:
        case Point():
            more = shift * np.eye(3)
        case Plane(normal):
            more = np.zeros((4, 4))
            more[:3, :3], more[3, 3] = turn * (np.eye(3) - np.outer(normal, normal)), shift
        case Line(direction):
            across = np.eye(3) - np.outer(direction, direction)
            more = np.zeros((6, 6))
            more[:3, :3], more[3:, 3:] = turn * across, shift * across
    return replace(element, covariance=element.covariance + more)
