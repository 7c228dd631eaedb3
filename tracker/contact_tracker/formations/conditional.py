"""Evidence for a further contact, conditioned on the contacts that are known already (docs/theory.md, T35).

Constraints implied by the known contacts hold anyway and are no evidence for a further one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import log
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry import linalg
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion import lifted_pose
from contact_tracker.motion.window import LEVERS_M, Window

Array = NDArray[np.float64]

SAME_ROW: Final = 0.05
"""Unit gradients of constraints that differ by less count as one constraint."""
JITTER: Final = 1e-9
TINY: Final = 1e-30
_MOVES: Final = lifted_pose.perturbations()


@cache
def _every(model: ContactModel) -> Array:
    return np.asarray(model.lifted(np.eye(lifted_pose.SIZE)).T)


def coefficients(model: ContactModel, x: Array) -> Array:
    """Coefficients (..., K, 25) of a contact's residuals on the whole lifted pose, at x (..., S)."""
    return np.asarray(model.family.rows(x) @ _every(model))


class ConditionalEvidence(NamedTuple):
    """Evidence (nats) of W ticks for a further contact against motion without it."""

    log_ratio: Array
    """(W,)"""
    gain: Array
    """(W,) what the log ratio would be without residuals."""
    chi_sq: Array
    """(W,) mean square of the residuals over their noise."""


@dataclass(frozen=True, eq=False)
class ConditionalMotion:
    """W ticks in which an object keeps some contacts, and the motion that these leave free.

    Parameters
    ----------
    new : (W, 25) lifted poses; of correlated errors only the innovation (T34).
    moved : (W, 6, 25) their derivatives, see ``perturbed``.
    noise_sd : (W, 6) measurement noise of a tick in these directions (rad, m).
    excess_sd : (W, 6) unpredictable part of the motion in these directions (rad, m).
    free : (W, 6, 6) factors F: motion that keeps the contacts has the covariance F F^T in a tick.
    """

    new: Array
    moved: Array
    noise_sd: Array
    excess_sd: Array
    free: Array

    @classmethod
    def of(cls, window: Window, scales: EvidenceParameters) -> Self:
        """Ticks in which no contact is kept."""
        zeta, new = window.zeta, scales.innovations(window.zeta, window.before)
        excess_sd = np.sqrt(window.innovation_excess[:, lifted_pose.NOISE_OF_PERTURBATION])
        free = excess_sd[:, :, None] * np.eye(6)
        noise_sd = np.sqrt(window.variance[:, lifted_pose.NOISE_OF_PERTURBATION])
        return cls(new, perturbed(zeta), noise_sd, excess_sd, free)

    def keeping(self, c: Array, first: int = 0, end: int | None = None) -> "ConditionalMotion":
        """The same motion, with the constraints c (K, 25) kept in ticks ``first`` to ``end`` (excluded),
        too."""
        some = slice(first, end)
        gradient = self.gradients(c)[some]
        whole = np.linalg.norm(gradient * self.excess_sd[some, None], axis=2, keepdims=True)
        rows = gradient @ self.free[some] / (whole + TINY)
        _, values, axes = np.linalg.svd(rows, full_matrices=False)
        pinned = axes * (values > SAME_ROW)[:, :, None]
        free = self.free.copy()
        free[some] -= free[some] @ np.swapaxes(pinned, 1, 2) @ pinned
        return replace(self, free=free)

    def cut(self, first: int, end: int) -> "ConditionalMotion":
        """Ticks ``first`` to ``end`` (excluded)."""
        some = slice(first, end)
        return ConditionalMotion(
            self.new[some], self.moved[some], self.noise_sd[some], self.excess_sd[some], self.free[some]
        )

    def __len__(self) -> int:
        return len(self.new)

    def gradients(self, c: Array) -> Array:
        """Derivatives (W, K, 6) of residuals c (K, 25) by the pose."""
        return np.asarray(np.swapaxes(self.moved @ c.T, 1, 2))

    def evidence(self, c: Array) -> ConditionalEvidence:
        """Evidence of each tick for a contact with the constraints c (K, 25)."""
        gradient, residual = self.gradients(c), self.new @ c.T
        noise, free = gradient * self.noise_sd[:, None], gradient @ self.free
        scale = np.sqrt(np.square(noise).sum(axis=2)) + TINY  # makes the result independent of a row's units
        noise, free, residual = noise / scale[..., None], free / scale[..., None], residual / scale
        held = noise @ np.swapaxes(noise, 1, 2) + JITTER * np.eye(len(c))
        loose = held + free @ np.swapaxes(free, 1, 2)
        gain = 0.5 * (np.linalg.slogdet(loose)[1] - np.linalg.slogdet(held)[1])
        pull = np.linalg.solve(held, residual[..., None]) - np.linalg.solve(loose, residual[..., None])
        misfit = 0.5 * (residual * pull[..., 0]).sum(axis=1)
        return ConditionalEvidence(gain - misfit, gain, np.square(residual).mean(axis=1))


