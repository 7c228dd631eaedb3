"""The choice of the noise of a tick by evidence: candidates, the evidence of a tick, and which are kept."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf, sqrt
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools
from contact_tracker.config.parameters import Model, Motion
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.motion.free_motion import can_be_compared
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.sensor_noise import SLOW_PERIOD_S, begin, estimate_noise
from contact_tracker.motion.tick_averaging import Tick, tick_variances
from contact_tracker.tracking.state import FilterState
from contact_tracker.tracking.transition_model import FACES

NOISE_SCALES: Final = (1.75e-4, 3.5e-4, 7e-4, 1.4e-3, 2.8e-3)
"""Candidates for the noise of a tick: geometric means of its standard deviations in position (m) and
orientation (rad). Within a factor of the square root of two of the true noise contacts are found equally
well."""
LEAST_FACTOR: Final = 1.2
"""A candidate is tracked if its floor exceeds the averaged white noise by this factor."""
WANDER_M: Final = (1.25e-4, 3.5e-4, 1e-3)
"""Candidates for correlated errors of the position, such as those of calibration; those below the noise are
not tracked."""
WANDER_ROTATION_PER_POSITION: Final = 5.0
"""Ratio of correlated errors of orientation and position (rad/m)."""
TOLERANCE_M: Final = 1e-3
TOLERANCE_RAD: Final = 1e-2
"""Candidates for the tolerance of f-f: lasting errors (standard deviations) of that contact alone, as floors
and wheels are not flat. From tick to tick a recorded trolley has errors of 0.3 mm and 0.1 to 0.18 deg, as by
1 mm and 0.57 deg, although its height wanders by 2.7 mm. With half or double of the angle it is f-f for 55
and 56 instead of 58 of 60 s; with half of the distance a wheelchair is for 13 instead of 23 of 31 s."""
LOG_PRIOR_TOLERANCE: Final = -15.0
"""Log prior (nats) of a tolerance, so that exact contacts stay exact: in 10 s of motion the evidence for it
is up to 9 nats in everyday handling, and 20 to 30 for a trolley and a wheelchair. With 7.5 both are found
as well, with 30 the trolley is not."""
SHARES: Final = (0.5, 0.25, 0.125)
"""Candidates, in slow streams, for the share of the deviations that is noise."""
LOG_PRIOR_STEP: Final = -1.0
"""Log prior (nats) of each larger floor and each smaller share relative to the one before."""
LOG_PRIOR_WANDER: Final = 12.0
"""Log prior odds (nats) of correlated errors. Few streams have none; a model with them finds contacts in any
case, while without them true contacts may not fit. If there are none, the evidence against them is much
larger after some seconds of motion."""
ROTATION_PER_POSITION: Final = (2.0, 40.0)
"""Range of the ratio of the deviations (rad/m), if the stream does not determine it."""
USUAL_ROTATION_PER_POSITION: Final = 7.0


def candidates(model: Model, poses: Poses) -> tuple[tuple[Model, float], ...]:
    """The model, and copies with other noise, each with its log prior odds (nats) against the first.

    Averaging reduces filtered noise less than white noise, by an unknown factor. A filter has the same effect
    on position and orientation, so the ratio of their noise is that of the frames. In slow streams the noise
    may be smaller than the differences of frames, and there may be correlated errors.

    Parameters
    ----------
    poses : the first of the stream.
    """
    if not model.noise.estimated or not can_be_compared(model):
        return ((model, 0.0),)
    sigma = np.array(estimate_noise(poses))
    is_estimated, ratio = np.isfinite(sigma).all() and sigma[0] > 0.0, USUAL_ROTATION_PER_POSITION
    if is_estimated:
        ratio = float(np.clip(sigma[1] / sigma[0], *ROTATION_PER_POSITION))
    span_s = (int(poses.stamp_ns[-1]) - int(poses.stamp_ns[0])) * 1e-9
    count = max(len(poses) * model.tick_s / max(span_s, model.tick_s), 1.0)
    white = tick_variances(begin(*sigma) if is_estimated else begin(0.0, 0.0), np.array(count), model)
    noise, least_scale = model.noise, float(white.prod()) ** 0.25
    larger = [
        replace(
            noise,
            floor_position_m=max(scale / sqrt(ratio), noise.floor_position_m),
            floor_rotation_rad=max(scale * sqrt(ratio), noise.floor_rotation_rad),
        )
        for scale in NOISE_SCALES
        if scale > LEAST_FACTOR * least_scale
    ]
    is_slow = span_s > SLOW_PERIOD_S * (len(poses) - 1)
    smaller = [replace(noise, estimate_share=share) for share in SHARES if is_slow]
    correlated = [
        replace(noise, wander_position_m=scale, wander_rotation_rad=scale * WANDER_ROTATION_PER_POSITION)
        for scale in WANDER_M
        if scale > white[0] ** 0.5
    ]
    variants = [(noise, 0.0)]
    for levels in (smaller, larger):
        variants += [(level, LOG_PRIOR_STEP * i) for i, level in enumerate(levels, 1)]
    variants += [(level, LOG_PRIOR_WANDER) for level in correlated]
    models = [(replace(model, noise=level), log_prior) for level, log_prior in variants]
    wandering = [replace(model, noise=level) for level in correlated]
    loose = [with_tolerance(wanders) for wanders in wandering]
    loose += [with_tolerance(wanders, TOLERANCE_M) for wanders in wandering[:1]]
    return (*models, *((candidate, LOG_PRIOR_WANDER + LOG_PRIOR_TOLERANCE) for candidate in loose))


def with_tolerance(model: Model, tolerance_m: float = 0.0) -> Model:
    """The model, whose errors are correlated, with f-f to a tolerance of ``TOLERANCE_RAD`` and
    ``tolerance_m``: by its innovations (T34)."""
    alone, noise = sqrt(1.0 - model.correlation**2), model.noise
    position_m, rotation_rad = list(noise.contact_position_m), list(noise.contact_rotation_rad)
    position_m[FACES] = hypot(position_m[FACES], alone * tolerance_m)
    rotation_rad[FACES] = hypot(rotation_rad[FACES], alone * TOLERANCE_RAD)
    floor_m, floor_rad = tuple(position_m), tuple(rotation_rad)
    return replace(model, noise=replace(noise, contact_position_m=floor_m, contact_rotation_rad=floor_rad))


DROP_AFTER_S: Final = 1.5
MARGIN_NATS: Final = 10.0
"""Filters this far behind the best are dropped after ``DROP_AFTER_S`` of motion. In 81 recordings (everyday,
physics, shipped, 27 distorted) no dropped one would have been chosen in the end; with 7 nats labels until
then are right for 0.001 less of the time. Sooner, filtered noise at rest would decide."""
DECIDED_AFTER_S: Final = 10.0
"""After this much motion the best filter is chosen, if it is also the best by evidence alone."""
LONGEST_S: Final = 30.0
"""After this much motion the filter with the largest evidence is chosen."""
_DISTANCES: Final = np.array([*(1.0 for _ in CONTACT_MODELS), 0.0])
_ANGLES: Final = np.array([*(model.contact.codimension - 1.0 for model in CONTACT_MODELS), 0.0])
"""Number of constraints of each state (7,) on a distance and on angles."""


class TickEvidence(NamedTuple):
    """A tick as one filter evaluates it: the ``gain`` of log evidence (nats), the ``posterior`` (7,) after
    it, the variances (2,) of free motion plus noise (m^2, rad^2), and the ``activity``."""

    gain: float
    posterior: Array
    free_variance: Array
    activity: float


def tick_evidence(before: FilterState, after: FilterState) -> TickEvidence:
    """The evidence of the tick between two states."""
    weight = np.exp(after.log_state_weight - after.log_state_weight.max())
    gain, window = after.log_evidence - before.log_evidence, after.window
    free_variance = window.innovation_excess[-1] + window.variance[-1]
    return TickEvidence(gain, weight / weight.sum(), free_variance, window.latest_motion_ratio)


def relative_evidence(ticks: Sequence[TickEvidence], motion: Motion) -> Array:
    """Log evidence (K,) of one tick by K filters, relative to the free motion of the first.

    A constraint gains log S / 2, where S is the variance of free motion along it. A filter with larger noise
    has a smaller S, because it takes a part of the motion for noise; the difference is added here.
    """
    squared_lever_m2 = 2.0 * motion.body_radius_m**2
    free = np.array([tick.free_variance for tick in ticks])
    log_distance = np.log(free[:, 0] + squared_lever_m2 * free[:, 1])
    log_angle = np.log(free[:, 1])
    posterior = np.array([tick.posterior for tick in ticks])
    difference = (posterior @ _DISTANCES) * (log_distance[0] - log_distance)
    difference += (posterior @ _ANGLES) * (log_angle[0] - log_angle)
    gain = np.array([tick.gain for tick in ticks])
    return np.asarray(gain + 0.5 * motion.likelihood_exponent * difference)


def are_kept(log_weight: Array, log_prior: Array, moved_s: float, price: Array | float = 0.0) -> Bools:
    """Which of K filters are kept after ``moved_s`` seconds of motion: those near the best, and from
    ``DECIDED_AFTER_S`` on the best alone.

    Parameters
    ----------
    log_weight, log_prior : (K,), in nats; their difference is the evidence. Before ``LONGEST_S``, the best
        by weight and the best by evidence alone are both kept if they differ.
    price : (K,) part of the prior that also counts for the last choice.
    """
    if moved_s < DROP_AFTER_S:
        return np.ones(len(log_weight), np.bool_)
    scores = log_weight, log_weight - log_prior
    best, best_by_evidence = (int(score.argmax()) for score in scores)
    if moved_s >= LONGEST_S:
        best = int((scores[1] + price).argmax())
    if moved_s >= LONGEST_S or (moved_s >= DECIDED_AFTER_S and best == best_by_evidence):
        return np.asarray(np.arange(len(log_weight)) == best, np.bool_)
    return np.asarray(np.any([score > score.max() - MARGIN_NATS for score in scores], axis=0))


CALM_TICKS: Final = 15
MOST_ACTIVITY: Final = 1.0 / 3.0
"""Largest mean activity at rest, from ``CALM_TICKS`` ticks on. With a low pass of the poses at 8 Hz, that of
the least noise is 0.87 to 0.96, and that of the right one in most recordings at most 0.2. Such recordings of
everyday handling are right for 0.879 of the time, and without the rule 0.850; 0.25 and 0.4 gave the same."""

LEAST_RATIO: Final = 2.0
"""Least ratio of a filter's activity at rest to that of the calmest: evidence decides between alike ones."""


