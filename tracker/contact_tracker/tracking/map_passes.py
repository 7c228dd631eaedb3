"""Passes over a recording with the map of the pass before, while these explain more (docs/theory.md, T46).

A contact may touch elements of other contacts, at little cost, or new ones, at a price.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array
from contact_tracker.geometry.elements import Plane
from contact_tracker.geometry.lifted_pose import R
from contact_tracker.map.association import log_prior_of_new
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import STATES, Contact, united
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.located_faces import with_offsets
from contact_tracker.tracking.offline_smoother import PassRecord, Segmenter, pieces
from contact_tracker.tracking.rest_sightings import sightings_at_rest
from contact_tracker.tracking.segment_fit import without_short_gaps
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.tracking.transition_model import FREE

MOST_PASSES: Final = 2
"""Most passes after the first. With one, one of eight recordings of everyday handling is right for 0.94 of
the time instead of 0.99, and the others are the same (measured once)."""
DECISIVE_NATS: Final = 35.0
"""Evidence by which a pass with a map has to win. Both evidences are approximations: on the 15 recordings of
everyday handling passes win by 38 to 143, and are more often right in 12 of them; on six of short and soft
contacts they win by up to 32, and one of two that win by 30 or more is less often right."""


MOST_TILT: Final = 10.0
"""Largest tilt of an object that a machine turns about one axis, as a multiple of the largest tilt while its
faces touch. Half and double separate the same recordings, by 3 and 60 times (docs/theory.md, section 22)."""


def with_map(
    first_pass: Iterator[Segmentation], record: PassRecord, executor: Executor | None = None
) -> Iterator[Segmentation]:
    """The segmentation by the first pass, or by a pass with its map, if that explains the recording better;
    free motion is open where a touch is not excluded. With elements that are fixed, and if the recording
    is very long (then piece by piece), the first pass.

    Parameters
    ----------
    record : the record of the first pass.
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
    world, known_map, result = record.state.map, record.state.known_map, first
    allowed = known_map.allowed
    if not known_map.fixes_elements:
        result = _better_pass(record, executor) or first
        result = _with_touches(result, first, record.pace, record.state.model.certainty.posterior_power)
    if not known_map.shows_touch and {side for side, _ in world.prior.elements} != {0, 1}:
        result = _with_free_if_never_tilted(result, record.ticks)
    is_other = known_map.learned and any(world.prior_is_dropped)
    if world.untested_sides or is_other:  # the price of its new elements hid contacts in free motion
        result = _with_open(result, Contact.FREE, np.ones(len(result.beliefs), bool), lambda _: allowed)
    result = with_offsets(result, record.map, known_map)
    yield replace(result, filtered=first.filtered, outliers=first.outliers)


def _better_pass(first: PassRecord, executor: Executor | None) -> Segmentation | None:
    """The last pass with a map that explains the recording better than the pass before; None without one.

    In the first pass only certain contacts had a price, a small one. To make the evidence comparable, each of
    its contacts pays the price of new elements, and a map the complexity of its shared elements.
    """
    assert first.state is not None
    best: Segmentation | None = None
    allowed = first.state.known_map.allowed
    start, previous = first.state.map, first
    if not first.sightings:
        first.at_rest = sightings_at_rest(first.ticks, first.state.model, start.reach_m)
    lead = 0.0 if first.at_rest else DECISIVE_NATS  # what rests show together is sure already
    best_evidence = first.log_evidence + log_prior_of_new(first.contacts) + lead
    for _ in range(MOST_PASSES):
        share = first.state.model.geometry.revisit_prior
        seen = previous.all_sightings
        world = GrowingMap.learn(seen, start.reach_m, first.contacts, start.prior, share)
        latest = PassRecord()
        latest.at_rest = first.at_rest
        result = _pass(first, world, latest, executor)
        if not world.is_shared:
            result = _with_open(result, Contact.FREE, np.ones(len(result.beliefs), bool), lambda _: allowed)
        evidence = latest.log_evidence + _evidence_at_rest(latest, result) - world.complexity
        if evidence <= best_evidence:
            break
        best, best_evidence, previous = result, evidence, latest
        first.best = latest
    return best


def _evidence_at_rest(record: PassRecord, result: Segmentation) -> float:
    """How much likelier the poses of rests are on faces of the map than anywhere, where the label is f-f: at
    rest, no tick counts."""
    is_on_faces = result.beliefs.rows["contact"] == Contact.FF.column
    return sum(
        rest.evidence
        for rest in record.at_rest
        if is_on_faces[rest.sighting.first : rest.sighting.end].mean() > 0.5
    )


def _pass(
    first: PassRecord, world: GrowingMap, record: PassRecord, executor: Executor | None
) -> Segmentation:
    """A pass over the ticks of the first one with a map."""
    assert first.state is not None
    start = ContactFilter.start(first.state.model, known_map=first.state.known_map)
    world = replace(world, origins=first.state.origins)
    start.state = start.state._replace(map=world, uses_later_contacts=True)
    return Segmentation.join(list(pieces(first.ticks, start, Segmenter(executor, record=record))))


