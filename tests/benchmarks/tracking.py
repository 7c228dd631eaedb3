"""One pass of the tracker over a recording: online, with a lag, and offline."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import Window
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.forward_pass import forward, ticks_of
from contact_tracker.tracking.offline_smoother import Segmenter
from contact_tracker.tracking.posterior import lagged_belief
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.calibration.recorded_pass import RecordedPass
from contact_tracker_lab.evaluation.scoring import tick_containing, tick_in_force
from scores import LAGS_S, OFFLINE, Answer, Method

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NAME: Final = "tracker"


class Tracked(NamedTuple):
    """Results of the tracker.

    ``lagged``: by lag (s), the posterior (T, 7) of each tick from data up to that long after it. ``window``
    of all T ticks, ``frames`` (T,) in each, ``start_ns`` and ``stamp_ns`` (T,) of their first and last frame.
    """

    segmentation: Segmentation
    lagged: dict[float, Array]
    window: Window
    frames: Ints
    start_ns: Ints
    stamp_ns: Ints


def track(poses: Poses, model: Model, lags_s: Sequence[float] = LAGS_S) -> Tracked:
    """One pass over at least one pose, with the longest of the lags."""
    one, recorded, segmenter = ContactFilter.start(model, max(lags_s)), RecordedPass(), Segmenter()
    lags = {lag_s: round(lag_s / model.tick_s) for lag_s in lags_s}
    lagged: dict[float, list[Array]] = {lag_s: [] for lag_s in lags_s}

    for filtered in forward(ticks_of(poses, model), one, Detail.FORMATION):
        recorded.note(filtered)
        segmenter.note(filtered)
        for lag_s, lag in lags.items():
            if len(recorded.beliefs) > lag:
                row = len(filtered.state.recent) - 1 - lag
                lagged[lag_s].append(lagged_belief(filtered.state, row).probability)
    state = one.state
    for lag_s, lag in lags.items():  # at the end of the stream the last ticks have a shorter lag
        rows = range(max(len(state.recent) - lag, 0), len(state.recent))
        lagged[lag_s] += [lagged_belief(state, row).probability for row in rows]
    return Tracked(
        segmenter.finish(),
        {lag_s: np.array(posteriors) for lag_s, posteriors in lagged.items()},
        recorded.window(model),
        np.array(recorded.frames, np.int64),
        np.array(recorded.start_ns, np.int64),
        np.array([b.stamp_ns for b in recorded.beliefs], np.int64),
    )


def answers(poses: Poses, tracked: Tracked) -> dict[Method, Answer]:
    """Labels and posteriors of the tracker: of the tick that contains a frame, online of the latest one."""
    found = tracked.segmentation
    containing = tick_containing(poses.stamp_ns, tracked.stamp_ns)
    by_lag = {
        Method(NAME, lag_s): Answer.most_probable(containing, probability)
        for lag_s, probability in tracked.lagged.items()
    }
    return {
        Method(NAME, OFFLINE): _answer(containing, found.beliefs),
        **by_lag,
        Method(NAME, 0.0): _answer(tick_in_force(poses.stamp_ns, tracked.stamp_ns), found.filtered),
    }


def _answer(tick: Ints, beliefs: Beliefs) -> Answer:
    return Answer(tick, beliefs.rows["contact"].astype(np.int64), beliefs.probability)
