"""Ticks of a recording for calibration, independent of hypotheses: their motion and their true states."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.ground_truth import Truth
from contact_tracker.motion import tick_grid
from contact_tracker.motion.poses import Pose, batches
from contact_tracker.motion.tick_averaging import Tick, tick_variances
from contact_tracker.motion.tick_grid import TickState
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

UNKNOWN: Final = -1
MOVING: Final = 0.5
"""Activity above which a tick counts as motion."""


@dataclass(frozen=True, eq=False)
class Observed:
    """T ticks.

    ``middle_ns`` (T,); ``window`` of them all, whose variances are those of the sensor only, from the noise
    ``sigma_position_m``, ``sigma_rotation_rad`` of the whole stream; ``activity`` (T,) as in the tracker.
    """

    middle_ns: Ints
    window: Window
    activity: Array
    sigma_position_m: float
    sigma_rotation_rad: float


def observe(poses: Iterable[Pose], model: Model) -> Observed | None:
    """Average poses into ticks as the tracker does; None without poses."""
    state: TickState | None = None
    closed: list[Tick] = []
    for some in batches(poses):
        state = tick_grid.begin(model, some) if state is None else state
        state, done = tick_grid.advance(state, some, model)
        closed += done
    if state is None:
        return None
    if state.frames:
        state, last = tick_grid.close(state, model)
        closed.append(last)
    count = np.maximum([float(tick.count) for tick in closed], 1.0)
    sigma = np.array([closed[-1].noise.sigma_position_m, closed[-1].noise.sigma_rotation_rad])
    window = Window(
        np.arange(len(closed)),
        np.array([tick.zeta for tick in closed]),
        sigma**2 / count[:, None],
        np.array([tick.innovation_excess for tick in closed]),
    )
    middle = [(tick.start_ns + tick.stamp_ns) // 2 for tick in closed]
    activity = np.array([_activity(tick, model) for tick in closed])
    return Observed(np.array(middle, np.int64), window, activity, float(sigma[0]), float(sigma[1]))


def _activity(tick: Tick, model: Model) -> float:
    variance = tick_variances(tick.noise, np.array(float(tick.count)), model)
    excess = np.array(tick.innovation_excess)
    return Window(np.zeros(1, np.int64), tick.zeta[None], variance[None], excess[None]).motion_ratio.item()


def labels(middle_ns: Ints, truth: Truth) -> Ints:
    """Column (T,) of the true state in the middle of each tick; ``UNKNOWN`` without truth."""
    interval = truth.at(middle_ns)
    ends = np.array([i.end_ns for i in truth.intervals], np.int64)
    columns = np.array(
        [UNKNOWN if i.contact is None else STATES.index(i.contact) for i in truth.intervals], np.int64
    )
    found = np.full(len(middle_ns), UNKNOWN, np.int64)
    inside = interval >= 0
    inside[inside] = middle_ns[inside] <= ends[interval[inside]]
    found[inside] = columns[interval[inside]]
    return found


def runs(label: Ints) -> list[tuple[int, int, int]]:
    """Runs (column, first, end) of one state, in order; ``UNKNOWN`` is left out."""
    if not len(label):
        return []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(label)) + 1, [len(label)]])
    rows = [(int(label[a]), int(a), int(b)) for a, b in pairwise(edges)]
    return [row for row in rows if row[0] != UNKNOWN]
