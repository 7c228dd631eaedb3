"""The offline tracker: one forward pass, then Viterbi and smoothing over its hypotheses.

Segments are concluded piece by piece, as soon as later data cannot change them any more, so memory does not
grow with the recording.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import cached_property
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import contact_tracker.hmm as hmm
from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank_update import LiveHypotheses
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.map.association import MAP_INSERTION_PROBABILITY, Sighting, log_odds_of_known
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion import tick_averaging
from contact_tracker.motion.free_motion import LONGEST_COAST_S, NOW_TICKS, SETTLING_TICKS
from contact_tracker.motion.poses import NO_OUTLIERS, Pose, batches
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import Window, at_rest, rest_ticks
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Belief, Detail, Segment
from contact_tracker.tracking.contact_filter import (
    ContactFilter,
    pairs_touched_elsewhere,
    ticks_of,
)
from contact_tracker.tracking.rest_sightings import RestSighting
from contact_tracker.tracking.segment_fit import (
    FinishedSegment,
    SegmentFit,
    SegmentTicks,
    fit_on_map,
    fit_segment,
    joined_by_wrenches,
    without_short_gaps,
)
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.tracking.state import FilterState
from contact_tracker.tracking.transition_model import FREE, PACE_SHAPE, leave_per_s
from contact_tracker.wrenches.contact_evidence import WrenchEvidence

PIECE_TICKS: Final = 1200
"""Ticks per piece, about; a shorter recording is one piece."""
TOLERANCE: Final = 1e-6
"""Largest change of a reported posterior by later data."""
LONGEST_SETTLING_TICKS: Final = SETTLING_TICKS + 1 + NOW_TICKS
"""Most ticks after a gap until the free-motion filter knows the motion, if there is any."""
ROOM_BYTES: Final = 60_000_000
"""Size of the open part (an object at rest may keep hours open) above which its older half is reported with
the posterior so far."""
_BELIEF_BATCH: Final = 256
_BATCH_TICKS: Final = 32
"""Ticks by which the trellis is extended at once; one by one takes twice as long."""

_TICK: Final = np.dtype(
    [
        ("start_ns", np.int64),
        ("stamp_ns", np.int64),
        ("count", np.float64),
        ("zeta", np.float64, 25),
        ("excess", np.float64, 2),
        ("residual", np.float64, len(CONTACTS)),
    ]
)


def segment(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    known_map: Map = EMPTY_MAP,
) -> Segmentation:
    """Segment a whole recording.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called at intervals with the number of poses read so far.
    known_map : elements of the object and its surroundings that are known before.

    Returns
    -------
    Segmentation with the Viterbi path, the smoothed posterior and the online beliefs.
    """
    start, ticks = ContactFilter.start(model, known_map=known_map), ticks_of(batches(poses), model, progress)
    return Segmentation.join(list(pieces(ticks, start, Segmenter(), Detail.GEOMETRY)))


def pieces(
    ticks: Iterable[Tick],
    filter_: ContactFilter,
    segmenter: "Segmenter",
    online: Detail = Detail.WEIGHTS,
) -> Iterator[Segmentation]:
    """The segmentation of a recording piece by piece and in bounded memory.

    Each piece has the segments concluded since the piece before with their smoothed beliefs, and the online
    beliefs since then, which are ahead of the smoothed ones. The latter have the detail ``online``, and are
    left out with ``Detail.WEIGHTS``. The ``segmenter`` may use wrenches, or record the sightings for a map.
    """
    for tick in ticks:
        belief = filter_.update(tick, online)
        segmenter.note(filter_.state, tick, belief if online >= Detail.SHARED else None)
        if segmenter.due:
            yield segmenter.conclude()
    yield segmenter.finish()


class _Gap(NamedTuple):
    """A long gap: its ``empty`` ticks, and the ``skipped`` ones with frames until the motion is known."""

    empty: int
    skipped: int

    @property
    def length(self) -> int:
        """Number of ticks."""
        return self.empty + self.skipped

    @property
    def after_middle(self) -> int:
        """Number of ticks after its middle, where a change of contact is assumed."""
        return self.empty // 2 + self.skipped

    def interpolate(self, posterior: Array) -> None:
        """Interpolate the ``posterior`` (n, 7), which ends with the tick at which the motion is known: the
        contact may have changed at any time in the gap."""
        share = np.minimum(np.arange(1, self.length + 1) / (self.empty + 1), 1.0)[-len(posterior) + 1 :, None]
        before = posterior[max(len(posterior) - self.length - 2, 0)]
        posterior[-self.length - 1 : -1] = (1.0 - share) * before + share * posterior[-1]


MOST_TICKS: Final = 36_000
"""Largest number of ticks, 1 kB each, that are kept for a second pass: an hour with ticks of 0.1 s."""


class PassRecord:
    """The ``ticks`` of a pass if it ``keeps_ticks`` for further passes, the ``state`` after it, the number of
    ``contacts`` among its segments, their ``sightings`` of elements, ``on_map`` those of contacts that the
    map decides, and what rests show of the recording (``at_rest``)."""

    def __init__(self, keeps_ticks: bool = True) -> None:
        self.keeps_ticks = keeps_ticks
        self.ticks: list[Tick] = []
        self.contacts = 0
        self.sightings: list[Sighting] = []
        self.on_map: list[Sighting] = []
        self.at_rest: Sequence[RestSighting] = ()
        self._exposure: list[float] = []  # of each tick, in ticks of motion
        self._changes = self._expected_changes = 0.0
        self._last_posterior = np.zeros((0, len(STATES)))
        self.state: FilterState | None = None
        self.is_full = False
        self.best = self

    @cached_property
    def map(self) -> GrowingMap | None:
        """After the passes: the map of the best one, or the online map if the recording is too long. None
        without poses."""
        if self.state is None:
            return None
        start = self.state.map
        if self.is_full:
            return start
        share = self.state.model.geometry.revisit_prior
        world = GrowingMap.learn(self.best.all_sightings, start.reach_m, prior=start.prior, share=share)
        world = replace(world, origins=start.origins, prior_is_dropped=start.prior_is_dropped)
        return world.with_recognised(self.best.on_map)

    @property
    def all_sightings(self) -> list[Sighting]:
        """Those of segments, and those at rest that no segment includes."""
        alone = [
            rest.sighting
            for rest in self.at_rest
            if not any(s.first < rest.sighting.end and rest.sighting.first < s.end for s in self.sightings)
        ]
        return [*self.sightings, *alone]

    @property
    def pace(self) -> float:
        """How much more often states end in this recording than by the model: mean of its posterior."""
        return (PACE_SHAPE + self._changes) / (PACE_SHAPE + self._expected_changes)

    @property
    def log_evidence(self) -> float:
        """Log probability of all ticks, relative to that of free motion (nats)."""
        return 0.0 if self.state is None else self.state.log_evidence

    def note(self, state: FilterState, tick: Tick) -> None:
        """Append a tick, after which the filter has this ``state``."""
        self.state = state
        self.is_full = len(self._exposure) == MOST_TICKS
        if self.is_full:
            self.ticks.clear()
            self.sightings.clear()
            self.on_map.clear()
            return
        self._exposure.append(state.hazard_exposure)
        if self.keeps_ticks:
            self.ticks.append(tick)

    def note_segment(self, finished: FinishedSegment, fit: SegmentFit, parts: Sequence[Segment]) -> None:
        """Append a segment with its moved and resting parts; only a certain segment is a sighting of its
        elements."""
        self._count_changes(finished)
        if fit.contact is not Contact.FREE:
            self.contacts += 1
        self.sightings += self._seen(finished, fit, parts)

    def note_on_map(self, finished: FinishedSegment, fit: SegmentFit, parts: Sequence[Segment]) -> None:
        """Append a segment that the map has decided."""
        self.on_map += self._seen(finished, fit, parts)

    def _seen(self, finished: FinishedSegment, fit: SegmentFit, parts: Sequence[Segment]) -> list[Sighting]:
        is_sure = any(p.probability >= MAP_INSERTION_PROBABILITY and not p.inseparable for p in parts)
        if fit.estimate is None or not is_sure or self.is_full:
            return []
        index, start_ns = finished.ticks.window.index, int(finished.rows["start_ns"][0])
        return [Sighting(int(index[0]), int(index[-1]) + 1, fit.estimate, start_ns, finished.end_ns)]

    def _count_changes(self, finished: FinishedSegment) -> None:
        """Add the changes of state that the posterior (n, 7) shows, the least number whose expectation agrees
        with it, and the number that the model expects in its states."""
        if self.is_full:
            return
        model, posterior = finished.ticks.model, finished.posterior
        steps = np.diff(np.concatenate([self._last_posterior, posterior]), axis=0)
        first = int(finished.ticks.window.index[0])
        exposure = np.array(self._exposure[first : first + len(posterior)])
        self._changes += 0.5 * float(np.abs(steps).sum())
        self._expected_changes += model.tick_s * float(exposure @ posterior @ leave_per_s(model.transitions))
        self._last_posterior = posterior[-1:]


class Segmenter:
    """Turns the ticks of a forward pass into segments, as soon as later data cannot change them."""

    def __init__(
        self,
        executor: Executor | None = None,
        wrenches: WrenchEvidence | None = None,
        record: PassRecord | None = None,
    ) -> None:
        self._executor = executor
        self._wrenches = wrenches
        self._record = record
        self._forward: hmm.ForwardFilter | None = None
        self._pending: list[tuple[tuple[LiveHypotheses, Array] | None, tuple[Any, ...]]] = []
        self._past, self._survivors = hmm.OpenTicks(), hmm.Survivors()
        self._due = PIECE_TICKS
        self._noted = 0  # ticks so far
        self._gap_ticks = self._since_gap = 0  # skipped ticks: those of the last gap, and those after it
        self._gaps: dict[int, _Gap] = {}  # by the number of the tick at which the motion is known again
        self._state: FilterState
        self._newest: Tick
        self._outliers = NO_OUTLIERS  # reported so far
        # of the ticks not yet reported, in parts
        self._ticks, self._posterior = [np.zeros(0, _TICK)], [np.zeros((0, len(STATES)))]
        self._first, self._before = 0, np.zeros(0, _TICK)  # number of the oldest of these, ticks before it
        self._path: deque[hmm.PathSegment] = deque()
        self._finished: deque[FinishedSegment] = deque()
        self._fits: deque[Future[SegmentFit]] = deque()  # in other processes
        self._online: list[Belief] = []
        self._filtered: list[Beliefs] = []

    def note(self, state: FilterState, tick: Tick, belief: Belief | None = None) -> None:
        """Append the next ``tick``, after which the filter has this ``state``, with the online ``belief`` if
        that is reported."""
        if self._record is not None:
            self._record.note(state, tick)
        if self._forward is None:
            self._forward = hmm.ForwardFilter(state.log_birth_weight)
        row = (tick.start_ns, tick.stamp_ns, tick.count, tick.zeta, tick.innovation_excess, state.residual)
        # nothing could change in it, so that nothing was weighed
        is_skipped = not state.hazard_exposure
        self._count_resumed(state, tick, is_skipped)
        evidence = None if is_skipped else (state.live_hypotheses, state.log_transition)
        self._pending.append((evidence, row))
        if len(self._pending) == _BATCH_TICKS:
            self._extended_trellis()
        if belief is not None:
            self._online.append(belief)
        if len(self._online) == _BELIEF_BATCH:  # objects are large
            self._filtered.append(Beliefs.of(self._online))
            self._online.clear()
        self._state, self._newest = state, tick

    def _count_resumed(self, state: FilterState, tick: Tick, is_skipped: bool) -> None:
        """Count the ticks of a long gap, and those skipped after it because the motion was not known yet.

        If the contact has changed when it is known, it most probably did so in the gap, which is longer.
        """
        if not is_skipped:
            if self._since_gap and self._gap_ticks * state.model.tick_s > LONGEST_COAST_S:
                self._gaps[self._noted] = _Gap(self._gap_ticks, self._since_gap)
            self._gap_ticks = self._since_gap = 0
        elif not tick.count:
            self._gap_ticks = self._gap_ticks + 1 if not self._since_gap else 1
            self._since_gap = 0
        elif self._gap_ticks:
            self._since_gap += 1
            if self._since_gap > LONGEST_SETTLING_TICKS:  # the object rests
                self._gap_ticks = self._since_gap = 0
        self._noted += 1

    @property
    def open_ticks(self) -> int:
        """Number of ticks whose posterior may still change."""
        return len(self._past) + len(self._pending)

    @property
    def due(self) -> bool:
        """Whether enough ticks are open for a call of ``conclude``."""
        return self.open_ticks >= self._due or self._past.size > ROOM_BYTES

    def conclude(self) -> Segmentation:
        """The segments decided since the last call."""
        frontier = self._extended_trellis()
        posterior, certain = self._past.look_back(frontier, TOLERANCE)
        if self._past.size > ROOM_BYTES:
            certain = max(certain, len(posterior) // 2)
        certain = self._whole_gaps(certain)
        self._append_smoothed(posterior[:certain])
        self._append_decided(self._survivors.decided_prefix(frontier))
        self._due = len(self._past) + max(PIECE_TICKS, len(self._past) // 2)
        fitted_before = len(self._finished)
        self._begin_fits(final=False)
        return self._next_piece(len(self._finished) if self._executor is None else fitted_before)

    def finish(self) -> Segmentation:
        """The remaining segments, at the end of the recording."""
        if self._forward is None:
            return Segmentation()
        frontier = self._extended_trellis()
        if len(self._past):
            self._append_smoothed(self._past.posterior(frontier))
        self._append_decided(self._survivors.finish(frontier))
        self._begin_fits(final=True)
        return self._next_piece(len(self._finished))

    def _extended_trellis(self) -> hmm.FilterFrontier:
        """The frontier after the last tick; the trellis is extended up to it."""
        assert self._forward is not None
        for evidence, _ in self._pending:
            if evidence is None:
                for recursion in (self._forward, self._past, self._survivors):
                    recursion.skip()
            else:
                alive, change = evidence
                step = self._forward.advance(*alive, change)
                self._past.append(step)
                self._survivors.append(step)
        self._ticks.append(np.array([row for _, row in self._pending], _TICK))
        self._pending.clear()
        return self._forward.frontier

    def _append_smoothed(self, posterior: Array) -> None:
        first = self._past.first
        for number, gap in self._gaps.items():
            if first < number < first + len(posterior):
                gap.interpolate(posterior[: number - first + 1])
        self._past.drop(len(posterior))
        self._posterior.append(ambiguity.tempered(posterior, self._state.model.certainty.posterior_power))

    def _whole_gaps(self, certain: int) -> int:
        """At most ``certain`` of the oldest open ticks, so that the ticks of a gap are reported with those
        before and after, from which their posterior is interpolated."""
        end = self._past.first + certain
        for number, gap in self._gaps.items():
            if number - gap.length <= end <= number:
                end = number - gap.length - 1
        return max(end - self._past.first, 0)

    def _append_decided(self, segments: Iterable[hmm.PathSegment]) -> None:
        """Append decided path segments; segments of free motion, one for each tick, are joined."""
        for state, onset, end in segments:
            if self._path and state == self._path[-1][0] == FREE:
                onset = self._path.pop()[1]
            onset, end = (
                number - self._gaps[number].after_middle if number in self._gaps else number
                for number in (onset, end)
            )
            self._path.append((state, onset, end))
        needed = min(self._past.first, self._survivors.first)
        self._gaps = {number: gap for number, gap in self._gaps.items() if number >= needed}

    def _begin_fits(self, final: bool) -> None:
        """Fit the segments whose posterior is decided, to some ticks after them, in which a rest may go on;
        free motion at the end may continue unless ``final``."""
        margin = 2 * rest_ticks(self._state.model.tick_s)
        ticks, self._ticks = np.concatenate(self._ticks), []
        posterior, self._posterior = np.concatenate(self._posterior), []
        decided = len(posterior) - (0 if final else margin)
        while self._path and self._path[0][2] - self._first <= decided:
            state, _, end = self._path[0]
            if state == FREE and len(self._path) == 1 and not final:
                break
            self._path.popleft()
            first, end = len(self._before), max(end - self._first, 0)
            around = np.concatenate([self._before, ticks[: end + margin]])
            resting = self._rests(self._first - first, around)
            count = end_at_rest(resting, first + end, margin) - first
            _move_change(posterior, end, count)
            if count <= 0:  # the rest beside it is that of another segment
                continue
            rows, ticks = _continued(ticks[:count].copy()), ticks[count:]
            end_ns = int(ticks["start_ns"][0] - 1 if len(ticks) else rows["stamp_ns"][-1])
            rests = without_short_gaps(resting[first : first + count])
            fitted = self._segment_ticks(state, rows)
            segment = FinishedSegment(state, rows, end_ns, posterior[:count].copy(), fitted, rests)
            self._finished.append(segment)
            if self._executor is not None:
                self._fits.append(self._executor.submit(fit_segment, fitted))
            self._first, self._before = self._first + count, around[: first + count][-margin:]
            posterior, decided = posterior[count:], decided - count
        self._ticks, self._posterior = [ticks.copy()], [posterior.copy()]

    def _rests(self, first: int, rows: NDArray[np.void]) -> NDArray[np.bool_]:
        """Which ticks, from number ``first`` on, belong to a rest; none if both sides are listed."""
        if not ambiguity.others_at_rest(Contact.FREE, self._state.known_map):
            return np.zeros(len(rows), bool)
        return at_rest(self._window(first, rows), self._state.model.tick_s)

    def _window(self, first: int, rows: NDArray[np.void]) -> Window:
        """The ticks from number ``first`` on, with the present noise estimate."""
        model, noise = self._state.model, self._newest.noise
        return Window(
            first + np.arange(len(rows)),
            rows["zeta"],
            tick_averaging.tick_variances(noise, rows["count"], model),
            rows["excess"],
            tick_averaging.tick_anisotropy(noise, rows["count"], model),
            self._before["zeta"][-1] if len(self._before) else None,
            rows["count"],
        )

    def _segment_ticks(self, column: int, rows: NDArray[np.void]) -> SegmentTicks:
        """The ticks that contacts are fitted to."""
        state, wrenches = self._state, None
        if self._wrenches is not None:
            wrenches = self._wrenches.of_window(int(rows["stamp_ns"][0]), int(rows["stamp_ns"][-1]))
        window = self._window(self._first, rows)
        return SegmentTicks(
            *(window, STATES[column], state.model, state.known_map, state.origins, wrenches),
            touched=state.map.touched_faces,
        )

    def _next_piece(self, count: int) -> Segmentation:
        """The oldest ``count`` segments being fitted, and the online beliefs since the last piece."""
        finished = [self._finished.popleft() for _ in range(count)]
        if self._executor is None:
            fits = [fit_segment(segment.ticks) for segment in finished]
        else:
            fits = [self._fits.popleft().result() for _ in range(count)]
        fitted = joined_by_wrenches([*zip(finished, fits, strict=True)])
        results = [segment.with_fit(fit) for segment, fit in fitted]
        if self._record is not None:
            for (segment, fit), (parts, _) in zip(fitted, results, strict=True):
                self._record.note_segment(segment, fit, parts)
        results = [self._reported(*each, result) for each, result in zip(fitted, results, strict=True)]
        online, self._online = [*self._filtered, Beliefs.of(self._online)], []
        self._filtered.clear()
        outliers, self._outliers = self._state.outliers.since(self._outliers), self._state.outliers
        beliefs = Beliefs.join([part for _, part in results])
        rows = tuple(row for rows, _ in results for row in rows)
        return Segmentation(rows, beliefs, Beliefs.join(online), outliers)

    def _reported(
        self, segment: FinishedSegment, fit: SegmentFit, result: tuple[tuple[Segment, ...], Beliefs]
    ) -> tuple[tuple[Segment, ...], Beliefs]:
        """The ``result`` of a segment, or what the map makes of it: fewer open states, or free motion."""
        on_map = self._on_map(segment, fit)
        if self._may_agree_by_chance(segment, on_map):
            return segment.as_free(on_map)
        if on_map is fit:
            return result
        decided = segment.with_fit(on_map)
        if self._record is not None:
            self._record.note_on_map(segment, on_map, decided[0])
        return decided

    def _may_agree_by_chance(self, segment: FinishedSegment, fit: SegmentFit) -> bool:
        """Whether the contact of a segment may agree with free motion by chance: if the motion does not
        distinguish them, no rest, joint or further contact shows more, and the elements are neither listed
        nor those of other segments. A contact of two or three constraints may do so where f-f fits the motion
        as well, since such motion shows none of the constraints."""
        ticks, world, first = segment.ticks, self._state.map, int(segment.ticks.window.index[0])
        is_open = Contact.FREE in fit.inseparable and fit.share is None and not segment.resting.any()
        is_complex = bool(fit.joints or fit.formation.further)
        if not is_open or is_complex or fit.touches_listed or fit.is_on_map or fit.estimate is None:
            return False
        is_blank = fit.geometry is not None and fit.geometry.is_unobserved
        if not (is_blank or fit.contact.codimension == 1 or Contact.FF in (fit.contact, *fit.inseparable)):
            return False
        most_ticks = inf if is_blank else ambiguity.LEAST_TICKS
        if not ambiguity.agrees_by_chance(fit.contact, ticks.window, first, most_ticks):
            return False
        end = first + len(segment.rows)
        others = world.without(s.first for s in world.sightings if s.first < end and s.end > first)
        return log_odds_of_known(Sighting(first, end, fit.estimate), others, world.reach_m) < DECISIVE

    def _on_map(self, segment: FinishedSegment, fit: SegmentFit) -> SegmentFit:
        """The ``fit`` of a segment with what the elements that are listed, or that other segments have shown,
        tell of it."""
        shown = () if self._record is None else self._record.sightings
        state, ticks, first = self._state, segment.ticks, int(segment.ticks.window.index[0])
        pairs = pairs_touched_elsewhere(state, fit.contact, ticks.window, first, shown)
        on_map = fit if pairs is None else fit_on_map(ticks, fit, pairs)
        at_rest = [] if self._record is None else [rest.sighting for rest in self._record.at_rest]
        if on_map is fit and at_rest:
            pairs = pairs_touched_elsewhere(state, fit.contact, ticks.window, first, at_rest)
            on_map = fit if pairs is None else fit_on_map(ticks, fit, pairs, moved=False)
        return on_map


def end_at_rest(resting: NDArray[np.bool_], end: int, most_ticks: int) -> int:
    """The ``end`` of a segment, moved to the nearest end of a rest that contains it or is ``NOW_TICKS`` away.

    Motion shows no change of contact within a rest, nor just beside one. An end that is more than
    ``most_ticks`` from the ends of its rest stays.
    """
    edges = np.flatnonzero(np.diff(resting)) + 1
    if not edges.size or not 0 < end < len(resting):
        return end
    nearest = int(edges[np.abs(edges - end).argmin()])
    is_within = resting[end - 1 : end + 1].all()
    return nearest if abs(nearest - end) <= (most_ticks if is_within else NOW_TICKS) else end


def _continued(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The ticks of a segment; those of a gap at its beginning have the pose after the gap."""
    first = int((rows["count"] > 0.0).argmax())
    rows["zeta"][:first] = rows["zeta"][first]
    return rows


def _move_change(posterior: Array, old: int, new: int) -> None:
    """Move the change between rows ``old`` - 1 and ``old`` to before row ``new``: the rows between become
    copies of the last row before the change, or of the first row after it."""
    first, end = sorted((max(old, 0), max(new, 0)))
    row = old - 1 if new > old else old
    if 0 <= row < len(posterior):
        posterior[first:end] = posterior[row].copy()