def are_calm(rest_activity: Array, rest_ticks: int, may_be_filtered: bool) -> Bools:
    """Which of K filters do not take the noise at rest for motion, if the poses may be filtered: differences
    of these show too little noise, and contacts between new elements fit what remains as well as slow motion.

    ``rest_activity`` (K,) are sums over ``rest_ticks``. With too few of these, or unfiltered poses: all.
    """
    is_known = may_be_filtered and rest_ticks >= CALM_TICKS
    most = max(MOST_ACTIVITY * rest_ticks, LEAST_RATIO * float(rest_activity.min()))
    return np.asarray((rest_activity <= most) | (not is_known))


REST_STEPS: Final = 10
"""Number of steps between ticks by which a rest shows their noise. With 5 the choice is the same; with 20,
which few rests of a hand have, an object inspected in the air is free for 0.78 instead of 0.98."""
REST_RATIO: Final = 5.0
"""Largest ratio of the noise of a tick by a filter to that in the calmest rest, in standard deviations. A jug
that is tilted in the air within a millimetre of a plane is free for all of the time instead of 0.07. Neither
71 recordings of handling and physics, 24 of them own, nor copies with a low pass at 8 Hz change; with 3 the
choice is another one with a low pass at 12 to 20 Hz, as steps of filtered poses show too little."""


