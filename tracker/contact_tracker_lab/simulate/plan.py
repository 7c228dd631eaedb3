"""The plan of a recording: the features that touch in each leg, and the anchors between legs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from contact_tracker.geometry.polyhedron import Polyhedron
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.anchors import Anchor, choose_chart, sample_anchor
from contact_tracker_lab.simulate.chart import Chart
from contact_tracker_lab.simulate.scenarios import Phase

_TRAVEL_M_S = 0.25
_TURN_RAD_S = 1.0


@dataclass(frozen=True, eq=False)
class Leg:
    """The motion between two anchors; a free leg leaves ``chart`` and arrives at ``next_chart``.

    ``lift_m`` is the height of a free leg, ``wander`` its share of the usual random motion; ``from_air`` and
    ``to_air`` say that it begins or ends at that height instead of in contact.
    """

    contact: Contact
    motion: str
    duration_s: float
    start: Anchor
    end: Anchor
    chart: Chart
    next_chart: Chart
    lift_m: float = 0.0
    wander: float = 1.0
    from_air: bool = False
    to_air: bool = False


def plan(
    rng: np.random.Generator, phases: Sequence[Phase], object: Polyhedron, scene: Polyhedron, lead_s: float
) -> list[Leg]:
    """The legs of ``phases``; each begins at the anchor at which the previous one ended. ``lead_s`` is as of
    ``Scenario``."""
    with_transitions = _with_transitions(phases, lead_s)
    chart = choose_chart(rng, _touching(phases[0]), object, scene)
    anchor = sample_anchor(rng, None, None, chart)
    legs: list[Leg] = []
    for index, phase in enumerate(with_transitions):
        after = with_transitions[index + 1] if index + 1 < len(with_transitions) else None
        following, end = _leg_end(rng, phase, after, chart, anchor, object, scene)
        is_same = after and phase and after.contact is phase.contact
        if is_same or _is_restricted(phase) or _is_restricted(after):
            end = replace(end, object_rate=0 * end.object_rate, scene_rate=0 * end.scene_rate, spin_rate=0.0)
        legs.append(_leg(phase, anchor, end, chart, following, object.radius))
        chart, anchor = following, end
    return [
        replace(leg, from_air=index == 0, to_air=index == len(legs) - 1) for index, leg in enumerate(legs)
    ]


def _is_restricted(phase: Phase | None) -> bool:
    """Whether a phase is at rest, or has another motion than the normal one: it starts and ends at rest."""
    return phase is not None and phase.motion != "normal"


def _with_transitions(phases: Sequence[Phase], lead_s: float) -> list[Phase | None]:
    """The phases and the transitions between them; None is a lift from one contact to the next."""
    result: list[Phase | None] = []
    for before, phase, after in zip((None, *phases), phases, (*phases[1:], None), strict=False):
        lead = [Phase(phase.contact, lead_s)] if lead_s else []
        if before and not _comparable(before.contact, phase.contact):
            result.append(None)
        is_singular = _is_restricted(phase) and phase.motion != "rest"
        if is_singular and before and before.contact is not phase.contact:
            result += lead
        result.append(phase)
        if _is_restricted(phase) and after and after.contact is not phase.contact:
            result += lead
    return result


def _comparable(a: Contact, b: Contact) -> bool:
    return a.contains(b) or b.contains(a)


def _touching(phase: Phase | None) -> Contact:
    """The contact of a phase; vertex on face for free motion at an end of the recording."""
    return phase.contact if phase and phase.contact is not Contact.FREE else Contact.VF


def _leg_end(
    rng: np.random.Generator,
    phase: Phase | None,
    after: Phase | None,
    chart: Chart,
    anchor: Anchor,
    object: Polyhedron,
    scene: Polyhedron,
) -> tuple[Chart, Anchor]:
    """The anchor at which a leg that begins at ``anchor`` ends, and the chart of the next."""

    def option() -> tuple[Chart, Anchor]:
        if phase is None or phase.contact is Contact.FREE:
            arriving = choose_chart(rng, _touching(after), object, scene)
            return arriving, sample_anchor(rng, anchor, None, arriving)
        if after is None or after.contact in (Contact.FREE, phase.contact):
            return chart, sample_anchor(rng, anchor, chart, chart)
        arriving = choose_chart(rng, after.contact, object, scene, related=chart)
        return arriving, sample_anchor(rng, anchor, chart, arriving)

    if _is_restricted(phase):
        return chart, anchor
    options = [option() for _ in range(60 if phase is None else 6)]
    return min(options, key=lambda chosen: _effort(*anchor.distance_to(chosen[1])))


def _effort(distance_m: float, angle_rad: float) -> float:
    return distance_m / 0.2 + angle_rad


def _leg(
    phase: Phase | None, start: Anchor, end: Anchor, chart: Chart, following: Chart, radius: float
) -> Leg:
    distance, angle = start.distance_to(end)
    shortest_s = max(distance / _TRAVEL_M_S, angle / _TURN_RAD_S)
    if phase and phase.contact is not Contact.FREE:
        seconds = max(phase.duration_s, shortest_s)
        return Leg(phase.contact, phase.motion, seconds, start, end, chart, chart)
    lift = 0.03 + 0.4 * (distance + angle * radius)
    if phase:
        seconds = max(phase.duration_s, shortest_s)
        return Leg(Contact.FREE, "normal", seconds, start, end, chart, following, lift + 0.15)
    seconds = max(0.6, 6.5 * lift, shortest_s)
    return Leg(Contact.FREE, "normal", seconds, start, end, chart, following, lift, wander=0.0)