def perturbed(zeta: Array) -> Array:
    """Derivatives (W, 6, 25) of lifted poses (W, 25) by rotation about the body's axes and translation along
    the world's."""
    return (zeta @ _MOVES.reshape(-1, lifted_pose.SIZE).T).reshape(len(zeta), 6, lifted_pose.SIZE)


def count_constraints(moved: Array, contacts: Sequence[Array]) -> int:
    """Number of independent constraints that contacts c (K, 25) impose together, in the median of ticks with
    these derivatives (W, 6, 25), see ``perturbed``."""
    rows = np.swapaxes(moved @ np.concatenate(contacts).T, 1, 2) * LEVERS_M
    rows /= np.linalg.norm(rows, axis=2, keepdims=True) + TINY
    return int(linalg.median((np.linalg.svd(rows, compute_uv=False) > SAME_ROW).sum(axis=1)))


AT_FIRST: Final = 0.1
"""Probability that it is present when the first contact begins."""


class Run(NamedTuple):
    """Ticks ``first`` to ``end`` (excluded) in which a contact holds."""

    first: int
    end: int

    def overlaps(self, other: "Run") -> bool:
        """Whether the runs share a tick."""
        return self.first < other.end and other.first < self.end


class Presence(NamedTuple):
    """The most probable ``runs``, and their log odds (nats) against no run."""

    runs: tuple[Run, ...]
    log_odds: float


def most_probable(log_ratio: Array, log_change: Array) -> Presence:
    """Viterbi path over the states absent and present.

    Parameters
    ----------
    log_ratio : (W,) evidence of each tick for the contact.
    log_change : (W,) log probability that it begins or ends right before a tick.
    """
    absent, present = log(1.0 - AT_FIRST), log(AT_FIRST)
    came_from_present, came_from_absent = [], []  # of absent, of present
    stays = np.log1p(-np.exp(log_change)).tolist()
    none = absent + float(np.sum(stays[1:]))
    for tick, (ratio, change, stay) in enumerate(
        zip(log_ratio.tolist(), log_change.tolist(), stays, strict=True)
    ):
        left = joined = False
        if tick:
            left, joined = present + change > absent + stay, absent + change > present + stay
            absent, present = (
                present + change if left else absent + stay,
                absent + change if joined else present + stay,
            )
        present += ratio
        came_from_present.append(left)
        came_from_absent.append(joined)
    best = max(absent, present)
    return Presence(_runs(present >= absent, came_from_present, came_from_absent), best - none)


def _runs(is_present: bool, came_from_present: list[bool], came_from_absent: list[bool]) -> tuple[Run, ...]:
    """The runs of the path that ends in the state ``is_present``, by backtracking."""
    runs, end = list[Run](), len(came_from_present)
    for tick in range(len(came_from_present) - 1, -1, -1):
        if is_present and came_from_absent[tick]:
            runs.append(Run(tick, end))
            is_present = False
        elif not is_present and came_from_present[tick]:
            end, is_present = tick, True
    if is_present:
        runs.append(Run(0, end))
    return tuple(reversed(runs))
