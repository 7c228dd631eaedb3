"""The grid of ticks: short spans of time, counted from the first pose."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.geometry.elements import Origins
from contact_tracker.motion import sensor_noise
from contact_tracker.motion.free_motion import FreeMotion
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.motion.tick_averaging import (
    Array,
    StreamState,
    Tick,
    TickRun,
    average_run,
    empty_tick,
)

LONGEST_GAP_S: Final = 5.0
"""A gap in the stream is filled with empty ticks up to this time; a longer rest is skipped."""
ORIGIN_M: Final = np.zeros(3)
EMPTY_TICKS: Final = 1000
EMPTY_PER_TICK: Final = 10
"""Gaps are filled with so many empty ticks in any case, and with so many for each tick with frames: a small
file can have thousands of gaps."""


@dataclass(eq=False)
class TickGrid:
    """Averages poses into ticks; its time and the world's origin begin at the first pose.

    Parameters
    ----------
    model : has the length of a tick, and the noise of the filter whose free motion gates frames.
    body_m : (3,) point of the body that is tracked, in the body frame.
    origin_ns, origins : time of the first pose, and origins of the ticks' coordinates; None before it.
    number : of the current tick on the grid; ``frames`` are its poses so far.
    last : the tick before it.
    stream : estimates of the stream.
    empty : how many ticks before it were empty.
    """

    model: Model
    body_m: Array = field(default_factory=ORIGIN_M.copy)
    origin_ns: int | None = None
    origins: Origins | None = None
    number: int = 0
    frames: Poses = field(default_factory=lambda: NO_POSES)
    last: Tick | None = None
    stream: StreamState | None = None
    empty: int = 0

    @classmethod
    def begun(cls, model: Model, origin_ns: int, origins: Origins) -> "TickGrid":
        """A grid that begins at this time, with these origins of its coordinates."""
        estimate = sensor_noise.begin(model.noise.sigma_position_m, model.noise.sigma_rotation_rad)
        learnt = StreamState(estimate, sensor_noise.EMPTY_BUFFER, None, NO_POSES)
        return cls(model, origins.body_m, origin_ns, origins, stream=learnt)

    def goes_on(self, stamp_ns: int) -> bool:
        """Whether a pose belongs to the current tick."""
        return self.origin_ns is not None and (
            stamp_ns < self.origin_ns + (self.number + 1) * self.model.tick_ns
        )

    def is_late(self, stamp_ns: int) -> bool:
        """Whether a pose is more than a tick before the current one, or before its end if it was closed
        early."""
        if self.origin_ns is None:
            return False
        begin_ns = self.origin_ns + self.number * self.model.tick_ns
        return stamp_ns < begin_ns and (self._has_closed_early or stamp_ns < begin_ns - self.model.tick_ns)

    def add(self, poses: Poses) -> list[Tick]:
        """Add one pose or more; returns the ticks that they close, several after a gap."""
        if self.origin_ns is None:
            origins = Origins(poses[:1].of_point(self.body_m).position_m[0].copy(), self.body_m)
            begun = TickGrid.begun(self.model, int(poses.stamp_ns[0]), origins)
            vars(self).update(vars(begun))
        assert self.origin_ns is not None
        left, closed = Poses.join((self.frames, poses)) if self.frames.stamp_ns.size else poses, list[Tick]()
        while not self.goes_on(int(left.stamp_ns.max())):
            first_ns = int(left.stamp_ns[0])
            if not self.goes_on(first_ns):
                closed += self._pass_to(first_ns, bool(closed) or self._has_closed_early)
                continue
            number = (left.stamp_ns - self.origin_ns) // self.model.tick_ns
            number = np.maximum.accumulate(np.maximum(number, self.number))  # closed ticks stay closed
            ends = np.flatnonzero(number[1:] > number[:-1]) + 1
            follows = number[ends - 1] == self.number + np.arange(len(ends))
            many = len(ends) if follows.all() else int(follows.argmin())
            closed += self._close(left, ends[:many])
            left = left[int(ends[many - 1]) :]
        self.frames = left
        return closed

    def pass_time(self, until_ns: int) -> list[Tick]:
        """Close the current tick if it ends by this time, or, where no poses come, all ticks that do.

        Later poses in the time of closed ticks will be in the next one.
        """
        has_frames = self.frames.stamp_ns.size > 0
        if self.goes_on(until_ns) or (self.last is None and not has_frames):
            return []
        if has_frames:
            closed = self.close()
            self.number += 1
            return closed
        return self._pass_to(until_ns, self._has_closed_early)

    def close(self) -> list[Tick]:
        """Close the current tick early, if it has poses; later poses in its time will form another tick."""
        frames, self.frames = self.frames, NO_POSES
        return self._close(frames, np.array([count])) if (count := frames.stamp_ns.size) else []

    def follow(self, model: Model, motion: FreeMotion | None) -> None:
        """Gate frames by the free motion of another filter from now on."""
        assert self.stream is not None
        self.model, self.stream = model, self.stream._replace(free_motion=motion)

    def _close(self, frames: Poses, ends: NDArray[np.int64]) -> list[Tick]:
        """Close the current tick and those that follow without a gap, see ``TickRun``."""
        assert self.origins is not None
        assert self.stream is not None
        run = TickRun(frames.of_point(self.body_m), ends, self.origins, self._has_closed_early, self.last)
        self.stream, closed = average_run(self.stream, run, self.model)
        self.number, self.last = self.number + len(ends) - 1, closed[-1]
        return closed

    @property
    def _has_closed_early(self) -> bool:
        """Whether the current tick is the rest of one that was closed early."""
        if self.last is None or self.origin_ns is None:
            return False
        return self.last.stamp_ns >= self.origin_ns + self.number * self.model.tick_ns

    def _pass_to(self, stamp_ns: int, is_closed: bool) -> list[Tick]:
        """Go to the tick of this time, with empty ticks for a gap of the stream; ``is_closed`` says whether
        the current one is."""
        assert self.origin_ns is not None
        before, step_ns = self.number - (not is_closed), self.model.tick_ns
        number = (stamp_ns - self.origin_ns) // step_ns
        missed = max(min(number - before, int(LONGEST_GAP_S / self.model.tick_s)) - 1, 0)
        missed = min(missed, max(EMPTY_TICKS + EMPTY_PER_TICK * (before - self.empty) - self.empty, 0))
        empty = list[Tick]()
        if missed:
            assert self.last is not None
            stamps = [self.last.stamp_ns + (i + 1) * step_ns for i in range(missed)]
            empty = [empty_tick(self.last, stamp, stamp) for stamp in stamps]
            self.last = empty[-1]
        if number - before - 1 > missed:  # skip the rest of a long gap
            number = before + 1 + missed
            self.origin_ns = stamp_ns - number * step_ns
        self.number, self.empty = number, self.empty + missed
        return empty
