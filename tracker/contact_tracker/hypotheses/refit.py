"""How hypotheses follow the motion: their moments grow with each tick, their geometry is refined from where
it was, and what the ticks since their onsets say of it is weighed anew.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses import gauss_newton
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import Scales, complexity
from contact_tracker.hypotheses.evidence_sums import Sums, summed
from contact_tracker.hypotheses.pruning import anchors_of, prior_of
from contact_tracker.hypotheses.quadratic_prior import Prior
from contact_tracker.hypotheses.schedule import (
    AT_REST,
    AT_THE_NOISE,
    FALL_NATS,
    FALLEN_STEPS,
    FIRST_STEPS,
    FIRST_TICKS,
    GRACE_NATS,
    GRACE_TICKS,
    REFINE_STEPS,
    WAIT_NATS,
)
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

NOT_AT_ALL: Final = -1


class Before(NamedTuple):
    """What each hypothesis knew before its window, and where the body was: as long as that does not grow."""

    prior: Prior
    anchors: Array


def before(bank: Bank, model: ContactModel, scales: Scales) -> Before:
    anchors = anchors_of(bank, model)
    return Before(prior_of(bank, model, anchors, scales.reach_m), anchors)


def grow(bank: Bank, model: ContactModel, window: Window, log_stay: float = 0.0) -> Bank:
    """Add the newest tick to the moments, weighted by how far the motion in it rises above the noise.

    ``log_stay`` is the price of not having changed in it.
    """
    zeta, activity, now = window.zeta[-1], float(window.activity[-1]), window.index[-1]
    lifted, sigma_m = model.lifted(zeta), float(np.sqrt(window.variance[-1, 0]))
    onsets = bank.onsets
    begins = onsets.onset == now
    weight = np.where(begins, 1.0, max(activity, AT_REST)) / sigma_m**2
    bank = bank.having(lasted=bank.lasted + np.where(bank.onset == now, 0.0, log_stay)).seeing(
        first=np.where(begins[:, None], lifted / sigma_m, onsets.first),
        moments=onsets.moments + weight[:, None, None] * np.outer(lifted, lifted),
        place_sum=onsets.place_sum + weight[:, None] * zeta[9:12],
        weight=onsets.weight + weight,
        told=onsets.told + np.where(begins, 1.0, activity),
    )
    # what begins now touches now, in the directions of the best that there was (minimise solves for the rest)
    return bank.having(x=model.family.normalise(bank.x, anchors_of(bank, model)))


def grow_whole(bank: Bank, model: ContactModel, window: Window) -> Bank:
    """As ``grow`` tick by tick, from the first tick of the window, where all of the bank begin."""
    lifted, variance = model.lifted(window.zeta), window.variance[:, 0]
    heard = np.append(1.0, window.activity[1:])  # the onset is given
    weight = np.maximum(heard, AT_REST) / variance
    bank = bank.seeing(
        first=lifted[0] / np.sqrt(variance[0]),
        moments=(lifted * weight[:, None]).T @ lifted,
        place_sum=weight @ window.zeta[:, 9:12],
        weight=weight.sum(),
        told=heard.sum(),
    )
    return bank.having(x=model.family.normalise(bank.x, anchors_of(bank, model)))


def waits(bank: Bank) -> Bools:
    """Which hypotheses (H,) learn only when searches are due."""
    return ~(bank.joint >= -WAIT_NATS)


def caught(bank: Bank, was: Array, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Let hypotheses go on that were near the best, whose log weight ``was`` (H,) and that have fallen; what
    is fallen then, and was within ``GRACE_NATS``, is kept for a while (see ``Bank.grace``)."""
    fallen = _fallen(bank, was, WAIT_NATS)
    if fallen.any():
        bank = learn(bank, model, window, scales, np.where(fallen, FALLEN_STEPS, NOT_AT_ALL))
    fallen = _fallen(bank, was, GRACE_NATS)
    if not fallen.any():
        return bank
    until = np.maximum(bank.grace, bank.told + GRACE_TICKS)
    return bank.having(grace=np.where(fallen, until, bank.grace))


def _fallen(bank: Bank, was: Array, nats: float) -> Bools:
    """Which hypotheses (H,) that were no more than so many ``nats`` behind the best have fallen."""
    return (was >= -nats) & (bank.joint < was - FALL_NATS) & (bank.rms > AT_THE_NOISE)


def follow(
    bank: Bank, model: ContactModel, window: Window, scales: Scales, idle: Bools | None = None
) -> Bank:
    """``learn`` as far as is due in every tick, what is ``idle`` (H,) nothing."""
    steps = REFINE_STEPS + (FIRST_STEPS - REFINE_STEPS) * (bank.told < FIRST_TICKS)
    if idle is not None:
        steps[idle] = NOT_AT_ALL
    return learn(bank, model, window, scales, steps)


def learn(bank: Bank, model: ContactModel, window: Window, scales: Scales, steps: Index) -> Bank:
    """Take some ``steps`` (H,) towards the minimum, and weigh the evidence there, or do ``NOT_AT_ALL``.

    The moments carry 1/m^2, the rows weights relative to that.
    """
    if (steps == NOT_AT_ALL).any():
        rows = np.flatnonzero(steps != NOT_AT_ALL)
        learned = learn(bank.pick(rows), model, window, scales, steps[rows])
        return bank.putting(rows, learned, np.arange(len(rows)))
    known = before(bank, model, scales)
    found = gauss_newton.minimise(model.family, bank.moments, bank.row_weight, *known, bank.x, steps)
    return _weighed(bank.having(x=found.x), model, window, scales, known, found)


def information(bank: Bank, model: ContactModel, scales: Scales) -> Array:
    """What the moments of each hypothesis tell of its geometry (H, P, P), along the tangent at x.

    Its coordinates are taken where they cost least.
    """
    known = before(bank, model, scales)
    found = gauss_newton.minimise(model.family, bank.moments, bank.row_weight, *known, bank.x, 0)
    return np.asarray(found.hessian.sum(axis=1))


def _weighed(
    bank: Bank, model: ContactModel, window: Window, scales: Scales, known: Before, found: gauss_newton.Fit
) -> Bank:
    """With the evidence at their x, which was ``found``."""
    seen = summed(model, bank.x, bank.onset, window, scales, bank.certain)
    first = bank.first[:, :, None] * bank.first[:, None]
    given = gauss_newton.information(
        model.family, first, bank.row_weight, bank.moments, known.anchors, found.at
    )
    foretold = _foretold(bank, model, scales, seen)
    price = complexity(
        model.family, bank.x, found.at, known.anchors, found.hessian, given, foretold, known.prior
    )
    earned = seen.gain.sum(axis=1) + bank.earned
    count = np.maximum(seen.ticks, 1)
    return bank.having(
        # geometry never costs more than it has explained
        log_likelihood=bank.lasted
        + scales.independence * (seen.log_ratio + bank.settled - np.minimum(price, earned)),
        row_weight=seen.precision / count[:, None],
        rms=np.sqrt(seen.chi_sq / (count * model.family.ROWS)),
    )


def _foretold(bank: Bank, model: ContactModel, scales: Scales, seen: Sums) -> Array:
    """Share (H, K) of each row's information that free motion, continued, would have given (T19)."""
    ticks = np.maximum(bank.told, 1.0)[:, None]
    mean_gain = seen.gain / np.maximum(seen.after, 1)[:, None]
    return np.asarray(scales.foreknowledge * model.needed / ticks * np.exp(-2.0 * mean_gain))
