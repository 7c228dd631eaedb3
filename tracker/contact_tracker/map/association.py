"""Data association: how well the motion of a contact agrees with each pair of elements of a map, and how
probable new elements are.

On each side, a contact touches a new element with probability a / (N + a) after N contacts, or else a known
one of its kind, each in proportion to how many have touched it (a Chinese restaurant process). Whether an
element is new is decided before its kind: a new edge costs as much as a new face. The concentration a is that
of the recording.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from contact_tracker.geometry.elements import Array
from contact_tracker.hmm import log_sum_exp
from contact_tracker.map.elements import prior_variance
from contact_tracker.map.sighting import Sighting
from contact_tracker.map.view import Key, MapView

CONCENTRATIONS: Final = np.logspace(-2.0, 1.0, 13)
"""Equally probable concentrations, between which the map decides while it grows: new elements become cheap
where each contact has elements of its own, and dear where some are touched again. On ten recordings of all
kinds, online, a fixed one of 0.3 gives 0.730 and these 0.731; on those of single contacts 0.667 and 0.677, in
the first pass offline 0.818 and 0.890. With a price for each kind (0.3) it is 0.710 online."""
CONCENTRATION: Final = (0.2, 0.02)
"""Concentrations of the object and of the environment offline, where all contacts count, of which few are
sure enough to tell them: an object shows more of its elements than its place. On ten recordings of all kinds
these give 0.908, 0.02 for both 0.900 and ``CONCENTRATIONS`` 0.862; single contacts are not taken as one
world, as it does not explain them better."""


def log_probabilities_of_new(
    counts: Mapping[tuple[int, int], int], contacts: int | None
) -> tuple[float, float]:
    """Log probabilities of a new element of the object and of one of the environment.

    Parameters
    ----------
    counts : how many contacts touched each element, by its side and number.
    contacts : how many there were in the whole recording, sure or not; None while the map grows.
    """
    touched = [[n for (side, _), n in counts.items() if side == one] for one in (0, 1)]
    if contacts is not None:
        ours, theirs = (
            math.log(a / (max(sum(numbers), contacts) + a))
            for numbers, a in zip(touched, CONCENTRATION, strict=True)
        )
        return ours, theirs
    a, log_weight = CONCENTRATIONS, np.zeros(len(CONCENTRATIONS))
    for numbers in touched:
        log_weight += len(numbers) * np.log(a) + gammaln(a) - gammaln(a + sum(numbers))
    log_weight -= log_sum_exp(log_weight)
    ours, theirs = (float(log_sum_exp(log_weight + np.log(a / (sum(numbers) + a)))) for numbers in touched)
    return ours, theirs


def log_prior_of_new(contacts: int) -> float:
    """Log prior probability that so many contacts all touched elements of their own."""
    return sum(math.log(a / (touched + a)) for a in CONCENTRATION for touched in range(contacts))


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
