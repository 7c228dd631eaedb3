"""A bank of filters that differ in the noise of a tick, weighed by their evidence: the length of ticks, the
bank, and its report.

The first filter has the given model. The others start, from the first pose, once the ratio of the noise of
position and orientation is estimated. After some motion filters far behind are dropped, later all but the
best (``are_kept``).
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter, sub
from typing import Final, NamedTuple, Self

import numpy as np

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.free_motion import NO_EXCESS, NOW_TICKS, can_be_compared
from contact_tracker.motion.free_speed import FreeSpeed
from contact_tracker.motion.poses import NO_OUTLIERS, NO_POSES, Outliers, Poses
from contact_tracker.motion.sensor_noise import independent_point
from contact_tracker.motion.tick_averaging import (
    NOISY_M,
    ORIGIN_M,
    Tick,
    TickGrid,
    tick_variances,
    white_variances,
)
from contact_tracker.states import CONTACTS, STATES, Contact, united
from contact_tracker.tracking.ambiguity import likelier_states, reported, shared_with
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.noise_choice import (
    LOG_PRIOR_TOLERANCE,
    NO_RESTS,
    RestScatter,
    TickEvidence,
    are_calm,
    are_kept,
    candidates,
    relative_evidence,
    tick_evidence,
)
from contact_tracker.tracking.state import FilterState

FIRST_POSES: Final = 2
"""Number of poses whose distance is the period of the stream until its rate is estimated."""
RATE_POSES: Final = 12
"""Number of poses from which the rate of the stream is estimated: its first, later the latest."""
CHANGED: Final = 2.0
"""The rate has changed if ticks for it are longer or shorter by more than this factor. Trackers then start
again, which costs more than ticks with one pose or with some more than needed."""
LASTING_NS: Final = 1_000_000_000
"""Time for which a new rate has to last before ticks follow it: for a shorter time poses may be missing."""
TOLERANCE: Final = 1.05
"""Tolerance of the tick's length, for jitter of the periods."""
TICKS_PER_WINDOW: Final = 10
IRREGULAR: Final = 2.0
"""Periods longer than the median by more than this factor are gaps; much shorter ones are of two bodies."""
QUANTILES: Final = np.arange(0.1, 1.0, 0.2)
"""Quantiles of the period, over time, by which the rates of a recording are found."""


