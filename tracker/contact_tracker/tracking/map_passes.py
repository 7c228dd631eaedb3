"""Passes over a recording with the map that the pass before has made, until it stands (docs/theory.md, T46).

A contact may touch elements that others have touched, at little cost, or new ones, at a price.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import replace
from typing import Final

import numpy as np

from contact_tracker.map.association import log_prior_of_new
from contact_tracker.map.map import Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.offline_smoother import PassRecord, Segmenter, pieces
from contact_tracker.tracking.segmentation import Beliefs, Segmentation

MOST_PASSES: Final = 2
"""Most passes after the first."""
DECISIVE_NATS: Final = 35.0
"""Evidence by which a pass with a map has to win. Both evidences are approximations: on the 15 recordings of
everyday handling passes win by 38 to 143, and are more often right in 12 of them; on six of short and soft
contacts they win by up to 32, and one of two that win by 30 or more is less often right."""


def with_map(
    first_pass: Iterator[Segmentation], record: PassRecord, executor: Executor | None = None
) -> Iterator[Segmentation]:
    """The pieces of a recording's first pass, or, if its map explains the recording better, the whole as a
    pass with that map segments it. Of a very long recording the first pass as it goes.

    Parameters
    ----------
    record : that to which the first pass is noted.
    """
    waiting = list[Segmentation]()
    for piece in first_pass:
        waiting.append(piece)
        if record.is_full:
            yield from waiting
            yield from first_pass
            return
    better = _better_pass(record, executor)
    if better is None:
        yield from waiting
        return
    first = Segmentation.join(waiting)
    yield replace(better, filtered=first.filtered, outliers=first.outliers)


def _better_pass(first: PassRecord, executor: Executor | None) -> Segmentation | None:
    """The last pass with a map that explains the recording better than the pass before; None without one.

    In the first pass only sure contacts had a price, a small one. So that evidences compare, each of its
    contacts pays that of new elements, and a map the complexity of what its contacts share.
    """
    best: Segmentation | None = None
    best_evidence = first.log_evidence + log_prior_of_new(len(first.contacts)) + DECISIVE_NATS
    before = first
    for _ in range(MOST_PASSES):
        if first.state is None:
            break
        start = first.state.map
        world = GrowingMap.learn(before.sightings, start.reach_m, len(first.contacts), start.prior)
        after = PassRecord()
        found = _pass(first, world, after, executor)
        if not world.complexity:
            found = _with_open_free(found, first.state.known_map.allowed)
        evidence = after.log_evidence - world.complexity
        if evidence <= best_evidence:
            break
        is_settled = best is not None and _labels(best) == _labels(found)
        best, best_evidence, before = found, evidence, after
        first.best = after
        if is_settled:
            break
    return best


def _pass(
    first: PassRecord, world: GrowingMap, record: PassRecord, executor: Executor | None
) -> Segmentation:
    """A pass over the ticks of the first one with a map."""
    assert first.state is not None
    possible = Map(states=first.state.known_map.states)
    start = ContactFilter.start(first.state.model, known_map=possible)
    world = replace(world, origins=first.state.origins)
    start.state = start.state._replace(map=world, uses_later_contacts=True)
    return Segmentation.join(list(pieces(first.ticks, start, Segmenter(executor, record=record))))


def _with_open_free(found: Segmentation, contacts: tuple[Contact, ...]) -> Segmentation:
    """The segmentation of a pass with a map in which nothing was touched twice: by the price of new elements
    alone short contacts are taken for free motion, so that this does not exclude any of the ``contacts`` that
    can occur."""
    known, rows = found.beliefs, found.beliefs.rows.copy()
    for row in np.flatnonzero(rows["contact"] == Contact.FREE.column):
        shared = ambiguity.with_rivals(rows["probability"][row], Contact.FREE, contacts)
        rows["probability"][row] = shared
        rows["inseparable"][row] = [state in contacts for state in STATES]
    beliefs = Beliefs(rows, known.geometries, known.formations, known.joints)
    segments = list[Segment]()
    for one in found.segments:
        if one.contact is Contact.FREE:
            within = (rows["stamp_ns"] >= one.start_ns) & (rows["stamp_ns"] <= one.end_ns)
            p = rows["probability"][within, Contact.FREE.column]
            one = replace(
                one, probability=float(p.mean()) if len(p) else one.probability, inseparable=contacts
            )
        segments.append(one)
    return replace(found, segments=tuple(segments), beliefs=beliefs)


def _labels(found: Segmentation) -> list[tuple[str, int]]:
    return [(one.contact.value, one.start_ns) for one in found.segments]
