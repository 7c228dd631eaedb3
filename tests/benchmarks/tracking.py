"""The tracker over a recording, in one pass: online, with a lag, and offline."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scores import LAGS_S, OFFLINE, Answer, Method

from contact_tracker import hmm, tracker
from contact_tracker.belief import Belief, Segmentation
from contact_tracker.evaluation.scoring import tick_containing, tick_in_force
from contact_tracker.evidence import Window
from contact_tracker.model import Model
from contact_tracker.poses import Poses
from contact_tracker.segmenter import Pass, conclude
from contact_tracker.tracker import TrackerState

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
    state, seen = tracker.start(model, max(lags_s)), Pass()
    pasts: list[Array] = []
    for pose in poses:
        state, closed = tracker.gather(state, pose)
        for tick in closed:
            state = seen.follow(state, [tick])
            pasts.append(past(state))
    state, closed = tracker.gather_rest(state)
    for tick in closed:
        state = seen.follow(state, [tick])
        pasts.append(past(state))
    return Tracked(
        conclude(seen, state),
        {lag_s: looking_back(pasts, round(lag_s / model.tick_s)) for lag_s in lags_s},
        seen.window(state),
        np.array(seen.frames, np.int64),
        np.array(seen.start_ns, np.int64),
        stamps(seen.beliefs),
    )


def past(state: TrackerState) -> Array:
    """Posterior (L, 7) of the last L ticks, the newest last, as the tracker knows them now."""
    weight = np.exp(state.log_left - hmm.log_sum_exp(state.log_left))
    return np.asarray(np.einsum("j,jls->ls", weight, state.past))


def looking_back(pasts: Sequence[Array], lag: int) -> Array:
    """Posterior (T, 7) of each tick as it was known ``lag`` ticks later, or at the end; ``lag`` < L."""
    newest = [min(tick + lag, len(pasts) - 1) for tick in range(len(pasts))]
    known = np.array([pasts[b][tick - b - 1] for tick, b in enumerate(newest)])
    return np.asarray(known / known.sum(axis=1, keepdims=True))


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


def stamps(beliefs: Sequence[Belief]) -> Ints:
    return np.array([b.stamp_ns for b in beliefs], np.int64)


def _told(tick: Ints, beliefs: Sequence[Belief]) -> Answer:
    label = np.array([b.contact.column for b in beliefs], np.int64)
    return Answer(tick, label, np.array([b.probability for b in beliefs]))
