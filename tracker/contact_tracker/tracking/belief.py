"""Results of the tracker: beliefs of ticks, and segments."""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

from contact_tracker.arrays import Array
from contact_tracker.contacts.contact_motion import ContactMotion
from contact_tracker.contacts.task_frame import TaskFrame
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import ContactGeometry, flat
from contact_tracker.hypotheses.observability import FittedContact
from contact_tracker.states import STATES, Contact


class Detail(IntEnum):
    """Detail of online beliefs; parts that take time can be left out."""

    WEIGHTS = 0
    """The label, its onset, and the posterior of the hypotheses."""
    SHARED = 1
    """Indistinguishable states share the label's probability."""
    GEOMETRY = 2
    """The geometry of the contact."""
    FORMATION = 3
    """The further contacts."""


@dataclass(frozen=True, eq=False)
class FurtherContact:
    """A contact that holds at the same time as the labelled one, or as a part of it.

    Parameters
    ----------
    contact, geometry : its kind and its elements.
    given_label : the probability that it is present, if the labelled contact is.
    start_ns, end_ns : the time for which it holds (both included); without an end it still does.
    inseparable : kinds that the motion does not distinguish from ``contact``, given the contacts before it.
    constraints : number of independent constraints of all contacts at the time; in a segment, the most while
        this one holds.
    p_label : the probability of the labelled contact beside it.
    """

    contact: Contact
    given_label: float
    start_ns: int
    end_ns: int | None
    geometry: ContactGeometry
    inseparable: tuple[Contact, ...]
    constraints: int
    p_label: float = 1.0

    @property
    def probability(self) -> float:
        """Probability that it is present beside the labelled contact: never above the latter's."""
        return self.given_label * self.p_label

    def to_json(self) -> dict[str, Any]:
        """An entry of ``contacts``."""
        return contact_json(
            self.contact, self.probability, (self.start_ns, self.end_ns), self.geometry, self.inseparable
        )


def with_p_label(further: tuple[FurtherContact, ...], p_label: float) -> tuple[FurtherContact, ...]:
    """The further contacts beside a label of this probability; the same object if nothing changes."""
    if all(contact.p_label == p_label for contact in further):
        return further
    return tuple(replace(contact, p_label=p_label) for contact in further)


