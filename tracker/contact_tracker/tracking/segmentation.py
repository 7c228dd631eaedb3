"""The result for a whole recording: its segments, and the beliefs of all its ticks."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, Final, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import ContactGeometry, pack, unpack
from contact_tracker.motion.poses import NO_OUTLIERS, Outliers
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment

BELIEF: Final = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("onset_ns", np.int64),
        ("probability", np.float64, len(STATES)),
        ("residual", np.float64, len(CONTACTS)),
        ("geometry", np.int64),
        ("further", np.int64),
        ("joint", np.int64),
        ("inseparable", np.bool_, len(STATES)),
        ("contact", np.int8),
    ],
    align=True,
)
"""A belief as a row: ``contact`` and ``inseparable`` by column, the number of its ``geometry`` or -1, and of
its ``further`` contacts and its ``joint`` or -1."""


@dataclass(eq=False, repr=False)
class Beliefs(Sequence[Belief]):
    """T beliefs in columns, so that hours of them fit into memory; items are made as ``Belief`` on access.

    Parameters
    ----------
    rows : (T,) of dtype ``BELIEF``.
    geometries : referred to by rows by number, packed (see ``packing``).
    formations : further contacts, referred to by number.
    joints : referred to by number.
    """

    rows: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, BELIEF))
    geometries: Sequence[Array] = ()
    formations: Sequence[tuple[FurtherContact, ...]] = ()
    joints: Sequence[Joint] = ()
    _read: tuple[int, ContactGeometry | None] = field(default=(-1, None), init=False)

    @classmethod
    def of(cls, beliefs: Iterable[Belief]) -> Self:
        """Columns from single beliefs; equal geometries are shared."""
        rows: list[tuple[Any, ...]] = []
        geometries: dict[int, tuple[int, ContactGeometry]] = {}
        formations: dict[int, tuple[int, tuple[FurtherContact, ...]]] = {}
        joints: dict[int, tuple[int, Joint]] = {}
        for b in beliefs:
            number = formation = joint = -1
            if b.geometry is not None:
                number, _ = geometries.setdefault(id(b.geometry), (len(geometries), b.geometry))
            if b.further:
                formation, _ = formations.setdefault(id(b.further), (len(formations), b.further))
            if b.joint is not None:
                joint, _ = joints.setdefault(id(b.joint), (len(joints), b.joint))
            is_inseparable = [state in b.inseparable for state in STATES]
            cells = (b.stamp_ns, b.onset_ns, b.probability, b.residual, number, formation, joint)
            rows.append((*cells, is_inseparable, b.contact.column))
        return cls(
            np.array(rows, BELIEF),
            [pack(geometry) for _, geometry in geometries.values()],
            [further for _, further in formations.values()],
            [joint for _, joint in joints.values()],
        )

    @classmethod
    def join(cls, parts: Sequence["Beliefs"]) -> Self:
        """Several columns of beliefs concatenated."""
        rows = np.concatenate([np.zeros(0, BELIEF), *(part.rows for part in parts)])
        lengths = [len(part) for part in parts]
        for name, counts in (
            ("geometry", [len(part.geometries) for part in parts]),
            ("further", [len(part.formations) for part in parts]),
            ("joint", [len(part.joints) for part in parts]),
        ):
            offsets = np.cumsum([0, *counts])[:-1]
            refers = rows[name] >= 0
            rows[name][refers] += np.repeat(offsets, lengths)[refers]
        return cls(
            rows,
            [packed for part in parts for packed in part.geometries],
            [further for part in parts for further in part.formations],
            [joint for part in parts for joint in part.joints],
        )

    def with_probability(self, probability: Array, may_be: NDArray[np.bool_] | None = None) -> "Beliefs":
        """The same with other posteriors (T, 7), and, with ``may_be`` (7,), open among these states."""
        rows = self.rows.copy()
        rows["probability"] = probability
        if may_be is not None:
            rows["inseparable"] = may_be & (np.arange(len(STATES)) != rows["contact"][:, None])
        return Beliefs(rows, self.geometries, self.formations, self.joints)

    def with_elements(self, change: Callable[[ContactGeometry], ContactGeometry]) -> "Beliefs":
        """The same with changed elements of the label and of further contacts."""
        return Beliefs(
            self.rows,
            [pack(change(unpack(packed))) for packed in self.geometries],
            [tuple(with_elements(contact, change) for contact in further) for further in self.formations],
            self.joints,
        )

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> Belief: ...
    @overload
    def __getitem__(self, index: slice) -> "Beliefs": ...
    def __getitem__(self, index: int | slice) -> "Belief | Beliefs":
        if isinstance(index, slice):
            return Beliefs(self.rows[index], self.geometries, self.formations, self.joints)
        row = self.rows[index]
        return Belief(
            int(row["stamp_ns"]),
            STATES[row["contact"]],
            row["probability"].copy(),
            int(row["onset_ns"]),
            self._geometry(int(row["geometry"])),
            row["residual"].copy(),
            tuple(state for state, open in zip(STATES, row["inseparable"], strict=True) if open),
            () if row["further"] < 0 else self.formations[row["further"]],
            None if row["joint"] < 0 else self.joints[row["joint"]],
        )

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return np.asarray(self.rows["stamp_ns"])

    @property
    def probability(self) -> Array:
        """(T, 7)"""
        return np.asarray(self.rows["probability"])

    @property
    def residual(self) -> Array:
        """(T, 6)"""
        return np.asarray(self.rows["residual"])

    @property
    def contacts(self) -> list[Contact]:
        return [STATES[column] for column in self.rows["contact"]]

    def _geometry(self, number: int) -> ContactGeometry | None:
        """The geometry of a row; consecutive rows often share it."""
        if number < 0:
            return None
        if self._read[0] != number:
            self._read = (number, unpack(self.geometries[number]))
        return self._read[1]


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The offline result for T ticks.

    Parameters
    ----------
    segments : the Viterbi path, in order, covering every tick; split where the object rests.
    beliefs : T beliefs with the Viterbi label and the smoothed posterior.
    filtered : T online beliefs, from data up to each tick only.
    outliers : poses that were left out.
    """

    segments: tuple[Segment, ...] = ()
    beliefs: Beliefs = field(default_factory=Beliefs)
    filtered: Beliefs = field(default_factory=Beliefs)
    outliers: Outliers = NO_OUTLIERS

    @classmethod
    def join(cls, parts: Sequence["Segmentation"]) -> Self:
        """Consecutive parts of one recording joined."""
        return cls(
            tuple(segment for part in parts for segment in part.segments),
            Beliefs.join([part.beliefs for part in parts]),
            Beliefs.join([part.filtered for part in parts]),
            reduce(Outliers.joined, (part.outliers for part in parts), NO_OUTLIERS),
        )

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self.beliefs.stamp_ns

    def with_elements(self, change: Callable[[ContactGeometry], ContactGeometry]) -> "Segmentation":
        """The same with changed elements in segments and smoothed beliefs."""

        def changed(segment: Segment) -> Segment:
            further = tuple(with_elements(contact, change) for contact in segment.further)
            return replace(with_elements(segment, change), further=further)

        segments = tuple(map(changed, self.segments))
        return replace(self, segments=segments, beliefs=self.beliefs.with_elements(change))


Part = TypeVar("Part", Segment, FurtherContact)


def with_elements(part: Part, change: Callable[[ContactGeometry], ContactGeometry]) -> Part:
    """The segment or further contact with changed elements."""
    return part if part.geometry is None else replace(part, geometry=change(part.geometry))