def _with_touches(segmentation: Segmentation, first: Segmentation, pace: float, power: float) -> Segmentation:
    """The segmentation with free motion open to the most probable contact where the ``first`` pass, without a
    map, is not sure of it at the ``pace`` of the recording.

    Because of the price of new elements, a pass with a map takes short contacts for free motion. A touch
    within free motion is two changes, so its odds grow with the square of the pace; the posterior has the
    ``power``.
    """
    probability = first.beliefs.probability
    odds = pace ** (2.0 * power) * probability[:, :FREE]
    is_open = odds.sum(axis=1) >= ambiguity.NOT_EXCLUDED * probability[:, FREE]
    return _with_open(
        segmentation, Contact.FREE, is_open, lambda rows: (STATES[odds[rows].sum(axis=0).argmax()],)
    )


def _with_free_if_never_tilted(segmentation: Segmentation, ticks: Sequence[Tick]) -> Segmentation:
    """The segmentation with f-f open to free motion if the object never tilts from its faces in the whole
    recording.

    An arm, or a gantry, that turns an object about one axis moves it in the air as faces would. A hand does
    not; and faces that touch only to a tolerance are those of a floor, as machines are more exact.
    """
    segments, rows = segmentation.segments, segmentation.beliefs.rows
    observed = [(segment, normals) for segment in segments if (normals := _normals(segment)) is not None]
    if not observed:
        never_tilts = all(segment.contact is Contact.FF for segment in segments)
    else:
        longest, normals = max(observed, key=lambda part: part[0].end_ns - part[0].start_ns)
        within = slice(*rows["stamp_ns"].searchsorted([longest.start_ns, longest.end_ns + 1]))
        zeta = np.array([tick.zeta for tick in ticks])
        touching = _tilt(*normals, zeta[within]).max(initial=0.0)
        is_exact = longest.tolerance is None
        never_tilts = is_exact and bool(_tilt(*_common_axis(zeta), zeta).max() <= MOST_TILT * touching)
    if not never_tilts:
        return segmentation
    return _with_open(segmentation, Contact.FF, np.ones(len(rows), bool), lambda _: (Contact.FREE,))


def _common_axis(zeta: Array) -> tuple[Array, Array]:
    """The axis (3,), in the body and in the world, about which the object turns most between lifted poses
    (T, 25). The faces of a segment may be across it, as those of a machine's straight moves."""
    world, _, body = np.linalg.svd(zeta[:, R].mean(axis=0).reshape(3, 3))
    return body[0], world[:, 0]


def _tilt(body_normal: Array, world_normal: Array, zeta: Array) -> Array:
    """Sine of the angle (T,) between the faces with these normals, in lifted poses (T, 25)."""
    turned = zeta[:, R].reshape(-1, 3, 3) @ body_normal
    return np.asarray(np.linalg.norm(np.cross(turned, world_normal), axis=1))


def _normals(segment: Segment) -> tuple[Array, Array] | None:
    """The normals of two faces, in the body and in the world, if the motion shows them."""
    geometry = segment.geometry
    if geometry is None:
        return None
    body, world = geometry.object, geometry.environment
    if not isinstance(body, Plane) or not isinstance(world, Plane) or world.unobserved:
        return None
    return body.normal, world.normal


def _with_open(
    segmentation: Segmentation,
    label: Contact,
    is_open: NDArray[np.bool_],
    rivals: Callable[[NDArray[np.int64]], tuple[Contact, ...]],
) -> Segmentation:
    """The segmentation with a ``label`` open to ``rivals`` in the ticks that ``is_open`` (T,), short gaps of
    these included. A segment is open if most of its ticks are."""
    rows, segments = segmentation.beliefs.rows.copy(), list[Segment]()
    for segment in segmentation.segments:
        first, end = rows["stamp_ns"].searchsorted([segment.start_ns, segment.end_ns + 1])
        within = without_short_gaps(is_open[first:end])
        if segment.contact is label and within.any():
            open_rows = first + np.flatnonzero(within)
            others = united(segment.inseparable, rivals(open_rows))
            for row in open_rows.tolist():
                rows["probability"][row] = ambiguity.with_rivals(rows["probability"][row], label, others)
            rows["inseparable"][open_rows] = [state in others for state in STATES]
            mean = rows["probability"][first:end].mean(axis=0)
            is_mostly_open = 2 * len(open_rows) > end - first
            inseparable = others if is_mostly_open else segment.inseparable
            p_label = float(mean[label.column])
            segment = replace(segment, probability=p_label, inseparable=inseparable, posterior=mean)
        segments.append(segment)
    beliefs = replace(segmentation.beliefs, rows=rows)
    return replace(segmentation, segments=tuple(segments), beliefs=beliefs)
