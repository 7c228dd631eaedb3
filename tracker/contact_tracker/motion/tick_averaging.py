"""From frames to ticks: outliers are gated, the others averaged as lifted poses, and the sensor noise and the
free-motion filter updated."""

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Origins
from contact_tracker.geometry.lifted_pose import R, T, mean_lift
from contact_tracker.geometry.linalg import between, rotation_vectors
from contact_tracker.motion import free_motion, sensor_noise
from contact_tracker.motion.free_motion import NO_EXCESS, FreeMotion, InnovationExcess
from contact_tracker.motion.poses import NO_OUTLIERS, NO_POSES, Outliers, Poses
from contact_tracker.motion.sensor_noise import NoiseBuffer, NoiseEstimate

NEIGHBOURS: Final = 5
NOISY_M: Final = 2e-5
"""Poses with more noise do not repeat by chance or by rounding; others are exact, as those of encoders."""
RECENT_FRAMES: Final = 8
"""Number of the latest poses, without repeated ones, that show whether the object came to rest."""
CAME_TO_REST: Final = 0.5
"""It did if it was at last at most as fast as this share of its largest speed among these."""
_EYE: Final = np.eye(3)


@dataclass(frozen=True, eq=False)
class Tick:
    """The mean of the frames of one tick."""

    start_ns: int
    """Stamp of its first frame."""
    stamp_ns: int
    """Stamp of its last frame."""
    mean_ns: int
    """Mean of the stamps of the frames used."""
    zeta: Array
    """(25,) mean lifted pose, of the point ``origins.body_m``; the world's origin is at the first one."""
    count: int
    """Number of frames used; 0 in a gap."""
    outliers: Outliers
    """Frames left out."""
    innovation_excess: InnovationExcess
    """Innovation excess of free motion."""
    noise: NoiseEstimate
    """Noise of one frame, as estimated after the tick."""
    origins: Origins
    """Origins of the lifted poses in the world and in the body frame."""
    is_rest: bool = False
    """Whether it is the remainder of a tick that was closed early. It does not count for the strength of
    motion, since it is not a whole tick away from its neighbours."""


class StreamState(NamedTuple):
    """Estimates of the stream after the ticks so far."""

    noise: NoiseEstimate
    noise_buffer: NoiseBuffer
    """Data of the noise estimate."""
    free_motion: FreeMotion | None
    """None if the next tick does not follow the last one."""
    recent_frames: Poses
    """The latest frames without repeated ones."""


def empty_tick(last: Tick, start_ns: int, stamp_ns: int, is_rest: bool = False) -> Tick:
    """A tick without frames, after ``last``."""
    return replace(
        last,
        start_ns=start_ns,
        stamp_ns=stamp_ns,
        count=0,
        outliers=NO_OUTLIERS,
        innovation_excess=NO_EXCESS,
        is_rest=is_rest,
    )


def _average_tick(
    stream: StreamState, frames: Poses, new: NDArray[np.bool_], origins: Origins, model: Model, is_rest: bool
) -> tuple[StreamState, Tick]:
    """One tick from its frames that are ``new``; without any, from the repeated pose."""
    start_ns, stamp_ns, noise = int(frames.stamp_ns[0]), int(frames.stamp_ns[-1]), stream.noise
    if not new.all():
        frames = frames[new] if new.any() else frames[:1]
    sigma_sq = np.array([noise.sigma_position_m, noise.sigma_rotation_rad]) ** 2
    plausible = _plausible(frames, stream.free_motion, origins.world_m, sigma_sq, model)
    outliers, used = NO_OUTLIERS, frames
    if not plausible.all():
        outliers, used = Outliers.at(frames.stamp_ns[~plausible]), frames[plausible]
    buffer, estimate = stream.noise_buffer, noise
    if model.noise.estimated:
        prior = model.noise.sigma_position_m, model.noise.sigma_rotation_rad
        # outliers do not count as noise, unless most frames are outliers
        typical = used if 2 * outliers.total < plausible.size else frames
        buffer, estimate = sensor_noise.advance(buffer, estimate, typical, prior)
    zeta = mean_lift(used.rotation, used.position_m - origins.world_m)
    mean_ns = int(used.stamp_ns[0]) + round(float((used.stamp_ns - used.stamp_ns[0]).mean()))
    counts, stamps_ns = (plausible.size - outliers.total, outliers), (start_ns, stamp_ns, mean_ns)
    tick = Tick(*stamps_ns, zeta, *counts, NO_EXCESS, estimate, origins, is_rest)
    motion, tick = with_excess(stream.free_motion, tick, model)
    return stream._replace(noise=estimate, noise_buffer=buffer, free_motion=motion), tick


