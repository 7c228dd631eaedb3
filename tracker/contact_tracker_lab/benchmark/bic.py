"""Alternative: the Bayesian information criterion per segment, as in the selection of articulation models.

For n samples of a segment and contact j with k_j parameters and d_j degrees of freedom,

    log p(samples | j) - 1/2 (k_j + n d_j) log n

where log p is that of the whitened residuals of the constraints, -1/2 sum chi^2: the configuration in the d_j
degrees of freedom is estimated for each sample without residual, so these n d_j coordinates count as
parameters. Free has k = 0, d = 6 and no residual. The posterior is its normalised exponential. Samples are
the tracker's ticks of 0.1 s without outliers, with the noise estimated from the recording; fits are those of
the tracker.

Segments are the paper's windows of 500 frames, every 100 frames; those between change points that ruptures
(C. Truong et al., 2020) finds with minus the criterion as the cost of a segment, with the recording's n
in log n, so that the segments are one model; and the true ones.
"""

from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import softmax

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.errors import extra
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.motion.window import Window, window_of
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.benchmark.fixed_windows import FRAMES
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Method
from contact_tracker_lab.evaluation.scoring import UNSCORED, Scoring, tick_in_force

STEP: Final = 100
WINDOWS: Final = "BIC on windows"
SEGMENTS: Final = "BIC, true segments"
CHANGES: Final = "BIC, change points"
FEWEST: Final = 2
GRID_TICKS: Final = 5
"""Interval of the ticks at which change points may be..."""
LONGEST_TICKS: Final = 100
"""... and largest length of a segment: a longer contact becomes several segments with one label."""


class Ticks(NamedTuple):
    """The ``window`` of all T ticks of a recording; ``has_frames`` (T,); ``start_ns``, ``stamp_ns`` (T,) of
    their first and last frames; ``scales`` of the tracker's fits."""

    window: Window
    has_frames: Bools
    start_ns: Ints
    stamp_ns: Ints
    scales: EvidenceParameters

    @classmethod
    def of(cls, poses: Poses, model: Model) -> "Ticks":
        """The ticks of at least one pose, as in the tracker."""
        ticks = list(ticks_of(batches(poses), model))
        values = np.array([(tick.count, tick.start_ns, tick.stamp_ns) for tick in ticks], np.int64)
        return cls(window_of(ticks, model), values[:, 0] > 0, values[:, 1], values[:, 2], scales_of(model))

    def within(self, start_ns: int, end_ns: int) -> Window | None:
        """The ticks of a span (both included); None if there are too few."""
        inside = (self.start_ns >= start_ns) & (self.stamp_ns <= end_ns) & self.has_frames
        return self.window.pick(inside) if inside.sum() >= FEWEST else None


def on_windows(poses: Poses, _: Scoring, ticks: Ticks) -> dict[Method, Answer]:
    """BIC on fixed windows, offline and online."""
    stamp_ns = poses.stamp_ns
    first = np.arange(0, max(len(poses) - FRAMES + 1, 0), STEP)
    spans = [(int(stamp_ns[i]), int(stamp_ns[i + FRAMES - 1])) for i in first]
    probability, row = _posteriors(spans, ticks)
    start_ns, end_ns = np.array(spans, np.int64).reshape(-1, 2)[row >= 0].T
    middle_ns = (start_ns + end_ns) // 2
    nearest = np.searchsorted((middle_ns[1:] + middle_ns[:-1]) // 2, stamp_ns)
    around = nearest if len(middle_ns) else np.full(len(stamp_ns), -1)
    return {
        Method(WINDOWS, OFFLINE): Answer.most_probable(around, probability),
        Method(WINDOWS, 0.0): Answer.most_probable(tick_in_force(stamp_ns, end_ns), probability),
    }


def between_change_points(poses: Poses, _: Scoring, ticks: Ticks) -> dict[Method, Answer]:
    """The segments with the greatest sum of the criterion, less a cost for each change point."""
    ends = change_points(ticks)
    first = np.array([0, *ends[:-1]], np.int64)
    spans = [(int(ticks.start_ns[a]), int(ticks.stamp_ns[b - 1])) for a, b in zip(first, ends, strict=True)]
    probability, row = _posteriors(spans, ticks, len(ticks.stamp_ns))
    segment = np.searchsorted(ticks.start_ns[first], poses.stamp_ns, side="right") - 1
    return {Method(CHANGES, OFFLINE): Answer.most_probable(row[segment], probability)}


def on_true_segments(_: Poses, scored: Scoring, ticks: Ticks) -> dict[Method, Answer]:
    """The true phases, by the ticks within each."""
    begins = np.append(True, np.diff(scored.truth) != 0)
    run = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(run)) - 1
    has_truth = scored.truth[first] != UNSCORED
    bounds = zip(scored.stamp_ns[first].tolist(), scored.stamp_ns[last].tolist(), strict=True)
    spans = [span if scored else (1, 0) for span, scored in zip(bounds, has_truth, strict=True)]
    probability, row = _posteriors(spans, ticks)
    return {Method(SEGMENTS, OFFLINE): Answer.most_probable(row[run], probability)}


