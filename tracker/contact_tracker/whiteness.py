"""Whether successive errors of a stream of poses are independent, as those of a raw sensor are.

Third differences of white noise have autocorrelations of -15/20, 6/20 and -1/20 at the lags 1 to 3. Filters and
interpolation change them; so does motion where it outweighs the noise, but motion grows with the cube of the
stride between the poses and a short filter is outgrown by it: what is far from white at stride 1 and nearer to
white at a longer one was filtered.
"""

from math import asin, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LAGS: Final = 3
SIGNS_OF_WHITE: Final = np.array([2.0 / pi * asin(r) for r in (-15 / 20, 6 / 20, -1 / 20)])
"""Mean product of the signs of two Gaussian variables with correlation r is 2/pi asin(r), whatever their
variances: so it holds for noise that differs between axes and times, and single outliers count little."""
STRIDES: Final = ((0.0026, (1, 8, 16)), (0.0053, (1, 4, 8)), (0.0105, (1, 2, 4)), (0.035, (1, 2, 2)))
"""Longest interval (s), strides: hands and robots move slowly against the longest stride (at most 70 ms)."""
REACH: Final = 2 * LAGS * 16
"""So many poses before a block are needed."""
OUTLIER_SQ: Final = 36.0
"""Third differences longer than 6 times the median length are left out."""
ENOUGH: Final = 256
"""Fewer poses say nothing."""
DEPARTURE_SQ: Final = 0.05**2
SAMPLING: Final = 5.0
"""n poses of white noise depart from SIGNS_OF_WHITE by a square of 0.7 / n in the mean, three lags together."""
NEAR_WHITE: Final = 0.6
"""Noise-free motion departs by more than this at any stride."""


class Whiteness(NamedTuple):
    """Running sums over pairs of third differences: ``products`` (3, 2, 3) of their signs and ``pairs``
    (3, 2, 3), the number of those that are not zero; by stride, position or orientation, and lag."""

    products: Array
    pairs: Array


NOTHING_COMPARED: Final = Whiteness(np.zeros((3, 2, LAGS)), np.zeros((3, 2, LAGS)))


def compare(whiteness: Whiteness, smooth: Array, new: int, interval_s: float) -> Whiteness:
    """Add a block of poses.

    Parameters
    ----------
    smooth : (REACH + new, 6), position (m) and rotation integrated in the body's axes (rad), one pose a row.
    new : so many rows at the end are new.
    interval_s : typical interval of the block.
    """
    strides = next((strides for longest, strides in STRIDES if interval_s <= longest), None)
    if strides is None:
        return whiteness
    products, pairs = whiteness.products.copy(), whiteness.pairs.copy()
    for row, stride in enumerate(strides):
        signs = _signs(smooth[-new - 2 * LAGS * stride :], stride)
        shifted = np.stack([signs[(LAGS - lag) * stride :][:new] for lag in range(1, LAGS + 1)])
        product = shifted * signs[LAGS * stride :]
        products[row] += product.sum(axis=1).reshape(LAGS, 2, 3).sum(axis=2).T
        pairs[row] += np.abs(product).sum(axis=1).reshape(LAGS, 2, 3).sum(axis=2).T
    return Whiteness(products, pairs)


def is_filtered(whiteness: Whiteness) -> bool:
    """Whether the errors are correlated in a way that motion cannot explain."""
    products, pairs = whiteness
    count = pairs[0].max() / 3.0
    if count < ENOUGH:
        return False
    both = products[0].sum(axis=0) / np.maximum(pairs[0].sum(axis=0), 1.0) - SIGNS_OF_WHITE
    if both @ both <= DEPARTURE_SQ + SAMPLING / count:
        return False
    departure = np.linalg.norm(products / np.maximum(pairs, 1.0) - SIGNS_OF_WHITE, axis=2)
    known = pairs.min(axis=(0, 2)) > ENOUGH
    nearer = departure[1:] < np.minimum(departure[0], NEAR_WHITE)
    return bool((nearer & known).any())


def _signs(smooth: Array, stride: int) -> Array:
    """Signs of third differences (n, 6), 0 for those of outliers."""
    first = smooth[stride:] - smooth[:-stride]
    second = first[stride:] - first[:-stride]
    third = second[stride:] - second[:-stride]
    length_sq = np.square(third).reshape(-1, 2, 3).sum(axis=2)
    middle = np.partition(length_sq, len(length_sq) // 2, axis=0)[len(length_sq) // 2]
    usual = length_sq < OUTLIER_SQ * middle
    return np.asarray((np.sign(third).reshape(-1, 2, 3) * usual[:, :, None]).reshape(-1, 6))