def _is_stuck(held: Poses, stream: StreamState, model: Model) -> bool:
    """Whether a pose that repeats through a tick is stuck, not measured: the sensor is too noisy to measure
    the same twice, or the object was moving."""
    if stream.noise_buffer.differences.shape[1] and stream.noise.sigma_position_m > NOISY_M:
        return True
    motion = stream.free_motion
    if motion is None or not motion.is_settled or _came_to_rest(stream.recent_frames):
        return False
    variance = tick_variances(stream.noise, np.array(1.0), model)
    return free_motion.moves_on(motion, int(held.stamp_ns[0]), variance)


def _came_to_rest(frames: Poses) -> bool:
    """Whether the object slowed down in its last frames that differ, as it does before it rests: it is not
    stuck, even if free motion would go on."""
    frames = frames[-RECENT_FRAMES:]
    steps = _deviations(frames[1:], frames.position_m[:-1], frames.quat_xyzw[:-1]).reshape(-1, 2, 3)
    speed = np.linalg.norm(steps, axis=2) / np.diff(frames.stamp_ns)[:, None]
    return len(speed) > 1 and bool((speed[-1] <= CAME_TO_REST * speed.max(axis=0)).all())


def with_excess(motion: FreeMotion | None, tick: Tick, model: Model) -> tuple[FreeMotion | None, Tick]:
    """Advance the free-motion filter by a tick; returns it and the tick with its innovation excess."""
    motion = None if tick.is_rest else motion
    if not tick.count:
        return motion, tick
    turn, position_m = tick.zeta[R].reshape(3, 3), tick.zeta[T]
    if motion is None or not free_motion.can_go_on(motion, tick.mean_ns):
        assumed = model.motion.initial_autocorrelation
        return None if tick.is_rest else free_motion.begin(turn, position_m, tick.mean_ns, assumed), tick
    white = white_variances(tick.noise, np.array(float(tick.count)), model)
    variance = innovation_variances(white, model) if model.correlation else white
    # half of the variance of the step from a tick to the next while the object rests
    rest = white + 0.5 * (1.0 - model.correlation**2) * np.array(model.noise.wander_variance)
    motion, excess = free_motion.advance(
        motion, turn, position_m, variance, rest, tick.mean_ns, model.tick_s, model.motion.error_memory_s
    )
    return motion, replace(tick, innovation_excess=excess)


def tick_variances(estimate: NoiseEstimate, count: Array, model: Model) -> Array:
    """Noise variances (..., 2) per axis (m^2, rad^2) of the means of ticks with ``count`` (...) frames."""
    white = white_variances(estimate, count, model)
    return innovation_variances(white, model) if model.correlation else white


def innovation_variances(white: Array, model: Model) -> Array:
    """The variances (..., 2) of ticks with ``white`` noise and errors that are correlated between ticks: of
    their innovation, ``correlation`` times the tick before subtracted."""
    rho, wander = model.correlation, np.array(model.noise.wander_variance)
    return np.asarray(white * (1.0 + rho**2) + wander * (1.0 - rho**2))


