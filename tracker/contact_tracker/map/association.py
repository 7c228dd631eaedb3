"""Data association: how well the motion of a contact agrees with each pair of elements of a map."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array
from contact_tracker.hmm import log_sum_exp
from contact_tracker.map.elements import prior_variance
from contact_tracker.map.sighting import Sighting
from contact_tracker.map.view import Key, MapView

Choices = list[list[tuple[Key | None, float]]]


def weigh_pairs(sighting: Sighting, view: MapView, reach_m: float) -> tuple[Choices, Array]:
    """The choices of each side, None for a new element, and the log weights (I, J) of their pairs: prior
    probability times evidence of the sighting."""
    choices = [view.choices(side, kind) for side, kind in enumerate(sighting.kinds)]
    log_weight = log_evidence(sighting, view, choices, reach_m)
    log_weight += np.add.outer(*([log_p for _, log_p in side] for side in choices))
    return choices, log_weight


def log_marginal(sighting: Sighting, view: MapView, reach_m: float) -> float:
    """Log probability of a sighting whatever it touched, relative to all others that use the same ones."""
    return float(log_sum_exp(weigh_pairs(sighting, view, reach_m)[1].ravel()))


def log_evidence(
    sighting: Sighting, view: MapView, choices: Sequence[Sequence[tuple[Key | None, float]]], reach_m: float
) -> Array:
    """Log evidence (I, J) of a sighting if it touched the i-th of the object's choices and the j-th of the
    environment's; None stands for a new element, which is as estimated."""
    parts = [
        SideChoices.of(sighting, view, side, [key for key, _ in choices[side]], reach_m) for side in (0, 1)
    ]
    ours, theirs = parts
    residual = ours.offset[:, None] + theirs.offset[None]
    if sighting.has_one_height:  # a new face has the offset that was estimated
        residual[0, :, -1] = residual[:, 0, -1] = 0.0
    whitened = residual @ sighting.root
    known = view.covariance if view.slots else np.zeros((1, 1))
    joint = known[ours.rows[:, None, :, None], theirs.rows[None, :, None, :]]
    joint[0] = joint[:, 0] = 0.0  # new elements are independent of all others
    across = ours.derivative[:, None] @ joint @ np.swapaxes(theirs.derivative, 1, 2)[None]
    spread = ours.variance[:, None] + theirs.variance[None] + across + np.swapaxes(across, 2, 3)
    ratio = np.eye(residual.shape[-1]) + sighting.root.T @ spread @ sighting.root
    misfit = (whitened * np.linalg.solve(ratio, whitened[..., None])[..., 0]).sum(axis=-1)
    return np.asarray(-0.5 * (np.linalg.slogdet(ratio)[1] + misfit))


class SideChoices(NamedTuple):
    """What the choices (I) of one side contribute to a sighting's residual (P,).

    ``offset`` (I, P) from the sighting's own element, ``derivative`` (I, P, p) by the p free coordinates of
    the element, ``rows`` (I, p) of these in the map (any for a new one, the first), and ``variance`` (I, P,
    P) by its uncertainty.
    """

    offset: Array
    derivative: Array
    rows: NDArray[np.int64]
    variance: Array

    @classmethod
    def of(
        cls, sighting: Sighting, view: MapView, side: int, keys: list[Key | None], reach_m: float
    ) -> "SideChoices":
        own = sighting.own_pair
        columns = slice(0, own[0].size) if side == 0 else slice(own[0].size, None)
        offsets, derivatives, rows, variances = [], [], [], []
        for key in keys:
            one = own[side] if key is None else view.elements[key]
            pair = (one, own[1]) if side == 0 else (own[0], one)
            residual, derivative = sighting.linearised(pair)
            by_own = derivative[:, columns]
            if key is None:
                row, covariance = np.zeros(one.size, np.int64), np.diag(prior_variance(one.kind, reach_m))
            else:
                row = np.arange(view.slots[key].start, view.slots[key].stop)
                covariance = view.covariance[view.slots[key], view.slots[key]]
            offsets.append(residual)
            derivatives.append(by_own)
            rows.append(row)
            variances.append(by_own @ covariance @ by_own.T)
        return cls(np.array(offsets), np.array(derivatives), np.array(rows), np.array(variances))
