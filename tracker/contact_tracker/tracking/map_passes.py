"""Passes over a recording with the map that the pass before has made, until it stands (docs/theory.md, T46).

A contact may touch elements that others have touched, at little cost, or new ones, at a price.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.map.association import log_prior_of_new
from contact_tracker.map.map import Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.offline_smoother import PassRecord, Segmenter, pieces
from contact_tracker.tracking.segment_fit import without_short_gaps
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.tracking.transition_model import FREE

MOST_PASSES: Final = 2
"""Most passes after the first."""
DECISIVE_NATS: Final = 35.0
"""Evidence by which a pass with a map has to win. Both evidences are approximations: on the 15 recordings of
everyday handling passes win by 38 to 143, and are more often right in 12 of them; on six of short and soft
contacts they win by up to 32, and one of two that win by 30 or more is less often right."""


def with_map(
    first_pass: Iterator[Segmentation], record: PassRecord, executor: Executor | None = None
) -> Iterator[Segmentation]:
    """The whole recording as its first pass segments it, or a pass with its map, if that explains it better;
    free motion is open where a touch is not excluded. Of a very long recording the first pass as it goes.

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
    if record.state is None:
        yield from waiting
        return
    first = Segmentation.join(waiting)
    found = _better_pass(record, executor) or first
    found = _with_touches(found, first, record.pace, record.state.model.certainty.posterior_power)
    yield replace(found, filtered=first.filtered, outliers=first.outliers)


def _better_pass(first: PassRecord, executor: Executor | None) -> Segmentation | None:
    """The last pass with a map that explains the recording better than the pass before; None without one.

    In the first pass only sure contacts had a price, a small one. So that evidences compare, each of its
    contacts pays that of new elements, and a map the complexity of what its contacts share.
    """
    assert first.state is not None
    best: Segmentation | None = None
    allowed = first.state.known_map.allowed
    best_evidence = first.log_evidence + log_prior_of_new(len(first.contacts)) + DECISIVE_NATS
    before = first
    for _ in range(MOST_PASSES):
        start = first.state.map
        world = GrowingMap.learn(before.sightings, start.reach_m, len(first.contacts), start.prior)
        after = PassRecord()
        found = _pass(first, world, after, executor)
        if not world.complexity:
            found = _with_open_free(found, np.ones(len(found.beliefs), bool), lambda _: allowed)
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


def _with_touches(found: Segmentation, first: Segmentation, pace: float, power: float) -> Segmentation:
    """The segmentation with free motion open to the most probable contact where the ``first`` pass, without a
    map, is not sure of it at the ``pace`` of the recording.

    By the price of new elements alone a map takes short contacts for free motion. A touch within free motion
    is two changes, so that its odds follow the square of the pace; the posterior has the ``power``.
    """
    probability = first.beliefs.probability
    odds = pace ** (2.0 * power) * probability[:, :FREE]
    is_open = odds.sum(axis=1) >= ambiguity.NOT_EXCLUDED * probability[:, FREE]
    return _with_open_free(found, is_open, lambda rows: (STATES[int(odds[rows].sum(axis=0).argmax())],))


def _with_open_free(
    found: Segmentation,
    is_open: NDArray[np.bool_],
    rivals: Callable[[NDArray[np.int64]], tuple[Contact, ...]],
) -> Segmentation:
    """The segmentation with free motion open to ``rivals`` in the ticks that ``is_open`` (T,), short gaps of
    these included. A segment is open if most of its ticks are."""
    known, rows = found.beliefs, found.beliefs.rows.copy()
    segments = list[Segment]()
    for segment in found.segments:
        first, end = rows["stamp_ns"].searchsorted([segment.start_ns, segment.end_ns + 1])
        within = without_short_gaps(is_open[first:end])
        if segment.contact is Contact.FREE and within.any():
            open_rows = first + np.flatnonzero(within)
            others = tuple(s for s in STATES if s in {*segment.inseparable, *rivals(open_rows)})
            for row in open_rows.tolist():
                shared = ambiguity.with_rivals(rows["probability"][row], Contact.FREE, others)
                rows["probability"][row] = shared
            rows["inseparable"][open_rows] = [state in others for state in STATES]
            p = float(rows["probability"][first:end, FREE].mean())
            if 2 * len(open_rows) > end - first:
                segment = replace(segment, inseparable=others)
            segment = replace(segment, probability=p)
        segments.append(segment)
    beliefs = Beliefs(rows, known.geometries, known.formations, known.joints)
    return replace(found, segments=tuple(segments), beliefs=beliefs)


def _labels(found: Segmentation) -> list[tuple[str, int]]:
    return [(one.contact.value, one.start_ns) for one in found.segments]
