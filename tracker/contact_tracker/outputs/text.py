"""Text of beliefs and segments: lines of fixed width, geometry in words, reported changes, and colours.

The colours of the states are the same for terminal, figures, viewer and reports. Any two of them differ by at
least 33 in CIE L*a*b* (1976), for normal sight as for protanopes and deuteranopes (simulated as by Machado,
Oliveira and Fernandes, 2009); tests/outputs/test_colours.py. Terminals show the nearest of 216 colours, which
differ less (5.6 for protanopes), but have the label as a word beside them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from math import degrees
from typing import Final

import numpy as np

from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import (
    Array,
    ContactGeometry,
    Element,
    Line,
    Plane,
    Point,
    is_unobserved,
)
from contact_tracker.outputs.joint_runs import joint_runs
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment

Colour = tuple[int, int, int]

COLOUR: Final[dict[Contact, Colour]] = {
    Contact.FF: (79, 222, 255),
    Contact.EF: (53, 238, 196),
    Contact.FE: (178, 203, 111),
    Contact.VF: (254, 203, 51),
    Contact.FV: (156, 83, 62),
    Contact.EE: (201, 94, 255),
    Contact.FREE: (117, 124, 143),
}
ANSI_LEVELS: Final = (0, 95, 135, 175, 215, 255)
"""Levels of red, green and blue in the 216 colours of terminals."""
COLOURS: Final = [COLOUR[state] for state in STATES]


def ansi_of(contact: Contact) -> str:
    """The code of a contact's colour in terminals with 256 colours."""
    red, green, blue = (min(range(6), key=lambda i: abs(ANSI_LEVELS[i] - part)) for part in COLOUR[contact])
    return f"38;5;{16 + 36 * red + 6 * green + blue}"


GEOMETRY_TITLE: Final = "the object's element (body frame) on the surroundings' (world frame)"
CHANGES_HEADER: Final = f"  time s  contact     p   since s  {GEOMETRY_TITLE}"
SURE_PROBABILITY: Final = 0.9
SAME_NS: Final = 1_000_000_000
"""Time (ns) for which a change is no news: of a further contact's estimated onset or presence, and of a
belief that does not settle. With a tenth of it ``live`` has 15 instead of 10 lines for
``paper_experiment``."""
SHORTEST_NS: Final = 50_000_000
"""Least time (ns) between two reports: half a usual tick."""
JOINS: Final = "+ "
LEAVES: Final = "- "
JOINT: Final = "= "
OPEN_OFFSET: Final = "offset not known"
"""Note on a face whose position along its normal is unknown."""
_ORIGIN: Final = "the body's origin"
_NONE: Final[Mapping[Contact, float]] = {}
TABLE_HEADER: Final = f" start s     end s  contact     p  {GEOMETRY_TITLE}"


def is_settled(belief: Belief) -> bool:
    """Whether the contact is nearly certain and distinguishable from all other states."""
    return bool(belief.probability[belief.contact.column] >= SURE_PROBABILITY) and not belief.inseparable


def change_lines(
    belief: Belief,
    is_news: bool,
    joins: Iterable[FurtherContact],
    leaves: Iterable[FurtherContact],
    origin_ns: int,
) -> Iterator[str]:
    """Lines on the changes of a belief (``Changes``): a new or settled contact, and further contacts that end
    and begin; times in seconds after ``origin_ns``."""

    def line(kind: str, p: str, since_ns: int, elements: str = "") -> str:
        at_s, since_s = _seconds(belief.stamp_ns, origin_ns), _seconds(since_ns, origin_ns)
        return f"{at_s:8.2f}  {kind:<7} {p:5}  {since_s:8.2f}  {elements}".rstrip()

    if is_news:
        p, elements = belief.probability[belief.contact.column], describe(belief.geometry, belief.inseparable)
        yield line(belief.contact.value, f"{p:5.2f}", belief.onset_ns, elements)
    for further in leaves:
        yield line(LEAVES + further.contact.value, "", further.start_ns)
    for further in joins:
        elements = describe(further.geometry, further.inseparable)
        yield line(JOINS + further.contact.value, f"{further.probability:5.2f}", further.start_ns, elements)


def status_text(belief: Belief, origin_ns: int) -> str:
    """The current belief, short enough for a line of a terminal."""
    ranked = np.argsort(-belief.probability)[:3]
    likely = "  ".join(f"{STATES[i].value} {belief.probability[i]:.2f}" for i in ranked)
    at_s, duration_s = _seconds(belief.stamp_ns, origin_ns), _seconds(belief.stamp_ns, belief.onset_ns)
    return f"{at_s:8.2f} s  {belief.contact.value} for {duration_s:.1f} s   {likely}"


