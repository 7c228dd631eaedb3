"""Ground truth: labelled intervals, as in simulated recordings."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.errors import NoTruth
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point
from contact_tracker.states import Contact

UNSCORED = "?"
"""Label of intervals that are not scored."""
_LONGEST_LABEL = 40
"""Number of characters of a label that are read, and quoted in errors."""
_GAP_NS = 100_000_000
"""Longest step between two poses in ns; a longer time between intervals has no label."""


@dataclass(frozen=True)
class FurtherTruth:
    """A further contact at the same time, from ``start_ns`` to ``end_ns`` (both included)."""

    start_ns: int
    end_ns: int
    contact: Contact
    geometry: ContactGeometry | None = None


@dataclass(frozen=True)
class CoarseLabel:
    """A label for any of several states, such as touch."""

    name: str
    states: tuple[Contact, ...]


@dataclass(frozen=True)
class TruthInterval:
    """A label of the time from ``start_ns`` to ``end_ns`` (both included).

    Parameters
    ----------
    contact : the state; None if ``coarse`` has several, or the interval is not scored.
    motion : normal, rest, translation, one-axis or tilt; None if unknown, as with a user's labels.
    singular : whether the motion of this interval cannot distinguish its contact from others.
    geometry : of the touching elements, if known.
    further : contacts at the same time.
    """

    start_ns: int
    end_ns: int
    contact: Contact | None
    motion: str | None = "normal"
    singular: bool = False
    geometry: ContactGeometry | None = None
    further: tuple[FurtherTruth, ...] = ()
    coarse: CoarseLabel | None = None


@dataclass(frozen=True)
class Truth:
    """Intervals in order of time, without overlap."""

    intervals: tuple[TruthInterval, ...]

    def at(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Index of the last interval that has started at each stamp, -1 before the first."""
        starts = np.array([i.start_ns for i in self.intervals], np.int64)
        return np.searchsorted(starts, stamp_ns, side="right") - 1

    @property
    def coarse(self) -> tuple[CoarseLabel, ...]:
        """The different coarse labels, in order."""
        return tuple(dict.fromkeys(i.coarse for i in self.intervals if i.coarse is not None))

    def between(self, first_ns: int, last_ns: int) -> "Truth":
        """The intervals between two stamps (both included), cut to them."""
        return Truth(
            tuple(
                replace(i, start_ns=max(i.start_ns, first_ns), end_ns=min(i.end_ns, last_ns))
                for i in self.intervals
                if i.end_ns >= first_ns and i.start_ns <= last_ns
            )
        )

    def without_geometry(self) -> "Truth":
        """The intervals without geometry."""
        return Truth(tuple(replace(interval, geometry=None) for interval in self.intervals))

    def changes(self) -> list[tuple[int, Contact | None]]:
        """Stamps of changes with the contact that begins there; None for gaps of over 0.1 s."""
        changes: list[tuple[int, Contact | None]] = []
        for interval, following in zip(self.intervals, (*self.intervals, None)[1:], strict=True):
            changes.append((interval.start_ns, interval.contact))
            if following is not None and following.start_ns - interval.end_ns > _GAP_NS:
                changes.append((interval.end_ns + 1, None))
        return changes

    def to_json(self) -> str:
        """The text of ``truth.json``, a list of intervals."""
        return json.dumps([_interval_to_dict(i) for i in self.intervals], indent=1)

    @classmethod
    def from_json(cls, text: str | bytes) -> "Truth":
        """The intervals of ``truth.json``, a list or ``{"intervals": list}``; raises NoTruth."""
        try:
            data = json.loads(text)
            rows = data["intervals"] if isinstance(data, dict) else data
            intervals = tuple(_interval_from_dict(row) for row in rows)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise NoTruth(f"truth.json is not a list of labelled intervals: {error}") from error
        if any(a.start_ns > b.start_ns for a, b in pairwise(intervals)):
            raise NoTruth("truth.json: its intervals are not in the order of time")
        return cls(intervals)

    @classmethod
    def from_changes(cls, stamp_ns: Sequence[int], labels: Sequence[str], end_ns: int) -> "Truth":
        """Intervals from labels at each change; the last one lasts until ``end_ns``."""
        ends = [*(s - 1 for s in stamp_ns[1:]), end_ns]
        try:
            stamp_ns = [_stamp(stamp) for stamp in stamp_ns]
            contacts = [None if label == UNSCORED else Contact(label[:_LONGEST_LABEL]) for label in labels]
        except ValueError as error:
            raise NoTruth(f"a truth message is no contact at a time: {error}") from error
        rows = zip(stamp_ns, ends, contacts, strict=True)
        return cls(tuple(TruthInterval(start, end, contact, None) for start, end, contact in rows))


def _interval_to_dict(interval: TruthInterval) -> dict[str, Any]:
    row: dict[str, Any] = {
        "start_ns": interval.start_ns,
        "end_ns": interval.end_ns,
        "contact": interval.contact.value if interval.contact else UNSCORED,
        "motion": interval.motion,
        "singular": interval.singular,
    }
    row |= _geometry_to_dict(interval.geometry)
    if interval.further:
        row["further"] = [
            {"start_ns": further.start_ns, "end_ns": further.end_ns, "contact": further.contact.value}
            | _geometry_to_dict(further.geometry)
            for further in interval.further
        ]
    return row


def _geometry_to_dict(geometry: ContactGeometry | None) -> dict[str, Any]:
    if geometry is None:
        return {}
    return {
        "object": _element_to_dict(geometry.object),
        "environment": _element_to_dict(geometry.environment),
    }


def _geometry_from_dict(row: dict[str, Any]) -> ContactGeometry | None:
    if "object" in row and "environment" in row:
        return ContactGeometry(_element_from_dict(row["object"]), _element_from_dict(row["environment"]))
    return None


def _interval_from_dict(row: dict[str, Any]) -> TruthInterval:
    return TruthInterval(
        _stamp(row["start_ns"]),
        _stamp(row["end_ns"]),
        None if row["contact"] == UNSCORED else Contact(row["contact"]),
        None if (motion := row.get("motion", "normal")) is None else str(motion),
        bool(row.get("singular", False)),
        _geometry_from_dict(row),
        tuple(
            FurtherTruth(
                _stamp(further["start_ns"]),
                _stamp(further["end_ns"]),
                Contact(further["contact"]),
                _geometry_from_dict(further),
            )
            for further in row.get("further", ())
        ),
    )


def _element_to_dict(element: Element) -> dict[str, Any]:
    match element:
        case Plane(normal, offset_m):
            return {"type": "face", "normal": normal.tolist(), "offset_m": float(offset_m)}
        case Line(direction, point_m):
            return {"type": "edge", "direction": direction.tolist(), "point_m": point_m.tolist()}
        case Point(point_m):
            return {"type": "vertex", "point_m": point_m.tolist()}


def _element_from_dict(row: dict[str, Any]) -> Element:
    if row["type"] == "face":
        return Plane(_vector(row["normal"]), _number(row["offset_m"]))
    if row["type"] == "edge":
        return Line(_vector(row["direction"]), _vector(row["point_m"]))
    return Point(_vector(row["point_m"]))


def _stamp(value: Any) -> int:
    stamp_ns = int(value)
    if abs(stamp_ns) > RANGE_NS:
        raise ValueError("a stamp is more than 146 years from zero")
    return stamp_ns


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"an element has a number that is {number}")
    return number


def _vector(values: Any) -> NDArray[np.float64]:
    if not isinstance(values, list) or len(values) != 3:
        raise ValueError("an element has a direction or point that is not of three numbers")
    return np.array([_number(value) for value in values])
