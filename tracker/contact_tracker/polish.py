"""Elements of a stretch at their greatest likelihood: the last steps, with the noise of every tick.

A running fit sees its ticks through moments: rows weighted by their mean noise, ticks by their motion
(docs/theory.md, T13). That finds the minimum in microseconds, but neither quite the best estimate nor quite
its accuracy. Here each tick counts as its own noise says (T16), rest as well, that noise follows the
geometry, and how large each row's noise is, and how long it lasts, is told by its residuals (docs/theory.md,
T26).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.bank import anchors_of, prior_of
from contact_tracker.contacts import ContactModel
from contact_tracker.evidence import Scales, Window, residual_noise
from contact_tracker.fit import Prior
from contact_tracker.table import Bank

Array = NDArray[np.float64]

ROUNDS: Final = 3
"""Of fitting, and of learning the noise from what the fit leaves."""
STEPS: Final = 20
TOLERANCE_NATS: Final = 1e-4
PRIOR_TICKS: Final = 1.0
"""Weight of the noise as it was believed against that of the residuals."""
LEARNING_STEPS: Final = 15
"""Of expectation-maximisation; they cost little beside a fit."""
FIRST_ECHO: Final = 0.5
MOST_ECHO: Final = 0.95
FEW_TICKS: Final = 15
STRANGE_SIGMAS: Final = 2.5
"""A tick at an end of the stretch is left out if it is so far off, unless there are only ``FEW_TICKS``."""
LEAST_SCALE: Final = 1e-6
LEAST_SHARE: Final = 1e-12
LEAST_CURVATURE: Final = 1e-9
LEAST_DAMPING: Final = 1e-9
_STEP: Final = 1e-6
"""Of finite differences, in radians and metres."""


class Errors(NamedTuple):
    """What the residuals (K, ...) say of their errors: ``weight`` (K,), how much smaller than believed they
    are, and ``echo`` (K,), how much of a tick's is left in the next."""

    weight: Array
    echo: Array