def counted(count: int, noun: str) -> str:
    """A number with its noun, as ``1 pose`` and ``2 poses``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


Row = tuple[str, str, str, str, str]
"""Start, end, kind, probability and elements in words."""


def table_rows(segments: Sequence[Segment], origin_ns: int) -> Iterator[tuple[range, Row]]:
    """The rows of a table, with the numbers of their segments: a contact, its further contacts (``+``) and
    the joint that begins with it (``=``), until the last segment with the same joint ends; times in seconds
    after ``origin_ns``.

    Successive segments whose rows would differ in nothing but times have one row.
    """

    def row(start_ns: int, end_ns: int, kind: str, p: float, elements: str) -> Row:
        start_s, end_s = _seconds(start_ns, origin_ns), _seconds(end_ns, origin_ns)
        return f"{start_s:.2f}", f"{end_s:.2f}", kind, f"{p:.2f}", elements

    runs = {run.first: run for run in joint_runs(segments)}
    own = [row(s.start_ns, s.end_ns, s.contact.value, s.probability, describe_segment(s)) for s in segments]
    for _, alike in groupby(range(len(segments)), lambda i: i if segments[i].further else own[i][2:]):
        first, *others = alike
        numbers, segment = range(first, first + 1 + len(others)), segments[first]
        yield numbers, (own[first][0], *own[numbers[-1]][1:])
        for further in segment.further:
            end_ns = segment.end_ns if further.end_ns is None else further.end_ns
            kind, elements = JOINS + further.contact.value, describe(further.geometry, further.inseparable)
            yield numbers, row(further.start_ns, end_ns, kind, further.probability, elements)
        for run in filter(None, map(runs.get, numbers)):
            start_ns, end_ns = segments[run.first].start_ns, segments[run.last].end_ns
            elements = describe_joint(run.joint, is_open(segments[run.first]))
            of_joint = row(start_ns, end_ns, JOINT + run.joint.kind.value, run.joint.probability, elements)
            yield range(run.first, run.last + 1), of_joint


def table(segments: Sequence[Segment], origin_ns: int, with_wrenches: bool = False) -> Iterator[str]:
    """The rows as lines, and the total time in which several contacts fit.

    Times are in seconds after ``origin_ns``. ``with_wrenches``: wrenches were evidence besides the motion.
    """
    yield TABLE_HEADER
    for _, (start_s, end_s, kind, p, elements) in table_rows(segments, origin_ns):
        yield f"{start_s:>8}  {end_s:>8}  {kind:<7} {p:>5}  {elements}".rstrip()
    total_s = ambiguous_s = 0.0
    for segment in segments:
        duration_s = _seconds(segment.end_ns, segment.start_ns)
        total_s += duration_s
        ambiguous_s += duration_s if segment.inseparable else 0.0
    if ambiguous_s:
        leave = "Motion and wrenches leave" if with_wrenches else "The motion leaves"
        yield f"{leave} the contact open for {ambiguous_s:.2f} of {total_s:.2f} s."


def describe(
    geometry: ContactGeometry | None,
    inseparable: Sequence[Contact] = (),
    probabilities: Mapping[Contact, float] = _NONE,
) -> str:
    """``edge ... on face ...; or v-f, free``: the elements, after +/- the standard deviation in the worst
    direction, and the ``alternatives`` after ``or``."""
    states, pair = alternatives(inseparable, probabilities), ""
    if geometry is not None:
        of_object, of_environment = geometry.has_open_offset
        body = _element(geometry.object, has_open_offset=of_object)
        pair = f"{body} on {_element(geometry.environment, has_open_offset=of_environment)}"
    return "; ".join(filter(None, [pair, states and f"or {states}"]))


def describe_segment(segment: Segment) -> str:
    """``describe`` for a segment; a contact that is not exact begins with ``within 2.4 mm and 0.3 deg:``."""
    text = describe(segment.geometry, segment.inseparable, likely_others(segment))
    if segment.tolerance is None:
        return text
    within_m, within_rad = segment.tolerance
    return f"within {1e3 * within_m:.2g} mm and {degrees(within_rad):.2g} deg: {text}"


def describe_joint(joint: Joint, contact_is_open: bool) -> str:
    """``axis ... on axis ...; pitch ...``: the axes of the object and the surroundings.

    If ``contact_is_open``, the text adds that the joint does not depend on the contact.
    """
    name = "centre" if joint.kind is JointKind.BALL else "axis"
    body = _element(joint.object, name, joint.kind is JointKind.SLIDER)
    pair = f"{body} on {_element(joint.environment, name)}"
    anyway = "; for any contact" if contact_is_open else ""
    if joint.kind is not JointKind.SCREW or joint.pitch_m_per_rad is None:
        return f"{pair}{anyway}"
    turn_mm, sd = 2e3 * np.pi * joint.pitch_m_per_rad, joint.pitch_sd_m_per_rad
    noise = "" if sd is None else _deviation(2e3 * np.pi * sd, "mm")
    return f"{pair}; pitch {_fixed(turn_mm, 2)} mm{noise} a turn{anyway}"


def joint_name(joint: Joint) -> str:
    """``= hinge 0.96``, as in a table of segments."""
    return f"{JOINT}{joint.kind.value} {joint.probability:.2f}"


def alternatives(inseparable: Sequence[Contact], probabilities: Mapping[Contact, float] = _NONE) -> str:
    """``free 0.51, v-f``: the states with ``probabilities``, then the others that the motion does not
    distinguish from the label; ``any other`` for all."""
    likely = [f"{state.value} {p:.2f}" for state, p in probabilities.items()]
    others = [state.value for state in inseparable if state not in probabilities]
    return ", ".join([*likely, *(["any other"] if len(inseparable) == len(CONTACTS) else others)])


def likely_others(segment: Segment) -> dict[Contact, float]:
    """The states that are more probable than the label in the mean over the segment, which the most probable
    sequence may have nevertheless; if the label is not sure and no other fits the motion, the most probable
    states that are sure together with it."""
    if segment.posterior is None:
        return {}
    others = {state: float(segment.posterior[state.column]) for state in STATES if state != segment.contact}
    ranked = sorted(others.items(), key=lambda item: -item[1])
    if segment.inseparable:
        return {state: p for state, p in ranked if p > segment.probability}
    named, together = dict[Contact, float](), segment.probability
    for state, p in ranked:
        if together >= SURE_PROBABILITY:
            break
        named[state], together = p, together + p
    return named


def is_open(entry: Segment | Belief) -> bool:
    """Whether the motion leaves the contact open among all states."""
    return len(entry.inseparable) == len(CONTACTS)


def _element(element: Element, called: str | None = None, has_open_offset: bool = False) -> str:
    """An element in words, with ``called`` instead of face, edge or vertex. An open offset means that the
    offset of a face is unknown, and that a line is one of many parallel ones."""
    turns_or_shifts = [
        f"{'turn about' if way.how == 'turns_about' else 'shift along'} {_vector(way.direction, 2)}"
        for way in element.unobserved
    ]
    match element:
        case Plane(normal, offset_m, covariance):
            tilt = f"{_vector(normal, 2)}{_worst(covariance, slice(0, 3), 'deg')}"
            offset = f" at {_fixed(offset_m, 3)} m{_worst(covariance, slice(3, 4), 'mm')}"
            name, place = "face", f" normal {tilt}{'' if has_open_offset else offset}"
        case Line(direction, point_m, covariance):
            along = f"{_vector(direction, 2)}{_worst(covariance, slice(0, 3), 'deg')}"
            through = f"{_vector(point_m, 3)} m{_worst(covariance, slice(3, 6), 'mm')}"
            name, place = "edge", f" along {along} through {_ORIGIN if has_open_offset else through}"
        case Point(point_m, covariance):
            name = "vertex"
            place = f" {_vector(point_m, 3)} m{_worst(covariance, slice(0, 3), 'mm')}"
    name = called or name
    if element.name is not None:
        name = element.name if name in element.name.split() else f"{name} {element.name}"
    if is_unobserved(element):
        return f"{name} (unobserved)"
    notes = [OPEN_OFFSET] if has_open_offset and isinstance(element, Plane) else []
    if turns_or_shifts:
        notes.append(f"unobserved: {', '.join(turns_or_shifts)}")
    return f"{name}{place}" + (f" ({'; '.join(notes)})" if notes else "")


def _worst(covariance: Array | None, block: slice, unit: str) -> str:
    """The standard deviation (deg or mm) of a ``covariance`` (rad and m) in its worst direction."""
    if covariance is None or not np.isfinite(covariance).all():
        return ""
    sd = np.sqrt(max(np.linalg.eigvalsh(covariance[block, block])[-1], 0.0))
    return _deviation(np.degrees(sd) if unit == "deg" else sd * 1e3, unit)


LEAST_DEVIATION: Final = 0.001
"""Least standard deviation (mm or deg) that is a figure: the noise of exact poses, as of a simulation or of
encoders, leaves less, but no sensor measures as well."""


def _deviation(sd: float, unit: str) -> str:
    if sd < LEAST_DEVIATION:
        return f" +/- below {LEAST_DEVIATION:g} {unit}"
    figures = np.format_float_positional(sd, precision=2, unique=False, fractional=False, trim="-")
    return f" +/- {figures} {unit}"


def _vector(values: Array, digits: int) -> str:
    return f"({' '.join(_fixed(v, digits) for v in values)})"


def _fixed(value: float, digits: int) -> str:
    """Fixed decimals, without the sign of a negative zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _seconds(stamp_ns: int, origin_ns: int) -> float:
    return (stamp_ns - origin_ns) * 1e-9


