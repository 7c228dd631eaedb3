"""Quadratic prior on a contact's parameters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.vectors import dot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prior:
    """Cost ``1/2 x P x - information x + constant`` of x in nats.

    ``precision`` P (B, S, S), ``information`` (B, S), ``constant`` (B,); priors add up. ``flat`` (S,) is the
    precision of an unknown direction due to its finite sphere: it counts in volumes but has no gradient.
    """

    precision: Array
    information: Array
    constant: Array
    flat: Array

    @classmethod
    def around(cls, mean: Array, precision: Array, flat: Array) -> "Prior":
        """Gaussians around ``mean`` (B, S)."""
        information = np.einsum("bst,bt->bs", precision, mean)
        return cls(precision, information, 0.5 * np.einsum("bs,bs->b", information, mean), flat)

    def __add__(self, other: "Prior") -> "Prior":
        """Both together; ``flat`` is that of the first."""
        return Prior(
            self.precision + other.precision,
            self.information + other.information,
            self.constant + other.constant,
            self.flat,
        )

    def pick(self, rows: NDArray[np.generic]) -> "Prior":
        return Prior(self.precision[rows], self.information[rows], self.constant[rows], self.flat)

    def gradient(self, x: Array) -> Array:
        """Derivative (B, S) of the cost at x (B, S)."""
        return np.asarray((self.precision @ x[..., None])[..., 0] - self.information)

    def cost(self, x: Array) -> Array:
        """Half the squared distance (B,) of x (B, S) from the mean."""
        half = dot(x, self.gradient(x) - self.information)
        return np.asarray(0.5 * half + self.constant)