def contact_json(
    contact: Contact,
    probability: float,
    span_ns: tuple[int, int | None],
    geometry: ContactGeometry | None,
    inseparable: tuple[Contact, ...],
) -> dict[str, Any]:
    """The JSON object of one of several contacts; it still holds if the span has no end."""
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
    """The belief of one tick.

    Parameters
    ----------
    stamp_ns : the tick's time (its last pose).
    contact : the label.
    probability : (7,) posterior of the states, in the order of ``STATES``.
    onset_ns : estimated onset of the labelled contact.
    where : the touching elements of the labelled contact, or the fit that has them; None for free.
    residual : (6,) for each contact, in the order of ``CONTACTS``, the whitened root mean square residual
        (1: at the noise) at the minimum of its objective function over the last 24 ticks with motion, or a
        little more; nan before.
    inseparable : states that the motion since the onset does not distinguish from ``contact``.
    further : contacts beside the labelled one.
    joint : the joint in which the object moves, as found offline.
    is_open : whether the motion keeps more constraints than the reported contacts have, as found online.
    """

    stamp_ns: int
    contact: Contact
    probability: Array
    onset_ns: int
    where: ContactGeometry | FittedContact | None
    residual: Array
    inseparable: tuple[Contact, ...] = ()
    further: tuple[FurtherContact, ...] = ()
    joint: Joint | None = None
    is_open: bool = False

    def __post_init__(self) -> None:
        if self.further:
            p_label = float(self.probability[self.contact.column])
            object.__setattr__(self, "further", with_p_label(self.further, p_label))

    @property
    def geometry(self) -> ContactGeometry | None:
        """The touching elements of the labelled contact, computed when they are asked for; None for free."""
        return self.where.geometry if isinstance(self.where, FittedContact) else self.where

    @property
    def constraints(self) -> int:
        """Number of independent constraints of the reported contacts together."""
        return self.further[-1].constraints if self.further else self.contact.codimension

    @property
    def contacts_json(self) -> list[dict[str, Any]]:
        """All contacts that hold, the labelled one first."""
        if self.contact is Contact.FREE:
            return []
        probability, span = self.probability[self.contact.column], (self.onset_ns, None)
        first = contact_json(self.contact, probability, span, self.geometry, self.inseparable)
        return [first, *(contact.to_json() for contact in self.further)]

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """Names of the object's and the environment's element, None if unknown."""
        return self.geometry.names if self.geometry else (None, None)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``live --json`` and ``segment -o FILE.jsonl``."""
        return {
            "stamp_ns": int(self.stamp_ns),
            "contact": self.contact.value,
            "probability": {state.value: float(p) for state, p in zip(STATES, self.probability, strict=True)},
            "onset_ns": int(self.onset_ns),
            **_label_json(self),
        }


def _label_json(result: "Belief | Segment") -> dict[str, Any]:
    """The entries, except the contact, that the JSON objects of a belief and of a segment share."""
    return {
        "inseparable": [state.value for state in result.inseparable],
        "geometry": result.geometry.to_json() if result.geometry else {},
        "contacts": result.contacts_json,
        "constraints": result.constraints,
        "joint": result.joint.to_json() if result.joint else {},
        "inseparable_names": " ".join(result.inseparable),
        "object": flat(result.geometry.object if result.geometry else None),
        "environment": flat(result.geometry.environment if result.geometry else None),
    }


@dataclass(frozen=True, eq=False)
class Segment:
    """One contact from ``start_ns`` to ``end_ns`` (both included), as found offline: a row of the result.

    A rest that leaves further states open has a row of its own (``motion.window``). ``probability`` is the
    smoothed posterior of ``contact``, averaged over the segment; ``inseparable`` are the states that the
    segment's motion and poses do not distinguish from ``contact``; ``further`` contacts hold for all of the
    segment or a part; ``joint`` is the joint in which the object moves, if any; ``motion`` is the object's at
    the touching point of ``contact``, and ``task_frame`` what that constrains in the middle of the segment.
    ``tolerance`` is the root mean square (m, rad) of the errors of a contact that is not exact; None for an
    exact one. ``posterior`` (7,) has the means of all states, in the order of ``STATES``.
    """

    start_ns: int
    end_ns: int
    contact: Contact
    probability: float
    geometry: ContactGeometry | None
    inseparable: tuple[Contact, ...] = ()
    further: tuple[FurtherContact, ...] = ()
    joint: Joint | None = None
    motion: ContactMotion | None = field(default=None, repr=False)
    task_frame: TaskFrame | None = field(default=None, repr=False)
    tolerance: tuple[float, float] | None = None
    posterior: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "further", with_p_label(self.further, self.probability))

    @property
    def constraints(self) -> int:
        """Largest number of independent constraints of the contacts that hold at a time."""
        return max((contact.constraints for contact in self.further), default=self.contact.codimension)

    @property
    def contacts_json(self) -> list[dict[str, Any]]:
        """All contacts of the segment, ``contact`` first."""
        if self.contact is Contact.FREE:
            return []
        span = self.start_ns, self.end_ns
        first = contact_json(self.contact, self.probability, span, self.geometry, self.inseparable)
        return [first, *(contact.to_json() for contact in self.further)]

    @property
    def geometries(self) -> tuple[ContactGeometry, ...]:
        """The known geometries of all its contacts."""
        return (*filter(None, [self.geometry]), *(contact.geometry for contact in self.further))

    @property
    def parts(self) -> list["Segment"]:
        """The parts of the segment between changes of its further contacts."""
        spans = [(c.start_ns, self.end_ns if c.end_ns is None else c.end_ns) for c in self.further]
        cuts = {self.start_ns, *(start_ns for start_ns, _ in spans), *(end_ns + 1 for _, end_ns in spans)}
        starts = sorted(cut for cut in cuts if self.start_ns <= cut <= self.end_ns)
        parts = []
        for start_ns, after_ns in zip(starts, [*starts[1:], self.end_ns + 1], strict=True):
            holding = tuple(
                contact
                for contact, (joins_ns, leaves_ns) in zip(self.further, spans, strict=True)
                if joins_ns <= start_ns <= leaves_ns
            )
            parts.append(replace(self, start_ns=start_ns, end_ns=after_ns - 1, further=holding))
        return parts

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """As ``Belief.touching``."""
        return self.geometry.names if self.geometry else (None, None)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``segment -o FILE.jsonl --rows segments``."""
        return {
            "start_ns": int(self.start_ns),
            "end_ns": int(self.end_ns),
            "contact": self.contact.value,
            "probability": float(self.probability),
            **_label_json(self),
            "task_frame": {} if self.task_frame is None else self.task_frame.to_json(),
            "motion": {} if self.motion is None else {"kinds": [*self.motion.kinds], **self.motion.means},
            "tolerance_m": None if self.tolerance is None else self.tolerance[0],
            "tolerance_rad": None if self.tolerance is None else self.tolerance[1],
        }