class Changes:
    """The last report: the ``label``, whether it was ``settled``, ``decided`` (no other state fits the
    motion) or ``open`` among all states, and its stamp; since when beliefs ``differ_since_ns`` from it, if
    they do; the ``further`` contacts."""

    def __init__(self) -> None:
        self.label: Contact | None = None
        self.settled = self.decided = self.open = False
        self.stamp_ns: int | None = None
        self.differ_since_ns: int | None = None
        self.further: tuple[FurtherContact, ...] = ()

    def update(self, belief: Belief) -> tuple[bool, list[FurtherContact], list[FurtherContact]]:
        """Whether the next belief is reported, the further contacts that begin with it, and those that end.

        Reported at once: another label than that of the last report, unless both are open among all states,
        and a label that settles. Reported after ``SAME_NS``: that beliefs differ from the last report in the
        label, in whether other states fit the motion, or in the contact, which has the same label but has
        begun since. So no report stands for longer than that while beliefs differ from it, and shorter doubts
        are no news. Two reports are ``SHORTEST_NS`` apart or more, as the last tick of a stream may be short.
        A further contact ends with free motion, or when no contact of its kind has followed for ``SAME_NS``.
        """
        opened, decided, settles = is_open(belief), not belief.inseparable, is_settled(belief)
        is_other = belief.contact is not self.label
        is_later = (
            belief.contact is not Contact.FREE
            and self.stamp_ns is not None
            and belief.onset_ns > self.stamp_ns
        )
        if not is_other and not is_later and decided is self.decided:
            self.differ_since_ns = None
        elif self.differ_since_ns is None:
            self.differ_since_ns = belief.stamp_ns
        stays = self.differ_since_ns is not None and belief.stamp_ns - self.differ_since_ns >= SAME_NS
        changed = is_other and not (self.open and opened)
        is_soon = self.stamp_ns is not None and belief.stamp_ns - self.stamp_ns < SHORTEST_NS
        is_news = (changed or stays or (settles and not self.settled)) and not is_soon
        if is_news:
            self.label, self.settled, self.decided, self.open = belief.contact, settles, decided, opened
            self.stamp_ns, self.differ_since_ns = belief.stamp_ns, None
        joins = _without(belief.further, self.further)
        missing, leaves = list[FurtherContact](), list[FurtherContact]()
        for further in _without(self.further, belief.further):
            end_ns = further.end_ns or belief.stamp_ns
            again = next((i for i, joined in enumerate(joins) if joined.contact is further.contact), None)
            if again is not None:
                del joins[again]
            elif belief.contact is Contact.FREE or belief.stamp_ns >= end_ns + SAME_NS:
                leaves.append(further)
            else:
                missing.append(replace(further, end_ns=end_ns))
        self.further = (*belief.further, *missing)
        return is_news, joins, leaves


def _without(contacts: Iterable[FurtherContact], excluded: Iterable[FurtherContact]) -> list[FurtherContact]:
    """The contacts without a partner in ``excluded``; each of these is the partner of one contact at most."""
    unmatched, remaining = [*excluded], list[FurtherContact]()
    for contact in contacts:
        for i, candidate in enumerate(unmatched):
            if contact.contact is candidate.contact and abs(contact.start_ns - candidate.start_ns) < SAME_NS:
                del unmatched[i]
                break
        else:
            remaining.append(contact)
    return remaining
