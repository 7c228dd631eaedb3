"""What the tracker believes: of a tick, and of a segment."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.flat import flat
from contact_tracker.joints.geometry import Joint
from contact_tracker.states import STATES, Contact

Array = NDArray[np.float64]


class Detail(IntEnum):
    """How much is told of each tick right after it: what takes time is left out where nobody asks."""

    WEIGHTS = 0
    """The label, its onset, and the posterior as the hypotheses weigh."""
    SHARED = 1
    """What the motion does not tell from the label shares its probability."""
    GEOMETRY = 2
    """Where it touches."""
    FORMATION = 3
    """What else touches."""


@dataclass(frozen=True, eq=False)
class FurtherContact:
    """A contact that holds at the same time as the labelled one, or as a part of it.

    Parameters
    ----------
    contact, probability, geometry : its kind, that it is there at all, and its elements.
    start_ns, end_ns : from when to when it holds (both included); without an end it still does.
    inseparable : kinds that the motion does not tell from ``contact``, given the contacts before this one.
    constraints : that all contacts put on the motion together that hold at the time; of a segment's, the most
        while this one holds.
    """

    contact: Contact
    probability: float
    start_ns: int
    end_ns: int | None
    geometry: ContactGeometry
    inseparable: tuple[Contact, ...]
    constraints: int

    def to_json(self) -> dict[str, Any]:
        """An entry of ``contacts``."""
        return contact_json(
            self.contact, self.probability, (self.start_ns, self.end_ns), self.geometry, self.inseparable
        )


def contact_json(
    contact: Contact,
    probability: float,
    span_ns: tuple[int, int | None],
    geometry: ContactGeometry | None,
    inseparable: tuple[Contact, ...],
) -> dict[str, Any]:
    """One of several contacts; it still holds where the span has no end."""
    return {
        "contact": contact.value,
        "probability": float(probability),
        "onset_ns": int(span_ns[0]),
        "end_ns": None if span_ns[1] is None else int(span_ns[1]),
        "inseparable": [state.value for state in inseparable],
        "geometry": geometry.to_json() if geometry else {},
    }


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of one tick.

    Parameters
    ----------
    stamp_ns : the tick's time (its last pose).
    contact : the label.
    probability : (7,) posterior of the states, in the order of ``STATES``.
    onset_ns : when the labelled contact began, as believed.
    geometry : the touching elements of the labelled contact; None for free.
    residual : (6,) for each contact, in the order of ``CONTACTS``, the whitened root mean square residual
        (1: at the noise) that its objective function leaves at its minimum over the last 25 ticks with
        motion, or a little more; nan before there was so much motion.
    inseparable : states that the motion since the onset does not tell from ``contact``.
    p_restricted : probability that the object is moved in fewer directions than it could be, on purpose.
    further : contacts beside the labelled one.
    joint : in which the object moves, as found offline.
    is_open : whether the motion keeps more constraints than those of the contacts that are named, as noticed
        online.
    """

    stamp_ns: int
    contact: Contact
    probability: Array
    onset_ns: int
    geometry: ContactGeometry | None
    residual: Array
    inseparable: tuple[Contact, ...] = ()
    p_restricted: float = 0.0
    further: tuple[FurtherContact, ...] = ()
    joint: Joint | None = None
    is_open: bool = False

    @property
    def constraints(self) -> int:
        """That the contacts named put on the motion together."""
        return self.further[-1].constraints if self.further else self.contact.codimension

    @property
    def contacts_json(self) -> list[dict[str, Any]]:
        """All contacts that hold, the labelled one first."""
        if self.contact is Contact.FREE:
            return []
        probability, span = self.probability[self.contact.column], (self.onset_ns, None)
        first = contact_json(self.contact, probability, span, self.geometry, self.inseparable)
        return [first, *(one.to_json() for one in self.further)]

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """Names of the object's and the environment's element, None for one that nobody knows."""
        return self.geometry.names if self.geometry else (None, None)

    def to_json(self) -> dict[str, Any]:
        """The object that ``live --json`` and ``segment -o FILE.jsonl`` write."""
        return {
            "stamp_ns": int(self.stamp_ns),
            "contact": self.contact.value,
            "probability": {state.value: float(p) for state, p in zip(STATES, self.probability, strict=True)},
            "onset_ns": int(self.onset_ns),
            "inseparable": [state.value for state in self.inseparable],
            "geometry": self.geometry.to_json() if self.geometry else {},
            "contacts": self.contacts_json,
            "constraints": self.constraints,
            "joint": self.joint.to_json() if self.joint else {},
            "inseparable_names": " ".join(self.inseparable),
            "object": flat(self.geometry.object if self.geometry else None),
            "environment": flat(self.geometry.environment if self.geometry else None),
        }


class SegmentPart(NamedTuple):
    """A part of a segment, from ``start_ns`` to ``end_ns`` (both included), in which the same contacts hold:
    beside that of the segment the ``further`` ones. ``geometries`` are those of all, as far as known."""

    start_ns: int
    end_ns: int
    further: tuple[FurtherContact, ...]
    geometries: tuple[ContactGeometry, ...]


@dataclass(frozen=True, eq=False)
class Segment:
    """One contact from ``start_ns`` to ``end_ns`` (both included), as found offline.

    ``probability`` is the smoothed posterior of ``contact``, averaged over the segment; ``inseparable`` are
    the states that the segment's motion does not tell from ``contact``; ``further`` contacts hold beside it
    for all of the segment or a part; the motion is that of a ``joint``.
    """

    start_ns: int
    end_ns: int
    contact: Contact
    probability: float
    geometry: ContactGeometry | None
    inseparable: tuple[Contact, ...] = ()
    further: tuple[FurtherContact, ...] = ()
    joint: Joint | None = None

    @property
    def contacts_json(self) -> list[dict[str, Any]]:
        """All contacts of the segment, ``contact`` first."""
        if self.contact is Contact.FREE:
            return []
        span = self.start_ns, self.end_ns
        first = contact_json(self.contact, self.probability, span, self.geometry, self.inseparable)
        return [first, *(one.to_json() for one in self.further)]

    @property
    def parts(self) -> list["SegmentPart"]:
        """The segment cut where further contacts join and leave."""
        spans = [(one.start_ns, self.end_ns if one.end_ns is None else one.end_ns) for one in self.further]
        cuts = {self.start_ns, *(start_ns for start_ns, _ in spans), *(end_ns + 1 for _, end_ns in spans)}
        starts = sorted(cut for cut in cuts if self.start_ns <= cut <= self.end_ns)
        parts = []
        for start_ns, after_ns in zip(starts, [*starts[1:], self.end_ns + 1], strict=True):
            holding = tuple(
                one
                for one, (joins_ns, leaves_ns) in zip(self.further, spans, strict=True)
                if joins_ns <= start_ns <= leaves_ns
            )
            geometries = (*filter(None, [self.geometry]), *(one.geometry for one in holding))
            parts.append(SegmentPart(start_ns, after_ns - 1, holding, geometries))
        return parts

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """As ``Belief.touching``."""
        return self.geometry.names if self.geometry else (None, None)
