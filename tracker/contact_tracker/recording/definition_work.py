"""How much work messages take by their definition, before any is decoded.

Decoding takes a step for each field and each nested message. A definition in a file can have a thousand
nested levels or elements of one byte, so that a small message takes as long as thousands of poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from contact_tracker.recording.definitions import PRIMITIVES, Definition, Field

_STEPS_PER_RECORD: Final = 48
"""Steps that count as the work of one record; a pose takes 13, a transform 23."""
_SIZE_OF_LENGTH: Final = 4
_STEPS: Final = 2
"""Steps of a message without its fields."""


@dataclass(frozen=True)
class DecodingWork:
    """Most steps that messages of a definition take: ``steps``, and ``steps_per_byte`` of their sequences."""

    steps: int = 0
    steps_per_byte: float = 0.0

    def records(self, size: int) -> int:
        """The work of decoding a message of ``size`` bytes, as a number of usual records beyond the first."""
        return int((self.steps + self.steps_per_byte * size) / _STEPS_PER_RECORD)


class _Extent(NamedTuple):
    """Most steps and the least size (bytes) of the messages of a type, without what is in sequences."""

    steps: int
    size: int


def work_of(definition: Definition) -> DecodingWork:
    """The work of messages by a definition."""
    extents = dict[str, _Extent]()

    def extent(name: str) -> _Extent:
        if name not in extents:
            extents[name] = _sum([_of_field(field) for field in definition.fields[name]])
        return extents[name]

    def _of_field(field: Field) -> _Extent:
        if field.length == 0:
            return _Extent(1, _SIZE_OF_LENGTH)
        count = field.length or 1
        if field.type in PRIMITIVES:
            return _Extent(1, count * PRIMITIVES[field.type])
        steps, size = extent(field.type)
        return _Extent(count * steps, count * size)

    elements = [
        extent(field.type)
        for fields in definition.fields.values()
        for field in fields
        if field.length == 0 and field.type not in PRIMITIVES
    ]
    dense = [one.steps / one.size for one in elements]
    return DecodingWork(extent(definition.type).steps, max(dense, default=0.0))


def _sum(extents: Sequence[_Extent]) -> _Extent:
    steps = _STEPS + sum(one.steps for one in extents)
    return _Extent(steps, max(sum(one.size for one in extents), 1))