def white_variances(estimate: NoiseEstimate, count: Array, model: Model) -> Array:
    """``tick_variances`` without the correlated errors: noise of a frame, which averaging reduces, and the
    floor, which it does not."""
    share, noise = model.noise.estimate_share, model.noise
    sensor = (share * estimate.sigma_position_m) ** 2, (share * estimate.sigma_rotation_rad) ** 2
    parts = np.empty((*count.shape, 2))
    parts[..., 0], parts[..., 1] = 1.0 / np.maximum(count, 1.0), 1.0
    # for so few columns faster than sums of arrays, and than ``@``
    floor = noise.floor_position_m**2, noise.floor_rotation_rad**2
    return np.asarray(np.dot(parts, np.array([sensor, floor])))


def tick_anisotropy(estimate: NoiseEstimate, count: Array, model: Model) -> Array:
    """Anisotropic part (W, 3, 3), in m^2 and the world's axes, of the covariance of the mean position of
    ticks with ``count`` (W,) frames: the covariance minus its mean over the axes."""
    covariance = estimate.position_m2
    anisotropic = covariance - _EYE * (covariance.trace() / 3.0)
    share = model.noise.estimate_share**2 / np.maximum(count, 1.0)
    return np.asarray(np.dot(share[:, None], anisotropic.reshape(1, 9))).reshape(-1, 3, 3)


def _plausible(
    frames: Poses,
    motion: FreeMotion | None,
    origin_m: Array,
    sigma_sq: Array,
    model: Model,
) -> NDArray[np.bool_]:
    """Gate the frames of a tick: those near the other frames, relative to free motion, and not far from the
    predicted motion, with noise ``sigma_sq`` (2,).

    Without a prediction, at the start and just after a gap, frames are compared by their steps. If all frames
    are implausible, the object has jumped: all are taken.
    """
    count = frames.stamp_ns.size
    everything = np.ones(count, bool)
    is_predicted = motion is not None and free_motion.is_predictable(
        motion, int(frames.stamp_ns[0]), model.tick_s
    )
    if motion is not None and is_predicted:
        at, facing = free_motion.predicted(motion, (frames.stamp_ns - motion.stamp_ns) / 1e9)
        deviation, spread = _deviations(frames, at + origin_m, facing), motion.spread
    elif count >= NEIGHBOURS:
        deviation, spread = _deviations(frames, frames.position_m[0], frames.quat_xyzw[0]), np.zeros(2)
    else:
        return everything
    allowed_sq = sigma_sq + spread
    if count >= 3:  # frames are compared with their neighbours, between which there is little motion
        width = min(NEIGHBOURS, count - 1 + count % 2)
        allowed_sq = sigma_sq + spread * ((min(NEIGHBOURS, count) - 1) / count) ** 2
        if count == NEIGHBOURS or sigma_sq[0] < NOISY_M**2 or not is_predicted:
            beside = _lacks_neighbours(count, width) if is_predicted else everything
            step_sq = _step_sq(deviation) - 5.0 * sigma_sq  # of two poses, in three axes
            allowed_sq = np.where(beside[:, None], np.maximum(allowed_sq, step_sq), allowed_sq)
        deviation = deviation - _local_median(deviation, width)
    distance_sq = (deviation * deviation).reshape(-1, 2, 3).sum(axis=2)
    plausible = (distance_sq < model.noise.outlier_sigmas**2 * allowed_sq).all(axis=1)
    return np.asarray(plausible if plausible.any() else everything)


def _deviations(frames: Poses, position_m: Array, quat_xyzw: Array) -> Array:
    """Differences (N, 6) of frames from one or N poses: position, and rotation vector in the body's axes."""
    turn = rotation_vectors(between(quat_xyzw, frames.quat_xyzw))
    return np.concatenate([frames.position_m - position_m, turn], axis=1)


