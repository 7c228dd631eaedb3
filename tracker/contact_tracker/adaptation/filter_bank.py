"""Filters side by side that differ in the noise of a tick, weighed by their evidence.

The first has the model as given. The others start, from the first pose, once the ratio of the noise of
position and orientation is estimated. After some seconds of motion those far behind are dropped, later all
but the best (``comparison``).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation import rest
from contact_tracker.adaptation.candidates import (
    LASTING_NS,
    RATE_POSES,
    candidates,
    has_less_noise,
    usual_period_s,
    with_other_ticks,
    with_ticks_for,
)
from contact_tracker.adaptation.comparison import (
    TickEvidence,
    are_compared,
    relative_evidence,
    tick_evidence,
)
from contact_tracker.adaptation.mixture import mixture
from contact_tracker.adaptation.rest import NO_REST, Rest
from contact_tracker.config.parameters import Model
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.tick_grid import ORIGIN_M, TickGrid
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.state import FilterState

Array = NDArray[np.float64]

RATIO_POSES: Final = 60
"""Number of poses from which the ratio of the noise of position and orientation is estimated."""
REST_NATS: Final = 10.0
"""Log weight by which a filter that takes noise for motion is reduced while the object rests."""


class TrackedTick(NamedTuple):
    """A tick by which a filter was updated: its ``evidence``, and the belief to report."""

    evidence: TickEvidence
    belief: Belief | None


class FirstTick(NamedTuple):
    """A tick of the first filter before the others start, and whether the object ``moves`` in it."""

    tick: Tick
    tracked: TrackedTick
    moves: bool


@dataclass(eq=False)
class FilterBank:
    """The filters of one stream; bounded in size, however long the stream.

    Parameters
    ----------
    model, known_map, lag_s : as given; ticks of the filters may be longer.
    grid : averages poses into ticks for all filters; None before the rate is known.
    filters : none before the rate is known. While the object rests only the first is updated (``rest``).
    log_weight, log_prior : (K,) log weights of the filters, and the part of them that is no evidence.
    pending : poses so far, until the other filters start with them; then None.
    first : the ticks so far, of the first filter.
    moved_s : time for which the object has moved.
    rest : whether the object rests, and the ticks by which the others are not updated yet.
    latest_ns : stamps of the latest poses, for the rate.
    period_s : the usual time between poses, if it is known in advance: then ticks do not change.
    body_m : (3,) point of the body that is tracked, in the body frame; by the first
        ``RATIO_POSES`` where the period is not known in advance.
    map : that of before the rate has changed; None if it has not.
    earlier_outliers : number of outliers from before.
    changed_since_ns : time since which the rate is another one; None if it is not.
    """

    model: Model
    lag_s: float = 0.0
    known_map: Map = EMPTY_MAP
    grid: TickGrid | None = None
    filters: list[ContactFilter] = field(default_factory=list)
    log_weight: Array = field(default_factory=lambda: np.zeros(1))
    log_prior: Array = field(default_factory=lambda: np.zeros(1))
    pending: Poses | None = NO_POSES
    first: list[FirstTick] = field(default_factory=list)
    moved_s: float = 0.0
    rest: Rest = NO_REST
    latest_ns: NDArray[np.int64] = field(default_factory=lambda: NO_POSES.stamp_ns)
    period_s: float | None = None
    body_m: Array = field(default_factory=ORIGIN_M.copy)
    map: GrowingMap | None = None
    earlier_outliers: int = 0
    changed_since_ns: int | None = None

    def copied(self) -> Self:
        """A copy that is updated without a change of this one; what does not change in place is shared."""
        other = copy(self)
        other.filters, other.first = [*map(copy, self.filters)], [*self.first]
        other.grid = copy(self.grid)
        return other

    @property
    def is_decided(self) -> bool:
        """Whether one filter is left, and none is to start."""
        return self.pending is None and len(self.filters) == 1

    @property
    def best(self) -> FilterState | None:
        """The most probable filter, at rest perhaps not updated by the latest ticks; None before the rate of
        the stream is known."""
        return self.filters[int(self.log_weight.argmax())].state if self.filters else None

    @property
    def outliers(self) -> int:
        """Poses left out of their ticks so far."""
        return self.earlier_outliers + (self.filters[0].state.outliers if self.filters else 0)

    def add(self, poses: Poses, detail: Detail) -> list[Belief]:
        """Add poses; returns the beliefs of the ticks that they close."""
        beliefs = self._add(poses, detail)
        if self.period_s is not None:
            return beliefs
        self.latest_ns = np.append(self.latest_ns, poses.stamp_ns)[-RATE_POSES:]
        if self.grid is None or not self.grid.frames.stamp_ns.size:
            return beliefs
        model = with_other_ticks(self.model, self.grid.model, self.latest_ns)
        if model is None:
            self.changed_since_ns = None
            return beliefs
        if self.changed_since_ns is None:
            self.changed_since_ns = int(self.latest_ns[0])
        if self.latest_ns[-1] - self.changed_since_ns < LASTING_NS:
            return beliefs
        return [*beliefs, *self._restart(model, detail)]

    def pass_time(self, until_ns: int, detail: Detail) -> list[Belief]:
        """Close the ticks that are over, see ``TickGrid.pass_time``; returns their beliefs."""
        return [] if self.grid is None else self._update(self.grid.pass_time(until_ns), detail)

    def finish(self) -> list[Belief]:
        """At the end of the stream: beliefs of the last, partial tick and of the ticks within the lag.

        The stream may be continued; the time since is a gap.
        """
        beliefs = list[Belief]()
        if self.pending is not None and len(self.pending):
            if not self.filters:
                beliefs = self._start_first(Detail.FORMATION)
            self._start_others(Detail.GEOMETRY)
        if self.grid is None:
            return beliefs
        self._catch_up(Detail.FORMATION)
        last = self.grid.close()
        ended = list[list[Belief]]()
        for number, one in enumerate(self.filters):
            found = [_observe(one, one.as_seen(tick) if number else tick) for tick in last]
            ended.append([*(seen.belief for seen in found if seen.belief is not None), *one.finish()])
        return [*beliefs, *(self._mixture(some, self.log_weight) for some in zip(*ended, strict=True))]

    def _add(self, poses: Poses, detail: Detail) -> list[Belief]:
        beliefs = list[Belief]()
        while self.pending is not None and len(poses):  # until all filters have started
            enough = RATIO_POSES if self.filters else RATE_POSES
            missing = enough - len(self.pending)
            some, poses = poses[:missing], poses[missing:]
            self.pending = Poses.join([self.pending, some])
            if self.grid is not None:
                beliefs += self._update(self.grid.add(some), detail)
                if len(some) == missing:
                    self._start_others(min(detail, Detail.GEOMETRY))
            elif len(some) == missing:
                beliefs += self._start_first(detail)
        if self.grid is not None and poses.stamp_ns.size:
            beliefs += self._update(self.grid.add(poses), detail)
        return beliefs

    def _restart(self, model: Model, detail: Detail) -> list[Belief]:
        """Start again with other ticks, at the first pose of the current tick; the map is kept, and the
        beliefs within the lag are reported first."""
        lagging = zip(*(one.finish() for one in self.filters), strict=True)
        before = [self._mixture(some, self.log_weight) for some in lagging]
        assert self.best is not None
        assert self.grid is not None
        assert self.grid.origins is not None
        frames, world = self.grid.frames, self.best.map.before_onsets()
        first = ContactFilter.start(model, self.lag_s, self.known_map)
        first.state = first.state._replace(map=world)
        again = FilterBank(
            self.model,
            self.lag_s,
            self.known_map,
            TickGrid.begun(model, int(frames.stamp_ns[0]), self.grid.origins),
            [first],
            pending=frames[-RATIO_POSES + 1 :],
            body_m=self.body_m,
            latest_ns=self.latest_ns,
            map=world,
            earlier_outliers=self.outliers,
        )
        vars(self).update(vars(again))
        assert again.grid is not None
        return [*before, *self._update(again.grid.add(frames), detail)]

    def _start_first(self, detail: Detail) -> list[Belief]:
        """Start the filter of the model as given, with ticks that hold frames; its beliefs so far."""
        assert self.pending is not None
        period_s = usual_period_s(self.pending.stamp_ns) if self.period_s is None else self.period_s
        model = with_ticks_for(self.model, period_s)
        return self._begin(model, detail)

    def _begin(self, model: Model, detail: Detail) -> list[Belief]:
        """Begin with the first filter and all poses so far; its beliefs."""
        assert self.pending is not None
        self.grid, self.first = TickGrid(model, self.body_m), []
        self.filters = [ContactFilter.start(model, self.lag_s, self.known_map)]
        return self._update(self.grid.add(self.pending), detail)

    def _settle_point(self, detail: Detail) -> None:
        """Choose the tracked point by all poses so far, and if it is another one begin again with it."""
        assert self.pending is not None
        point_m = independent_point(self.pending)
        if (point_m != self.body_m).any():
            self.body_m, self.moved_s, self.rest = point_m, 0.0, NO_REST
            self._begin(self.filters[0].state.model, detail)  # its beliefs were reported already

    def _start_others(self, detail: Detail) -> None:
        """Start the other filters and update them by the ticks so far, which were reported already."""
        assert self.pending is not None
        if self.period_s is None and self.map is None:
            self._settle_point(detail)
        model, poses = self.filters[0].state.model, self.pending.of_point(self.body_m)
        chosen, first = candidates(model, poses), self.first
        others = [ContactFilter.start(one.model, self.lag_s, self.known_map) for one in chosen[1:]]
        seen = list[list[TrackedTick]]()
        for one in others:
            if self.map is not None:
                one.state = one.state._replace(map=self.map)
            seen.append([_observe(one, one.as_seen(it.tick), detail, False) for it in first])
        self.filters += others
        self.log_weight = self.log_prior = np.array([one.log_prior for one in chosen])
        self.pending, self.first, self.rest = None, [], self.rest.restarted()
        alive = np.arange(len(self.filters))
        for one, *more in zip(first, *seen, strict=True):
            now = [one.tracked, *more]
            alive = alive[self._weigh(one.tick, [now[i] for i in alive], one.moves)]

    def _update(self, ticks: list[Tick], detail: Detail) -> list[Belief]:
        """Update the filters by ticks; those that are dropped are left out of later ticks."""
        beliefs = list[Belief]()
        while ticks:
            if len(self.filters) == 1 and self.pending is None:
                for tick in ticks:
                    self.filters[0].update(tick, detail)
                    beliefs += filter(None, [self.filters[0].reported])
                return beliefs
            first, ahead = self.filters[0], self._rest_ahead(ticks)
            some, ticks = ticks[: len(ahead)], ticks[len(ahead) :]
            if self._is_gap(some[0], ahead[0]):
                beliefs += self._pass_gap(some, ahead[-1])
            elif ahead[0].is_waiting:
                beliefs += self._update_first(some, ahead[-1], detail)
            else:
                beliefs += self._update_all(some[0], ahead[0], detail)
            if self.filters[0] is not first:  # which was dropped
                assert self.grid is not None
                ticks = [self.filters[0].as_seen(tick) for tick in ticks]
                self.grid.follow(self.filters[0].state.model, self.filters[0].state.free_motion)
        return beliefs

    def _rest_ahead(self, ticks: Sequence[Tick]) -> list[Rest]:
        """``Rest`` after the next tick, or after each of the next ticks that are processed together: those of
        a gap, or those in which the others wait."""
        first, *others = (one.state for one in self.filters)
        can_wait = bool(others) and not first.lag_history.size and not first.known_map
        is_quietest = not any(has_less_noise(one.model.noise, first.model.noise) for one in others)
        ahead = list[Rest]()
        for tick in ticks:
            now = rest.advance(
                ahead[-1] if ahead else self.rest, tick, first.model.tick_s, can_wait, is_quietest
            )
            if not ahead:
                ahead, is_gap = [now], self._is_gap(tick, now)
            elif (is_gap and not tick.count) or (not is_gap and now.is_waiting):
                ahead.append(now)
            else:
                break
            if not is_gap and not now.is_waiting:
                break
        return ahead

    def _is_gap(self, tick: Tick, now: Rest) -> bool:
        """Whether all filters can pass a tick and the next ones without frames in one step."""
        return (
            not tick.count
            and not now.moves
            and not self.rest.is_waiting
            and self.pending is None
            and all(one.can_hold for one in self.filters)
        )

    def _pass_gap(self, ticks: Sequence[Tick], now: Rest) -> list[Belief]:
        """Update all filters by ticks without frames."""
        for number, one in enumerate(self.filters):
            one.hold(len(ticks))
            if number and now.is_waiting:
                _stop_following(one)
        known = [one.state.belief for one in self.filters if one.state.belief is not None]
        self.rest, same = now.caught_up(), self._mixture(known, self.log_weight)
        return [replace(same, stamp_ns=tick.stamp_ns) for tick in ticks]

    def _update_all(self, tick: Tick, now: Rest, detail: Detail) -> list[Belief]:
        """Update all filters by a tick."""
        self._catch_up(detail)
        self.rest = now
        best, seen = int(self.log_weight.argmax()), list[TrackedTick]()
        for number, (one, of_one) in enumerate(zip(self.filters, self._details(detail), strict=True)):
            seen.append(_observe(one, one.as_seen(tick) if number else tick, *of_one))
        curved = self.filters[best].state.curved  # tested by one for all
        for one in self.filters:
            if one.state.label is Contact.FREE:
                one.state = one.state._replace(curved=curved._replace(since=one.state.free_since))
        tracked = [seen[i] for i in self._weigh(tick, seen, now.moves)]
        beliefs = [one.belief for one in tracked if one.belief is not None]
        if not beliefs:  # all have the same lag
            return []
        activity = np.array([one.evidence.activity for one in tracked])
        held_for_motion = 0.0 if now.moves else REST_NATS * activity
        return [self._mixture(beliefs, self.log_weight - held_for_motion)]

    def _update_first(self, ticks: Sequence[Tick], now: Rest, detail: Detail) -> list[Belief]:
        """Update the first filter by ticks in which the others wait."""
        (first, *others), (own, *details) = self.filters, self._details(detail)
        if not self.rest.is_waiting:
            for one, of_one in zip(others, details, strict=True):
                if one.can_hold:
                    one.hold(1, ticks[0].outliers)
                else:
                    one.update(replace(ticks[0], innovation_excess=NO_EXCESS), *of_one)
                _stop_following(one)
        beliefs, same = list[Belief](), [one.state.belief for one in others]
        for tick in ticks:
            evidence, belief = _observe(first, tick, *own)
            held_for_motion = np.append(REST_NATS * evidence.activity, np.zeros(len(others)))
            now_same = [replace(one, stamp_ns=tick.stamp_ns) for one in same if one is not None]
            if belief is not None:
                beliefs.append(self._mixture([belief, *now_same], self.log_weight - held_for_motion))
        self.rest = now
        return beliefs

    def _mixture(self, beliefs: Sequence[Belief], log_weight: Array) -> Belief:
        return mixture(beliefs, log_weight, self.known_map.possible)

    def _details(self, detail: Detail) -> list[tuple[Detail, bool]]:
        """Of each filter, the detail of its beliefs, and whether it tests free motion for curved surfaces:
        only the best one looks for further contacts and curvature."""
        best = int(self.log_weight.argmax())
        others = min(detail, Detail.GEOMETRY), False
        return [(detail, True) if i == best else others for i in range(len(self.filters))]

    def _catch_up(self, detail: Detail) -> None:
        """Update the filters that wait by the ticks that they missed: those skipped as without motion, then
        those kept."""
        missed = self.rest
        if missed.skipped or missed.kept:
            for one, of_one in zip(self.filters[1:], self._details(detail)[1:], strict=True):
                one.hold(missed.skipped, missed.outliers)
                for tick in missed.kept:
                    one.update(one.as_seen(tick), *of_one)
        self.rest = missed.restarted()

    def _weigh(self, tick: Tick, now: Sequence[TrackedTick], moves: bool) -> NDArray[np.int64]:
        """Weigh the filters by the evidence of a ``tick``, if the object ``moves`` in it; returns the indices
        of those that are kept."""
        every = np.arange(len(now))
        if len(now) == 1:
            if self.pending is not None:
                self.first.append(FirstTick(tick, now[0], moves))
            return every
        if not moves:
            return every
        model = self.filters[0].state.model
        log_weight = self.log_weight + relative_evidence([one.evidence for one in now], model.motion)
        self.moved_s += model.tick_s
        kept = every[are_compared(log_weight, self.log_prior, self.moved_s)]
        self.filters = [self.filters[i] for i in kept]
        self.log_weight = log_weight[kept] - log_weight.max()
        self.log_prior = self.log_prior[kept]
        return kept


def _observe(
    one: ContactFilter, tick: Tick, detail: Detail = Detail.FORMATION, tests_curvature: bool = True
) -> TrackedTick:
    """Update one filter by a tick."""
    before = one.state
    one.update(tick, detail, tests_curvature)
    return TrackedTick(tick_evidence(before, one.state), one.reported)


def _stop_following(one: ContactFilter) -> None:
    """A filter that waits: its free motion will start again."""
    one.state = one.state._replace(free_motion=None)
