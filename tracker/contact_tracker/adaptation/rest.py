"""Rest of the object, as found by the first of several trackers, during which the others wait.

The first tracker usually has the least noise: where it finds no motion the others find none, and would only
append such ticks to their windows. Where another has less, as in slow streams, that one takes the noise of
any rest for motion: there the others wait in gaps, and once the object has not gone anywhere for longer.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.free_motion import LONGEST_COAST_S, NO_EXCESS, NOW_TICKS
from contact_tracker.motion.lifted_pose import R, T
from contact_tracker.motion.tick_averaging import Tick

Array = NDArray[np.float64]

SPAN_TICKS: Final = 5
DISPLACEMENT_RATIO: Final = 4.0
"""There is motion if the squared displacement over ``SPAN_TICKS`` ticks exceeds that of noise by this
factor."""
LASTING_TICKS: Final = 3
"""Number of consecutive ticks in which it must; noise does so once, but seldom three times."""
REST_S: Final = LONGEST_COAST_S
"""Time without motion after which the other trackers wait. After a gap of that length the filters of free
motion start again in any case."""
LONG_REST_S: Final = 10.0
"""Time without displacement after which they wait in slow streams, whatever they take for motion."""
KEPT_TICKS: Final = 20
"""Number of the latest ticks that the other trackers take in when the object moves again: enough for their
filters of free motion to settle before."""


class Rest(NamedTuple):
    """Whether the object rests in the latest tick, and what the waiting trackers have missed.

    Parameters
    ----------
    lifted_poses : (n, 25) zeta of the latest ticks with frames.
    moves : whether the newest has frames and unpredictable motion, and the object moves in it.
    ticks_at_rest : number of ticks since the last motion.
    ticks_in_place : number of ticks since the last displacement beyond the noise, as the poses show it.
    ticks_with_excess : number of consecutive ticks with frames in which some tracker may find motion. Noise
        leads to single ones, which are averaged over ``NOW_TICKS``.
    waiting_since_ns : stamp of the tick since which the trackers but the first wait; None if they do not.
    skipped, outliers : number of ticks, and of the outliers in them, that these will not take in.
    kept : ticks after those, which they will take in.
    """

    lifted_poses: Array
    moves: bool = False
    ticks_at_rest: int = 0
    ticks_in_place: int = 0
    ticks_with_excess: int = 0
    waiting_since_ns: int | None = None
    skipped: int = 0
    outliers: int = 0
    kept: tuple[Tick, ...] = ()

    @property
    def is_waiting(self) -> bool:
        """Whether the trackers but the first wait."""
        return self.waiting_since_ns is not None

    def goes_on(self, before: "Rest") -> bool:
        """Whether the trackers have been waiting since ``before``."""
        return self.is_waiting and self.waiting_since_ns == before.waiting_since_ns

    def caught_up(self) -> "Rest":
        """The same, after the waiting trackers have taken in all ticks."""
        return self._replace(skipped=0, outliers=0, kept=())

    def restarted(self) -> "Rest":
        """The latest poses only: no rest so far."""
        return Rest(self.lifted_poses, self.moves)

    def lasts(self, tick_s: float, is_quietest: bool) -> bool:
        """Whether the object has rested for long enough for the others to wait, see ``advance``."""
        in_place_s = 0.0 if is_quietest else self.ticks_in_place * tick_s
        is_long = self.ticks_at_rest * tick_s > REST_S or in_place_s > LONG_REST_S
        return is_long and max(self.ticks_at_rest, self.ticks_in_place) >= SPAN_TICKS + LASTING_TICKS


NO_REST: Final = Rest(np.zeros((0, 25)))


def advance(rest: Rest, tick: Tick, tick_s: float, can_wait: bool, is_quietest: bool) -> Rest:
    """Advance by a tick of the first tracker.

    Parameters
    ----------
    tick_s : length of a tick.
    can_wait : whether other trackers may wait at all.
    is_quietest : whether the first tracker has the least noise; otherwise the others wait in gaps, and after
        ``LONG_REST_S``.
    """
    lifted_poses, ticks_with_excess = rest.lifted_poses, rest.ticks_with_excess
    if tick.count:
        lifted_poses = np.concatenate([lifted_poses[1 - SPAN_TICKS - LASTING_TICKS :], tick.zeta[None]])
        may_move = tick.innovation_excess != NO_EXCESS or not is_quietest
        ticks_with_excess = ticks_with_excess + 1 if may_move else 0
    is_displaced = bool(tick.count) and is_moving(lifted_poses)
    moves = is_displaced and tick.innovation_excess != NO_EXCESS
    ticks_at_rest = 0 if moves or (tick.count and ticks_with_excess > NOW_TICKS) else rest.ticks_at_rest + 1
    ticks_in_place = 0 if is_displaced else rest.ticks_in_place + 1
    now = Rest(lifted_poses, moves, ticks_at_rest, ticks_in_place, ticks_with_excess)
    if not can_wait or not now.lasts(tick_s, is_quietest):
        return now
    if not rest.is_waiting:
        return now._replace(waiting_since_ns=tick.stamp_ns)
    return _missed(rest, tick, now._replace(waiting_since_ns=rest.waiting_since_ns))


def _missed(before: Rest, tick: Tick, now: Rest) -> Rest:
    """With a tick that the waiting trackers miss; they will take in the latest, from one with frames on."""
    kept, skipped, outliers = [*before.kept, tick], before.skipped, before.outliers
    while len(kept) > KEPT_TICKS or (kept and not kept[0].count):
        outliers += kept.pop(0).outliers
        skipped += 1
    return now._replace(kept=tuple(kept), skipped=skipped, outliers=outliers)


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
    if len(steps_sq) < 2:
        return False
    return float(((values[-1] - values[0]) ** 2).sum()) > DISPLACEMENT_RATIO * float(steps_sq.mean())