def polish(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> Bank:
    """Bring the one hypothesis of ``bank`` from near the minimum to it; ``window`` is its whole stretch.

    The first and the last tick are left out where they do not fit the others: they may hold frames of what
    came before and after.

    Returns
    -------
    Bank with ``x`` (1, S) of the greatest posterior density, its information ``hessian`` (1, K, P, P) by row,
    and with ``moments`` and ``row_weight`` of the weights that the ticks have here. Where no step improves on
    it, x stays what it was.
    """
    polished, errors = _settle(bank, model, window, scales)
    if len(window) < FEW_TICKS:
        return polished
    begins, ends = _belong(polished, errors, model, window, scales)[[0, -1]]
    inner = window.cut(0 if begins else 1, None if ends else -1)
    return polished if begins and ends else _settle(polished, model, inner, scales)[0]


def _settle(bank: Bank, model: ContactModel, window: Window, scales: Scales) -> tuple[Bank, Errors]:
    """``polish`` with all ticks of the window, and what is left."""
    family = model.family
    anchors = anchors_of(bank, model)
    prior = prior_of(bank, model, anchors, scales.reach_m)
    x, errors = bank.x, Errors(np.ones(family.ROWS), np.full(family.ROWS, FIRST_ECHO))
    for _ in range(ROUNDS):
        x = _maximise(model, x, errors, anchors, window, prior)
        whitened, jacobian, tangent = _linearised(model, x, anchors, window)
        held = tangent.T @ prior.precision[0] @ tangent
        errors = learnt(errors, whitened, jacobian, held, window.index)
    jacobian = new_in(jacobian, errors.echo, window.index)
    lifted, position = model.lifted(window.zeta), window.variance[:, 0]
    # to what does not echo, the sensor's own noise, a tick beside its neighbours is worth more
    alone = (1.0 + errors.echo**2) / (1.0 - errors.echo**2)
    polished = bank.having(
        x=x,
        hessian=np.einsum("ktp,k,ktq->kpq", jacobian, errors.weight, jacobian)[None],
        moments=np.einsum("t,tc,td->cd", 1.0 / position, lifted, lifted)[None],
        row_weight=errors.weight * alone * np.mean(position / _noise(model, x, window)[1], axis=2),
    )
    return polished, errors


def _belong(
    polished: Bank, errors: Errors, model: ContactModel, window: Window, scales: Scales
) -> NDArray[np.bool_]:
    """Whether each tick (W,) is where the others foretell it: residuals over what the fit leaves of noise."""
    anchors, weight = anchors_of(polished, model), errors.weight
    whitened, jacobian, tangent = _linearised(model, polished.x, anchors, window)
    held = tangent.T @ prior_of(polished, model, anchors, scales.reach_m).precision[0] @ tangent
    # what the stretch has not shown at all has no leverage
    covariance = np.linalg.pinv(polished.hessian[0].sum(axis=0) + held, hermitian=True)
    leverage = np.einsum("k,ktp,pq,ktq->kt", weight, jacobian, covariance, jacobian)
    square = weight[:, None] * whitened**2 / np.maximum(1.0 - leverage, LEAST_SCALE)
    return np.asarray(np.all(square < STRANGE_SIGMAS**2, axis=0))


def _maximise(
    model: ContactModel, x: Array, errors: Errors, anchors: Array, window: Window, prior: Prior
) -> Array:
    """Levenberg-Marquardt on the weighted squares of what is new in all residuals, from x (1, S)."""
    weight, echo = errors

    def new(x: Array) -> tuple[Array, Array, Array]:
        whitened, jacobian, tangent = _linearised(model, x, anchors, window)
        return new_in(whitened, echo, window.index), new_in(jacobian, echo, window.index), tangent

    def cost(x: Array) -> float:
        squares = np.sum(new_in(_whitened(model, x, window)[0], echo, window.index) ** 2, axis=1)
        return float(0.5 * weight @ squares + prior.cost(x)[0])

    damping, now = 1e-6, cost(x)
    residual, jacobian, tangent = new(x)
    for _ in range(STEPS):
        pull = tangent.T @ prior.precision[0]
        weighted = weight[:, None, None] * jacobian
        gradient = np.einsum("ktp,kt->p", weighted, residual) + tangent.T @ prior.gradient(x)[0]
        curvature = np.einsum("ktp,ktq->pq", weighted, jacobian) + pull @ tangent
        ridge = damping * np.diag(curvature) + LEAST_CURVATURE
        step = -np.linalg.solve(curvature + np.diag(ridge), gradient)
        proposal = model.family.normalise(x + step @ tangent.T, anchors)
        proposed = cost(proposal)
        if proposed < now:
            x, now, damping = proposal, proposed, max(0.1 * damping, LEAST_DAMPING)
            residual, jacobian, tangent = new(x)
        else:
            damping *= 100.0
        if abs(gradient @ step) < TOLERANCE_NATS:
            break
    return x


def learnt(errors: Errors, whitened: Array, jacobian: Array, held: Array, index: NDArray[np.int64]) -> Errors:
    """What whitened residuals (K, W) at a minimum say of their errors, by expectation-maximisation.

    The errors are not the residuals: the fit has taken from them what looks like geometry. ``jacobian``
    (K, W, P) and ``held`` (P, P), the information of the prior, say how much. Where few ticks are left over,
    the belief stands.
    """
    weight, echo = errors
    count, follows = whitened.shape[1], np.diff(index) == 1
    paired = np.append(follows, False) | np.append(False, follows)
    for _ in range(LEARNING_STEPS):
        new = new_in(jacobian, echo, index)
        told, ways = np.linalg.eigh(np.einsum("ktp,k,ktq->pq", new, weight, new) + held)
        shown = told > LEAST_SHARE * told[-1]
        taken = jacobian @ (ways[:, shown] / np.sqrt(told[shown]))
        # over the last axis, products of these sum up to what is expected of products of errors
        error = np.concatenate([whitened[..., None], taken], axis=2)
        product = np.sum((error[:, :-1] * error[:, 1:])[:, follows], axis=(1, 2)) / max(follows.sum(), 1)
        # of the ticks in these pairs: squares of others only add their own scatter
        square = np.sum(error[:, paired] ** 2, axis=(1, 2)) / max(paired.sum(), 1)
        echo = np.clip(product / np.maximum(square, LEAST_SCALE), 0.0, MOST_ECHO)
        variance = np.maximum(np.sum(new_in(error, echo, index) ** 2, axis=(1, 2)) / count, LEAST_SCALE)
        weight = variance ** (-count / (count + PRIOR_TICKS))
    return Errors(weight, echo)


def new_in(rows: Array, echo: Array, index: NDArray[np.int64]) -> Array:
    """What is new in each tick of rows (K, W, ...), in units of what that usually is."""
    left = echo[:, None] ** np.diff(index)
    left = left.reshape(*left.shape, *(1,) * (rows.ndim - 2))
    later = (rows[:, 1:] - left * rows[:, :-1]) / np.sqrt(1.0 - left**2)
    return np.concatenate([rows[:, :1], later], axis=1)


def _noise(model: ContactModel, x: Array, window: Window) -> tuple[Array, Array]:
    """Residuals of x (B, S) and their noise variances, (B, K, W) both."""
    seen = model.measure(x, window.zeta)
    return seen.residual, residual_noise(seen, window)


def _whitened(model: ContactModel, x: Array, window: Window) -> Array:
    """Residuals of x (B, S) in units of their noise, (B, K, W)."""
    residual, variance = _noise(model, x, window)
    return np.asarray(residual / np.sqrt(variance))


def _linearised(model: ContactModel, x: Array, anchors: Array, window: Window) -> tuple[Array, Array, Array]:
    """Whitened residuals (K, W) at x (1, S), their derivative (K, W, P) along the tangent (S, P)."""
    tangent = model.family.tangent(x, anchors)[0]
    steps = _STEP * tangent.T
    around = model.family.normalise(x + np.concatenate([steps, -steps]), anchors)
    seen = _whitened(model, np.concatenate([x, around]), window)
    half = len(steps)
    jacobian: Array = (seen[1 : half + 1] - seen[half + 1 :]) / (2.0 * _STEP)
    return seen[0], np.moveaxis(jacobian, 0, -1), tangent
