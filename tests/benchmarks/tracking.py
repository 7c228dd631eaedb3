"""The tracker over a recording, in one pass: online, with a lag, and offline."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.evaluation.scoring import tick_containing, tick_in_force
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import Window
from contact_tracker.tracking import tracker
from contact_tracker.tracking.forward_pass import FilteredTick, RecordedPass
from contact_tracker.tracking.offline_smoother import Segmenter
from contact_tracker.tracking.posterior import lagged_belief
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.tracking.state import TrackerState
from scores import LAGS_S, OFFLINE, Answer, Method

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NAME: Final = "tracker"


class Tracked(NamedTuple):
    """What the tracker found.

    ``lagged`` (T, 7) posterior by lag (s): each tick's, from data up to that long after it. ``window`` of all
    T ticks, ``frames`` (T,) in each, ``start_ns`` and ``stamp_ns`` (T,) of their first and last frame.
    """

    segmentation: Segmentation
    lagged: dict[float, Array]
    window: Window
    frames: Ints
    start_ns: Ints
    stamp_ns: Ints


def track(poses: Poses, model: Model, lags_s: Sequence[float] = LAGS_S) -> Tracked:
    """One pass over at least one pose, which looks back as far as the longest lag."""
    state, seen, segmenter = tracker.start(model, max(lags_s)), RecordedPass(), Segmenter()
    lags = {lag_s: round(lag_s / model.tick_s) for lag_s in lags_s}
    lagged: dict[float, list[Array]] = {lag_s: [] for lag_s in lags_s}

    def follow(state: TrackerState, closed: list[Tick]) -> TrackerState:
        for tick in closed:
            state, belief = tracker.update(state, tick)
            now = FilteredTick(state, tick, belief)
            seen.note(now)
            segmenter.note(state, now.tick_result, belief)
            for lag_s, lag in lags.items():
                if len(seen.beliefs) > lag:
                    lagged[lag_s].append(lagged_belief(state, len(state.recent) - 1 - lag).probability)
        return state

    for pose in poses:
        state = follow(*tracker.accumulate_pose(state, pose))
    state = follow(*tracker.close_tick(state))
    for lag_s, lag in lags.items():  # the stream has ended: the last ticks are known as well as they will be
        rows = range(max(len(state.recent) - lag, 0), len(state.recent))
        lagged[lag_s] += [lagged_belief(state, row).probability for row in rows]
    return Tracked(
        segmenter.finish(),
        {lag_s: np.array(told) for lag_s, told in lagged.items()},
        seen.window(state),
        np.array(seen.frames, np.int64),
        np.array(seen.start_ns, np.int64),
        np.array([b.stamp_ns for b in seen.beliefs], np.int64),
    )


def answers(poses: Poses, tracked: Tracked) -> dict[Method, Answer]:
    """The tracker's answers: a frame takes the tick that contains it, online the last reported one."""
    found = tracked.segmentation
    containing = tick_containing(poses.stamp_ns, tracked.stamp_ns)
    by_lag = {
        Method(NAME, lag_s): Answer.most_probable(containing, probability)
        for lag_s, probability in tracked.lagged.items()
    }
    return {
        Method(NAME, OFFLINE): _told(containing, found.beliefs),
        **by_lag,
        Method(NAME, 0.0): _told(tick_in_force(poses.stamp_ns, tracked.stamp_ns), found.filtered),
    }


def _told(tick: Ints, beliefs: Beliefs) -> Answer:
    return Answer(tick, beliefs.rows["contact"].astype(np.int64), beliefs.probability)
