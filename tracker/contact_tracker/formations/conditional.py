"""How much better does a further contact explain ticks than motion that keeps the contacts known before?

Whatever these imply holds without a further contact as well, and is no evidence for one
(docs/theory.md, T35).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion import lifted_pose
from contact_tracker.motion.used_directions import LEVER_M
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]

SAME_ROW: Final = 0.05
"""Constraints whose gradients, of unit length, differ by less are one."""
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
    """Of W ticks, for a further contact against motion that does without it, in nats."""

    log_ratio: Array
    """(W,)"""
    gain: Array
    """(W,) what the log ratio would be without residuals."""
    chi_sq: Array
    """(W,) mean square of the residuals over their noise."""


@dataclass(frozen=True, eq=False)
class ConditionalMotion:
    """W ticks in which an object keeps some contacts, and how it could have moved meanwhile.

    Parameters
    ----------
    new : (W, 25) lifted poses, of errors that last only what is new in them (T34).
    moved : (W, 6, 25) what they change by when the pose turns about the body's axes or shifts along the
        world's.
    noise_sd : (W, 6) deviations of a tick in these directions.
    excess_sd : (W, 6) and of what could not be predicted of the motion in it.
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
        moved = (zeta @ _MOVES.reshape(-1, lifted_pose.SIZE).T).reshape(len(zeta), 6, lifted_pose.SIZE)
        excess_sd = np.sqrt(window.innovation_excess[:, lifted_pose.NOISE_OF_PERTURBATION])
        free = excess_sd[:, :, None] * np.eye(6)
        return cls(
            new, moved, np.sqrt(window.variance[:, lifted_pose.NOISE_OF_PERTURBATION]), excess_sd, free
        )

    def keeping(self, c: Array, first: int = 0, end: int | None = None) -> "ConditionalMotion":
        """The same motion where the ticks from ``first`` to ``end`` keep the constraints c (K, 25), too."""
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
        """Some ticks."""
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
        """For a contact with the constraints c (K, 25), tick by tick."""
        gradient, residual = self.gradients(c), self.new @ c.T
        noise, free = gradient * self.noise_sd[:, None], gradient @ self.free
        scale = np.sqrt(np.square(noise).sum(axis=2)) + TINY  # nothing depends on the units of a row
        noise, free, residual = noise / scale[..., None], free / scale[..., None], residual / scale
        held = noise @ np.swapaxes(noise, 1, 2) + JITTER * np.eye(len(c))
        loose = held + free @ np.swapaxes(free, 1, 2)
        gain = 0.5 * (np.linalg.slogdet(loose)[1] - np.linalg.slogdet(held)[1])
        pull = np.linalg.solve(held, residual[..., None]) - np.linalg.solve(loose, residual[..., None])
        misfit = 0.5 * (residual * pull[..., 0]).sum(axis=1)
        return ConditionalEvidence(gain - misfit, gain, np.square(residual).mean(axis=1))


def count_constraints(motion: ConditionalMotion, contacts: Sequence[Array]) -> int:
    """How many independent constraints contacts c (K, 25) put on the motion together, in the median tick."""
    rows = motion.gradients(np.concatenate(contacts)) * np.repeat([1.0, LEVER_M], 3)
    rows /= np.linalg.norm(rows, axis=2, keepdims=True) + TINY
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.median((values > SAME_ROW).sum(axis=1)))