def _step_sq(rows: Array) -> Array:
    """Squared steps (2,) of position and rotation between rows (N, 6): the largest of the smaller half, so
    that a row that is wrong does not count."""
    steps = np.square(np.diff(rows, axis=0)).reshape(-1, 2, 3).sum(axis=2)
    half = max(len(steps) // 2 - 1, 0)
    return np.asarray(np.partition(steps, half, axis=0)[half])


def _lacks_neighbours(count: int, width: int) -> NDArray[np.bool_]:
    """Which of the rows (N,) are so near to an end that most of the ``width`` rows of their median are on
    one side, a step or two away."""
    at, half = np.arange(count), width // 2
    return np.asarray((at < half) | (at >= count - half))


def _local_median(rows: Array, width: int) -> Array:
    """Median over the ``width`` rows around each row."""
    count = len(rows)
    windows = rows[np.arange(width)[:, None] + np.arange(count - width + 1)]
    windows.partition(width // 2, axis=0)
    return np.asarray(windows[width // 2].take(np.arange(count) - width // 2, axis=0, mode="clip"))


LONGEST_GAP_S: Final = 5.0
"""A gap in the stream is filled with empty ticks up to this time; a longer rest is skipped."""
ORIGIN_M: Final = np.zeros(3)
EMPTY_TICKS: Final = 1000
EMPTY_PER_TICK: Final = 10
"""Gaps are filled with ``EMPTY_TICKS`` empty ticks in any case, and with this many more for each tick with
frames: a small file can have thousands of gaps."""


@dataclass(eq=False)
class TickGrid:
    """Averages poses into ticks; its time and the world's origin begin at the first pose.

    Parameters
    ----------
    model : has the length of a tick, and the noise of the filter whose free motion gates frames.
    body_m : (3,) point of the body that is tracked, in the body frame.
    begin_ns : when the current tick begins; ``frames`` are its poses so far.
    origins : origins of the ticks' coordinates; like ``begin_ns`` None before the first pose.
    number : number of the current tick.
    last : the tick before it.
    stream : estimates of the stream.
    empty : number of empty ticks before it.
    """

    model: Model
    body_m: Array = field(default_factory=ORIGIN_M.copy)
    begin_ns: int | None = None
    origins: Origins | None = None
    number: int = 0
    frames: Poses = field(default_factory=lambda: NO_POSES)
    last: Tick | None = None
    stream: StreamState | None = None
    empty: int = 0

    @classmethod
    def start(cls, model: Model, begin_ns: int, origins: Origins) -> "TickGrid":
        """A grid that begins at this time, with these origins of its coordinates."""
        estimate = sensor_noise.begin(model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
        learnt = StreamState(estimate, sensor_noise.EMPTY_BUFFER, None, NO_POSES)
        return cls(model, origins.body_m, begin_ns, origins, stream=learnt)

    def goes_on(self, stamp_ns: int) -> bool:
        """Whether a pose belongs to the current tick."""
        return self.begin_ns is not None and stamp_ns < self.begin_ns + self.model.tick_ns

    def is_late(self, stamp_ns: int) -> bool:
        """Whether a pose is more than a tick before the current one, or before its end if it was closed
        early."""
        if self.begin_ns is None or stamp_ns >= self.begin_ns:
            return False
        return self._has_closed_early or stamp_ns < self.begin_ns - self.model.tick_ns

    def add(self, poses: Poses) -> list[Tick]:
        """Add one pose or more; returns the ticks that they close, several after a gap."""
        if self.begin_ns is None:
            origins = Origins(poses[:1].of_point(self.body_m).position_m[0].copy(), self.body_m)
            grid = TickGrid.start(self.model, int(poses.stamp_ns[0]), origins)
            vars(self).update(vars(grid))
        assert self.begin_ns is not None
        closed = list[Tick]()
        poses = Poses.join((self.frames, poses)) if self.frames.stamp_ns.size else poses
        while not self.goes_on(int(poses.stamp_ns.max())):
            first_ns = int(poses.stamp_ns[0])
            if not self.goes_on(first_ns):
                closed += self._pass_to(first_ns, bool(closed) or self._has_closed_early)
                continue
            end = int((poses.stamp_ns >= self.begin_ns + self.model.tick_ns).argmax())  # they stay closed
            closed.append(self._close(poses[:end]))
            poses = poses[end:]
        self.frames = poses
        return closed

    def pass_time(self, until_ns: int) -> list[Tick]:
        """Close the current tick if it ends by this time, or, where no poses come, all ticks that do.

        Later poses in the time of closed ticks will be in the next one.
        """
        has_frames = self.frames.stamp_ns.size > 0
        if self.goes_on(until_ns) or (self.last is None and not has_frames):
            return []
        if has_frames:
            assert self.begin_ns is not None
            closed, self.frames = [self._close(self.frames)], NO_POSES
            self.begin_ns, self.number = self.begin_ns + self.model.tick_ns, self.number + 1
            return closed
        return self._pass_to(until_ns, self._has_closed_early)

    def close(self) -> list[Tick]:
        """Close the current tick early, if it has poses; later poses in its time will form another tick."""
        frames, self.frames = self.frames, NO_POSES
        return [self._close(frames)] if frames.stamp_ns.size else []

    def follow(self, model: Model, motion: FreeMotion | None) -> None:
        """Gate frames by the free motion of another filter from now on."""
        assert self.stream is not None
        self.model, self.stream = model, self.stream._replace(free_motion=motion)

    def _close(self, frames: Poses) -> Tick:
        """Close the current tick, which has these poses."""
        assert self.origins is not None
        assert self.stream is not None
        stream, is_rest = self.stream, self._has_closed_early
        if self.body_m.any():
            frames = frames.of_point(self.body_m)
        if is_rest:
            stream = stream._replace(free_motion=None)
        new = frames.differ_from(stream.recent_frames)
        if self.last is not None and not new.any() and _is_stuck(frames, stream, self.model):
            tick = empty_tick(self.last, int(frames.stamp_ns[0]), int(frames.stamp_ns[-1]), is_rest)
        else:
            stream, tick = _average_tick(stream, frames, new, self.origins, self.model, is_rest)
        if len(new) < RECENT_FRAMES or not new.all():
            frames = Poses.join((stream.recent_frames, frames[new]))[-RECENT_FRAMES:]
        self.stream, self.last = stream._replace(recent_frames=frames), tick
        return tick

    @property
    def _has_closed_early(self) -> bool:
        """Whether the current tick is the remainder of a tick that was closed early."""
        return self.last is not None and self.begin_ns is not None and self.last.stamp_ns >= self.begin_ns

    def _pass_to(self, stamp_ns: int, is_closed: bool) -> list[Tick]:
        """Go to the tick of this time, with empty ticks for a gap of the stream; ``is_closed`` says whether
        the current one is."""
        assert self.begin_ns is not None
        last_number, step_ns = self.number - (not is_closed), self.model.tick_ns
        number = self.number + (stamp_ns - self.begin_ns) // step_ns
        missed = max(min(number - last_number, int(LONGEST_GAP_S / self.model.tick_s)) - 1, 0)
        missed = min(missed, max(EMPTY_TICKS + EMPTY_PER_TICK * (last_number - self.empty) - self.empty, 0))
        empty = list[Tick]()
        if missed:
            assert self.last is not None
            stamps = [self.last.stamp_ns + (i + 1) * step_ns for i in range(missed)]
            empty = [empty_tick(self.last, stamp, stamp) for stamp in stamps]
            self.last = empty[-1]
        begin_ns = self.begin_ns + (number - self.number) * step_ns
        if number - last_number - 1 > missed:  # skip the rest of a long gap
            number, begin_ns = last_number + 1 + missed, stamp_ns
        self.begin_ns, self.number, self.empty = begin_ns, number, self.empty + missed
        return empty