def usual_period_s(stamp_ns: Sequence[int]) -> float:
    """Mean of the periods within a factor of ``IRREGULAR`` of the median; 0 for a single pose.

    With jitter of the stamps the median itself is biased.
    """
    rising = sorted(map(sub, stamp_ns[1:], stamp_ns))
    count = len(rising)
    return _mean_near(rising, 0.5 * (rising[(count - 1) // 2] + rising[count // 2])) if count else 0.0


def _mean_near(rising: Sequence[int], period_ns: float) -> float:
    """Mean (s) of the rising periods (ns) within a factor of ``IRREGULAR`` of one."""
    usual = rising[bisect_left(rising, period_ns / IRREGULAR) : bisect_right(rising, period_ns * IRREGULAR)]
    return sum(usual) / len(usual) * 1e-9


def period_for_all_s(stamp_ns: Ints, model: Model) -> float:
    """The usual period of the stretch of a recording whose ticks lose the least of the whole.

    Ticks lose the stretches whose poses are too far apart for them, and the ticks in which the contact
    changes, at the rate of the model.
    """
    if len(stamp_ns) < 2:
        return 0.0
    periods = np.diff(stamp_ns)
    padded = np.concatenate([periods[:1], periods, periods[-1:]])
    local = np.minimum(periods, np.minimum(padded[:-2], padded[2:]))  # not those of gaps
    order = np.argsort(local)
    passed = periods[order].cumsum()
    middle = order[np.searchsorted(passed, (QUANTILES * passed[-1]).astype(np.int64))]

    def lost(period_s: float) -> float:
        ticks = with_ticks_for(model, period_s)
        if not can_be_compared(ticks):
            return 1.0
        tick_s = ticks.tick_s
        apart = float(periods[local * 1e-9 > TOLERANCE * tick_s].sum() / periods.sum())
        return apart + (1.0 - apart) * min(tick_s * model.transitions.leave_per_s, 1.0)

    rising = np.sort(periods).tolist()
    return min((_mean_near(rising, float(period_ns)) for period_ns in local[middle]), key=lost)


def with_ticks_for(model: Model, period_s: float) -> Model:
    """The model with ticks of at least ``poses_per_tick`` poses of this period, but at most a tenth of the
    window; its own if they are long enough."""
    needed_s = min(model.poses_per_tick * period_s, model.search.window_s / TICKS_PER_WINDOW)
    return replace(model, tick_s=needed_s) if needed_s > TOLERANCE * model.tick_s else model


def with_other_ticks(model: Model, current: Model, latest_ns: Sequence[int]) -> Model | None:
    """``model`` with ticks for the rate of the latest poses; None if the ``current`` ticks suit as well."""
    if len(latest_ns) < RATE_POSES:
        return None
    adapted = with_ticks_for(model, usual_period_s(latest_ns))
    is_alike = 1.0 / CHANGED <= adapted.tick_s / current.tick_s <= CHANGED
    return adapted if not is_alike and can_be_compared(adapted) else None


DOUBT: Final = 0.5
"""Weight of the uniform distribution while the stream is in doubt."""


def mixture(beliefs: Sequence[Belief], log_weight: Array, known_map: Map = EMPTY_MAP) -> Belief:
    """The belief of K filters by their ``log_weight`` (K,): the mean posterior, and the label of a filter
    that is most probable in it. States that are more probable in the mean, but that no filter names, are
    indistinguishable from it and share their probability with it.

    Onset, elements and alternatives are those of the most probable filter with this label. ``known_map`` has
    the contacts that can occur.
    """
    if len(beliefs) == 1:
        return beliefs[0]
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    probability = weight @ np.array([belief.probability for belief in beliefs])
    label = max((belief.contact for belief in beliefs), key=lambda contact: probability[contact.column])
    ahead = likelier_states(probability, label)
    probability = shared_with(probability, label, ahead)
    share = [
        (b.contact is label, w * b.probability[label.column]) for w, b in zip(weight, beliefs, strict=True)
    ]
    number = max(range(len(beliefs)), key=lambda i: (share[i], i))
    source = beliefs[number]
    source = replace(source, inseparable=united(source.inseparable, ahead))
    # states of the other filters may be rivals; only one filter searches further contacts, and only its label
    # is limited
    probability = reported(probability, label, source.inseparable, known_map, is_open=source.is_open)
    return replace(source, probability=probability)


def mixed_with_uniform(probability: Array, possible: tuple[Contact, ...] = CONTACTS) -> Array:
    """Posterior (..., 7) mixed with a uniform one over free motion and the ``possible`` contacts, while the
    poses or the map may be wrong."""
    uniform = np.array([state in (*possible, Contact.FREE) for state in STATES]) / (1 + len(possible))
    return np.asarray((1.0 - DOUBT) * probability + DOUBT * uniform)


RATIO_POSES: Final = 60
"""Number of poses from which the ratio of the noise of position and orientation is estimated."""
REST_NATS: Final = 10.0
"""Log weight by which a filter that takes noise for motion is reduced while the object rests."""
SPAN_TICKS: Final = 5
DISPLACEMENT_RATIO: Final = 4.0
"""There is motion if the squared displacement over ``SPAN_TICKS`` ticks exceeds that of noise by this
factor."""
LASTING_TICKS: Final = 3
"""Number of consecutive ticks in which there must be motion; noise seldom looks like it three times."""


def is_moving(lifted_poses: Array) -> bool:
    """Whether the object moves in the newest of the latest ticks, of zeta (n, 25): in orientation or
    position, the displacements over several spans exceed those of noise."""
    if len(lifted_poses) < SPAN_TICKS + LASTING_TICKS:
        return False
    spans = [lifted_poses[first : first + SPAN_TICKS + 1] for first in range(LASTING_TICKS)]
    return any(all(_exceeds_noise(span[:, part]) for span in spans) for part in (R, T))


def _exceeds_noise(values: Array) -> bool:
    """Whether the displacement from the first to the last of the values (N, d) exceeds that of white noise;
    ticks without frames are left out."""
    steps_sq = (np.diff(values, axis=0) ** 2).sum(axis=1)
    steps_sq = steps_sq[steps_sq > 0.0]
    way_sq = ((values[-1] - values[0]) ** 2).sum()
    return len(steps_sq) > 1 and bool(way_sq > DISPLACEMENT_RATIO * steps_sq.mean())


class LatestMotion(NamedTuple):
    """Motion in the latest ticks, as the first filter finds it.

    Parameters
    ----------
    lifted_poses : (n, 25) zeta of the latest ticks with frames.
    moves : whether the newest has frames and unpredictable motion, and the object moves in it.
    ticks_with_excess : number of consecutive ticks with frames and unpredictable motion. Noise leads to
        single ones, which are averaged over ``NOW_TICKS``.
    """

    lifted_poses: Array
    moves: bool = False
    ticks_with_excess: int = 0

    @property
    def is_at_rest(self) -> bool:
        """Whether the object rests."""
        return not self.moves and self.ticks_with_excess <= NOW_TICKS

    def append(self, tick: Tick) -> "LatestMotion":
        """The motion after one more tick."""
        if not tick.count:
            return LatestMotion(self.lifted_poses)
        lifted_poses = np.concatenate([self.lifted_poses[1 - SPAN_TICKS - LASTING_TICKS :], tick.zeta[None]])
        has_excess = tick.innovation_excess != NO_EXCESS
        ticks_with_excess = self.ticks_with_excess + 1 if has_excess else 0
        return LatestMotion(lifted_poses, has_excess and is_moving(lifted_poses), ticks_with_excess)


NO_MOTION: Final = LatestMotion(np.zeros((0, 25)))


@dataclass(eq=False)
class FilterBank:
    """The filters of one stream; bounded in size, however long the stream.

    Parameters
    ----------
    model, known_map, lag_s : the requested ones; ticks of the filters may be longer.
    grid : averages poses into ticks for all filters; None before the second pose.
    filters : none before the second pose.
    log_weight, log_prior : (K,) log weights of the filters, and their prior part.
    pending : poses so far, until the other filters start with them; then None.
    moved_s : time for which the object has moved.
    motion : motion in the latest ticks.
    latest_ns : stamps of the latest poses, repeated ones included, for the rate.
    period_s : the usual time between poses, if it is known in advance: then ticks do not change.
    body_m : (3,) point of the body that is tracked, in the body frame; by the first
        ``RATIO_POSES`` where the period is not known in advance.
    map : the map from before a change of the rate; None without a change.
    earlier_outliers : outliers from before a change of the rate.
    changed_since_ns : time since which the rate does not suit the ticks; None if it does.
    rest_ticks : number of ticks with poses at rest.
    rest_activity : (K,) sum of the activity of the filters in these.
    rest_scatter : what rests have shown of the noise of a tick.
    """

    model: Model
    lag_s: float = 0.0
    known_map: Map = EMPTY_MAP
    grid: TickGrid | None = None
    filters: list[ContactFilter] = field(default_factory=list)
    log_weight: Array = field(default_factory=lambda: np.zeros(1))
    log_prior: Array = field(default_factory=lambda: np.zeros(1))
    pending: Poses | None = NO_POSES
    moved_s: float = 0.0
    motion: LatestMotion = NO_MOTION
    latest_ns: tuple[int, ...] = ()
    period_s: float | None = None
    body_m: Array = field(default_factory=ORIGIN_M.copy)
    map: GrowingMap | None = None
    earlier_outliers: Outliers = NO_OUTLIERS
    changed_since_ns: int | None = None
    rest_ticks: int = 0
    rest_activity: Array = field(default_factory=lambda: np.zeros(1))
    rest_scatter: RestScatter = NO_RESTS

    def copied(self) -> Self:
        """A copy that can be updated without changing this bank; immutable parts are shared."""
        copy = type(self)(**vars(self))  # faster than ``copy``
        copy.filters = [*map(ContactFilter, map(attrgetter("state"), self.filters))]
        copy.grid = None if self.grid is None else TickGrid(**vars(self.grid))
        return copy

    @property
    def is_decided(self) -> bool:
        """Whether one filter remains, and no other will start."""
        return self.pending is None and len(self.filters) == 1

    @property
    def best(self) -> FilterState | None:
        """The most probable filter; None before the second pose."""
        return self.filters[int(self.log_weight.argmax())].state if self.filters else None

    @property
    def outliers(self) -> Outliers:
        """Poses left out of their ticks so far."""
        return self.earlier_outliers.joined(self.filters[0].state.outliers if self.filters else NO_OUTLIERS)

    def waits(self, stamp_ns: int) -> bool:
        """Whether a pose of this time is needed at the end of the tick only, not for the rate. If so, the
        part of the next tick's work that does not depend on its poses is done now."""
        rate_is_known = self.pending is None or len(self.pending) >= RATE_POSES
        if not rate_is_known or self.grid is None or not self.grid.goes_on(stamp_ns):
            return False
        for filter_ in self.filters:
            if filter_.state.prepared_map is not filter_.state.map:
                filter_.prepare()
        return True

    def add(self, poses: Poses, detail: Detail) -> list[Belief]:
        """Add poses; returns the beliefs of the ticks that they close."""
        beliefs = self._add(poses, detail)
        self.latest_ns = (*self.latest_ns, *poses.stamp_ns[-RATE_POSES:].tolist())[-RATE_POSES:]
        if self.period_s is not None:
            return beliefs
        if self.grid is None or not self.grid.frames.stamp_ns.size:
            return beliefs
        model = with_other_ticks(self.model, self.grid.model, self.latest_ns)
        since_ns = self.latest_ns[0] if self.changed_since_ns is None else self.changed_since_ns
        self.changed_since_ns = None if model is None else since_ns
        if model is None or self.latest_ns[-1] - since_ns < LASTING_NS:
            return beliefs
        return [*beliefs, *self._restart(model, detail)]

    def pass_time(self, until_ns: int, detail: Detail) -> list[Belief]:
        """Close the ticks that are over, see ``TickGrid.pass_time``; returns their beliefs."""
        ticks = [] if self.grid is None else self.grid.pass_time(until_ns)
        return self._update(ticks, detail) if ticks else []

    def finish(self) -> list[Belief]:
        """At the end of the stream: beliefs of the last, partial tick and of the ticks within the lag.

        The stream may be continued; the time since is a gap.
        """
        beliefs = list[Belief]()
        if self.pending is not None and len(self.pending):
            if not self.filters:
                beliefs = self._start_first(Detail.FORMATION)
            self._start_others(Detail.FORMATION)
        if self.grid is None:
            return beliefs
        beliefs += self._update(self.grid.close(), Detail.FORMATION)
        return [*beliefs, *self._withheld()]

    def _withheld(self) -> Iterator[Belief]:
        """The beliefs that the lag has withheld."""
        for beliefs in zip(*(filter_.finish() for filter_ in self.filters), strict=True):
            yield mixture(beliefs, self.log_weight, self.known_map)

    def _add(self, poses: Poses, detail: Detail) -> list[Belief]:
        beliefs = list[Belief]()
        while self.pending is not None and len(poses):  # until all filters have started
            count = len(self.pending)
            enough = RATIO_POSES if count >= RATE_POSES else RATE_POSES if self.filters else FIRST_POSES
            missing = max(enough - count, 1)
            batch, poses = poses[:missing], poses[missing:]
            self.pending = Poses.join([self.pending, batch])
            if self.grid is not None:
                beliefs += self._update(self.grid.add(batch), detail)
            if len(batch) == missing and enough == RATIO_POSES:
                self._start_others(detail)
            elif len(batch) == missing:
                beliefs += self._start_first(detail)
        if self.grid is not None and poses.stamp_ns.size and (ticks := self.grid.add(poses)):
            beliefs += self._update(ticks, detail)
        return beliefs

    def _restart(self, model: Model, detail: Detail) -> list[Belief]:
        """Start again with other ticks, at the first pose of the current tick; the map is kept, and the
        beliefs within the lag are reported first."""
        withheld = [*self._withheld()]
        assert self.best is not None
        assert self.grid is not None
        assert self.grid.origins is not None
        again = FilterBank(
            self.model,
            self.lag_s,
            self.known_map,
            self.grid,
            pending=self.grid.frames,
            body_m=self.body_m,
            latest_ns=self.latest_ns,
            map=self.best.map.before_onsets(),
            earlier_outliers=self.outliers,
        )
        vars(self).update(vars(again))
        return [*withheld, *self._begin([model], detail)]

    def _start_first(self, detail: Detail) -> list[Belief]:
        """Start the filter of the given model, with ticks for the rate so far, from the first pose, unless
        it has such ticks already. Returns its beliefs after the last reported one."""
        assert self.pending is not None
        period_s = usual_period_s(self.pending.stamp_ns.tolist()) if self.period_s is None else self.period_s
        model = with_ticks_for(self.model, period_s)
        if self.grid is not None and model.tick_s == self.grid.model.tick_s:
            return []
        last = self.filters[0].reported if self.filters else None
        beliefs = self._begin([model], detail)
        return beliefs if last is None else [belief for belief in beliefs if belief.stamp_ns > last.stamp_ns]

    def _start_others(self, detail: Detail) -> None:
        """Choose the tracked point by the poses so far, and begin again with all filters."""
        assert self.pending is not None
        if self.period_s is None and self.map is None:
            self.body_m = independent_point(self.pending)
        variants = candidates(self.filters[0].state.model, self.pending.of_point(self.body_m))
        self.log_weight = self.log_prior = np.array([log_prior for _, log_prior in variants])
        assert self.grid is not None
        begin_ns = self.grid.begin_ns
        assert begin_ns is not None
        self._begin([model for model, _ in variants], detail)  # the beliefs were reported already
        for _ in range(2):  # also of ticks that were closed early, or empty
            self._update(self.grid.pass_time(begin_ns), detail)
        self.pending = None

    def _begin(self, models: Sequence[Model], detail: Detail) -> list[Belief]:
        """Begin with filters of these models at the first pending pose; the beliefs so far."""
        assert self.pending is not None
        first_ns, origins = int(self.pending.stamp_ns[0]), None if self.grid is None else self.grid.origins
        options = self.lag_s, self.known_map, FreeSpeed()
        self.filters = [ContactFilter.start(model, *options) for model in models]
        if self.map is not None and origins is not None:
            self.grid = TickGrid.start(models[0], first_ns, origins)
            for filter_ in self.filters:
                filter_.state = filter_.state._replace(map=self.map)
        else:
            self.grid = TickGrid(models[0], self.body_m)
        self.moved_s, self.motion = 0.0, NO_MOTION
        self.rest_ticks, self.rest_activity, self.rest_scatter = 0, np.zeros(len(models)), NO_RESTS
        return self._update(self.grid.add(self.pending), detail)

    def _update(self, ticks: list[Tick], detail: Detail) -> list[Belief]:
        """Update the filters by ticks; dropped filters are left out of later ticks."""
        beliefs = list[Belief]()
        for number, tick in enumerate(ticks):
            first = self.filters[0]
            if len(self.filters) == 1 and self.pending is None:  # decided
                first.update(tick, detail)
                beliefs += filter(None, [first.reported])
                continue
            beliefs += self._update_all(tick, detail)
            if self.filters[0] is not first:  # which was dropped
                assert self.grid is not None
                first = self.filters[0]
                ticks[number + 1 :] = [first.with_own_innovations(later) for later in ticks[number + 1 :]]
                self.grid.follow(first.state.model, first.state.free_motion)
        return beliefs

    def _update_all(self, tick: Tick, detail: Detail) -> list[Belief]:
        """Update all filters by a tick."""
        self.motion = self.motion.append(tick)
        best, evidence = int(self.log_weight.argmax()), list[TickEvidence]()
        # only the best looks for further contacts and curvature
        for number, filter_ in enumerate(self.filters):
            filter_detail = detail if number == best else min(detail, Detail.GEOMETRY)
            own_tick = filter_.with_own_innovations(tick) if number else tick
            before = filter_.state
            filter_.update(own_tick, filter_detail, number == best)
            evidence.append(tick_evidence(before, filter_.state))
        curved = self.filters[best].state.curved  # tested by one for all
        for filter_ in self.filters:
            if filter_.state.label is Contact.FREE:
                filter_.state = filter_.state._replace(curved=curved._replace(since=filter_.state.free_since))
        evidence = self._weigh(evidence, tick)
        beliefs = [belief for belief in (filter_.reported for filter_ in self.filters) if belief is not None]
        if not beliefs:  # all have the same lag
            return []
        activity = np.array([tick.activity for tick in evidence])
        log_weight = self.log_weight - (0.0 if self.motion.moves else REST_NATS) * activity
        return [mixture(beliefs, log_weight, self.known_map)]

    def _weigh(self, evidence: list[TickEvidence], tick: Tick) -> list[TickEvidence]:
        """Weigh the filters by their evidence of a tick, if the object moves in it, or else by what they take
        for motion; returns the evidence of the filters that are kept."""
        if len(evidence) == 1:
            return evidence
        log_weight = self.log_weight
        if self.motion.moves:
            model = self.filters[0].state.model
            log_weight = log_weight + relative_evidence(evidence, model.motion)
            self.moved_s += model.tick_s
            exact_rad = self.model.noise.contact_rotation_rad
            noises = (filter_.state.model.noise for filter_ in self.filters)
            is_loose = [noise.contact_rotation_rad != exact_rad for noise in noises]
            price = LOG_PRIOR_TOLERANCE * np.array(is_loose)
            is_kept = are_kept(log_weight, self.log_prior, self.moved_s, price)
        else:
            self.rest_ticks += tick.count > 0
            self.rest_activity = self.rest_activity + [tick.activity for tick in evidence]
            is_kept = np.ones(len(evidence), np.bool_)
        assert self.grid is not None
        assert self.grid.stream is not None
        is_exact = self.grid.stream.noise.sigma_position_m <= NOISY_M  # or looks so by a filter
        is_calm = are_calm(self.rest_activity, self.rest_ticks, may_be_filtered=is_exact)
        self.rest_scatter = self.rest_scatter.append(tick, self.motion.moves)
        models = [filter_.state.model for filter_ in self.filters]
        variances = [tick_variances(tick.noise, np.array(float(tick.count)), model) for model in models]
        # errors that vary over the volume do not show at rest
        is_correlated = np.array([model.correlation > 0.0 for model in models])
        is_calm &= is_correlated | self.rest_scatter.allows(np.array(variances))
        if (is_calm & is_kept).any():
            is_kept &= is_calm
        kept = np.flatnonzero(is_kept)
        self.filters = [self.filters[i] for i in kept]
        self.log_weight = log_weight[kept] - log_weight[kept].max()
        self.log_prior, self.rest_activity = self.log_prior[kept], self.rest_activity[kept]
        return [evidence[i] for i in kept]


class Report(NamedTuple):
    """The requested ``model`` and the one ``chosen``, whether the choice ``is_decided``; standard deviations
    (m, rad) of the ``noise`` of a pose, as estimated or given, of a ``tick``, and of ``lasting`` errors,
    correlated over ticks; the usual ``poses_per_tick``, repeated ones included; the ``findings``.
    ``point_m`` (3,): point of the body that is tracked, to which these belong. ``is_cut_short``: a longer
    stream could decide the choice. ``map_use``: how a learned map is used, in words. ``moved_s``: time (s)
    in motion."""

    model: Model
    chosen: Model
    is_decided: bool
    noise: tuple[float, float]
    tick: tuple[float, float]
    lasting: tuple[float, float]
    poses_per_tick: float
    findings: tuple[Finding, ...]
    point_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    is_cut_short: bool = False
    map_use: str = ""
    moved_s: float = 0.0


def map_use(world: GrowingMap, known_map: Map) -> str:
    """How many contacts touch elements of the map of another recording, in words; empty without one, and if
    it explains no contact (``map_findings``)."""
    if not known_map.learned or len(world.unused_sides) == 2:
        return ""
    body, environment = (
        sum(pair[side] in world.prior.touched for pair in world.pairs.values()) for side in (0, 1)
    )
    touches = f"{body} touch its elements of the object, {environment} those of the surroundings"
    return f"the learned map is used: of {len(world.pairs)} sure contacts {touches}"


def map_findings(world: GrowingMap, known_map: Map) -> tuple[Finding, ...]:
    """Sides on which the map of another recording explains no contact."""
    if not world.unused_sides or not known_map.learned:
        return ()
    what, of = {
        (0,): ("what the learned map has of the object", "object"),
        (1,): ("what the learned map has of the surroundings", "place and this frame"),
        (0, 1): ("the learned map", "object and this frame"),
    }[world.unused_sides]
    return (Finding("map", f"{what} explains no contact: is it of this {of}?", False),)


def report_of(filters: FilterBank, is_decided: bool, findings: tuple[Finding, ...]) -> Report | None:
    """The report of a stream, and of its map; None before the second pose."""
    best = filters.best
    if best is None or filters.grid is None or filters.grid.stream is None:
        return None
    frames, chosen, estimate = filters.filters[0].state.window.frames, best.model, filters.grid.stream.noise
    typical = 1.0 if frames is None or not len(frames) else float(np.median(frames))
    tick = tuple(np.sqrt(white_variances(estimate, np.array(typical), chosen)).tolist())
    share = chosen.noise.estimate_share
    noise = share * estimate.sigma_position_m, share * estimate.sigma_rotation_rad
    lasting = chosen.noise.wander_position_m, chosen.noise.wander_rotation_rad
    findings = (*findings, *map_findings(best.map, filters.known_map))
    # at rest poses may repeat, and repeated ones do not lower the noise of a tick
    period_s = usual_period_s(filters.latest_ns)
    many = max(typical, chosen.tick_s / period_s) if period_s else typical
    figures, point_m = (noise, tick, lasting, many), tuple(filters.body_m.tolist())
    use = map_use(best.map, filters.known_map)
    return Report(
        filters.model, chosen, is_decided, *figures, findings, point_m, map_use=use, moved_s=filters.moved_s
    )