WAYS: Final = (on_windows, between_change_points, on_true_segments)


def change_points(ticks: Ticks) -> list[int]:
    """Ends of the segments, as numbers of ticks; ruptures minimises the cost by dynamic programming."""
    with extra("benchmark", "change points"):
        from ruptures import Pelt

    count = len(ticks.stamp_ns)
    grid = [*range(0, count, GRID_TICKS), count]
    if len(grid) <= FEWEST:
        return [count]
    search = Pelt(custom_cost=_cost(ticks, grid), min_size=1, jump=1).fit(np.arange(len(grid) - 1.0)[:, None])
    return [grid[end] for end in search.predict(pen=0.5 * np.log(count))]


def _cost(ticks: Ticks, grid: list[int]) -> Any:
    """The cost of a segment for ruptures: minus the criterion of the best state of the ticks between points
    of the ``grid``; infinite beyond ``LONGEST_TICKS``."""
    from ruptures.base import BaseCost

    class Cost(BaseCost):  # type: ignore[misc]
        model, min_size = "contacts", 1

        def fit(self, signal: Array) -> "Cost":
            self.signal = signal
            return self

        @cache  # noqa: B019 - it lasts as long as the search
        def error(self, start: int, end: int) -> float:
            rows = np.flatnonzero(ticks.has_frames[grid[start] : grid[end]]) + grid[start]
            if grid[end] - grid[start] > LONGEST_TICKS:
                return float(np.inf)
            if len(rows) < FEWEST:
                return 0.0
            return -float(criteria_of(ticks.window.pick(rows), ticks.scales, len(ticks.stamp_ns)).max())

    return Cost()


def _posteriors(spans: list[tuple[int, int]], ticks: Ticks, samples: int | None = None) -> tuple[Array, Ints]:
    """Posterior (P, 7) of the spans with enough ticks, and the row of each span (-1: none); ``samples``:
    number of ticks in the whole model, by default in each span."""
    windows = [ticks.within(*span) for span in spans]
    fitted = (window for window in windows if window is not None)
    posteriors = [softmax(criteria_of(window, ticks.scales, samples)) for window in fitted]
    has_ticks = np.array([window is not None for window in windows], bool)
    row = np.where(has_ticks, np.cumsum(has_ticks) - 1, -1)
    return np.array(posteriors).reshape(-1, len(STATES)), row.astype(np.int64)


def criteria_of(window: Window, scales: EvidenceParameters, samples: int | None = None) -> Array:
    """BIC (7,) of the states for the ticks of a window, in a model with ``samples`` ticks in all."""
    chi_sq, parameters = np.zeros(len(STATES)), np.zeros(len(STATES))
    for model in CONTACT_MODELS:
        column, family = model.contact.column, model.family
        fitted = fit_window(model, window, scales)
        chi_sq[column] = fitted.rms[0] ** 2 * family.ROWS * len(window)
        parameters[column] = family.PARAMETERS
    return criteria(chi_sq, parameters, len(window), samples)


def criteria(chi_sq: Array, parameters: Array, ticks: int, samples: int | None = None) -> Array:
    """BIC (7,) of the states, the higher the better."""
    freedom = np.array([6 - Contact(state).codimension for state in STATES])
    return np.asarray(-0.5 * chi_sq - 0.5 * (parameters + ticks * freedom) * np.log(samples or ticks))
