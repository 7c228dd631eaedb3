"""Runs of segments in which an object moves in one joint: rests and changes of the contact divide them."""

from collections.abc import Sequence
from typing import NamedTuple

from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import Element, flat
from contact_tracker.map.elements import is_same_element
from contact_tracker.tracking.belief import Segment


class JointRun(NamedTuple):
    """A ``joint`` of the segments ``first`` to ``last`` (both included): that of the longest of them."""

    joint: Joint
    first: int
    last: int


def joint_runs(segments: Sequence[Segment]) -> list[JointRun]:
    """The runs of ``segments`` with the same joint; between them the object may rest in the same contact."""
    runs = list[JointRun]()
    for number, segment in enumerate(segments):
        if segment.joint is None:
            continue
        run = runs[-1] if runs else None
        if run is None or not (
            is_same_joint(run.joint, segment.joint) and _is_rest(segments[run.last : number + 1])
        ):
            runs.append(JointRun(segment.joint, number, number))
            continue
        parts = (part for part in segments[run.first : number + 1] if part.joint is not None)
        longest = max(parts, key=lambda part: part.end_ns - part.start_ns)
        runs[-1] = JointRun(longest.joint or run.joint, run.first, number)
    return runs


def is_same_joint(first: Joint, second: Joint) -> bool:
    """Whether two joints are of one kind, with axes or centres that differ by no more than their standard
    deviations allow."""
    if first.kind is not second.kind:
        return False
    sides = (first.object, second.object), (first.environment, second.environment)
    return all(_are_same(*pair) for pair in sides)


def _are_same(first: Element, second: Element) -> bool:
    if str(flat(first)) == str(flat(second)):
        return True
    are_known = first.covariance is not None and second.covariance is not None
    return are_known and is_same_element(first, second)


def _is_rest(segments: Sequence[Segment]) -> bool:
    """Whether the object rests between the first and the last of these segments: the rests of a contact have
    the elements that were fitted to it, and other motion in the same contact has its own."""
    first, *between, last = segments
    ends = [(end.contact, _elements_of(end)) for end in (first, last)]
    return all((segment.contact, _elements_of(segment)) in ends for segment in between)


def _elements_of(segment: Segment) -> tuple[str, str] | None:
    """The exact elements of the contact."""
    geometry = segment.geometry
    return None if geometry is None else (str(flat(geometry.object)), str(flat(geometry.environment)))