class RestScatter(NamedTuple):
    """How much ticks scatter at rest, which is at least their noise.

    Parameters
    ----------
    zeta : the latest tick, if the object rests.
    squares : half the mean square (m^2, rad^2) of the steps of this rest that are not used yet.
    least : least geometric mean (m rad) of the variances of a tick in position and orientation, by
        ``REST_STEPS``; infinite before the first. What a hand holds still moves more than what lies.
    """

    zeta: Array | None = None
    squares: tuple[tuple[float, float], ...] = ()
    least: float = inf

    def append(self, tick: Tick, moves: bool) -> "RestScatter":
        """The scatter after one more tick, in which the object ``moves`` or rests; equal poses, as a robot
        repeats them at rest, show nothing."""
        if moves or not tick.count or tick.is_rest:
            return RestScatter(least=self.least)
        step = np.zeros(1) if self.zeta is None else tick.zeta - self.zeta
        if not step.any():
            return self._replace(zeta=tick.zeta)
        squares = (*self.squares, (float(step[T] @ step[T]) / 6.0, float(step[R] @ step[R]) / 12.0))
        if len(squares) < REST_STEPS:
            return RestScatter(tick.zeta, squares, self.least)
        return RestScatter(tick.zeta, least=min(self.least, sqrt(np.mean(squares, axis=0).prod())))

    def allows(self, variances: Array) -> Bools:
        """Which of K filters have variances (K, 2) of a tick (m^2, rad^2) that are not much larger: with such
        noise, contacts between new elements fit a hand that holds an object nearly still."""
        mean = np.sqrt(variances.prod(axis=1))
        return np.asarray(mean <= REST_RATIO**2 * max(self.least, float(mean.min())))


NO_RESTS: Final = RestScatter()
