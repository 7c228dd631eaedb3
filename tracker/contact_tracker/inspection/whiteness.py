"""Whether successive errors of a stream of poses are independent, as those of a raw sensor are.

Third differences of white noise have autocorrelations of -15/20, 6/20 and -1/20 at the lags 1 to 3. Filters
and interpolation change them; so does motion where it outweighs the noise. But motion grows with the cube of
the stride between the poses, and over a long stride a filter is forgotten: what is far from white at stride 1
and not much farther at a longer one was filtered.
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
STRIDES: Final[tuple[tuple[float, tuple[int, int, int], float], ...]] = (
    (0.0026, (1, 8, 16), 1.0),
    (0.0053, (1, 4, 8), 2.0),
    (0.0105, (1, 2, 4), 8.0),
    (0.035, (1, 2, 2), 40.0),
)
"""Longest interval (s), strides, and what oscillation may do.

Hands and robots move slowly against the longest stride, 70 ms at most. Where a share of the poses moves, all
mean products of signs depart towards 1 by this share; the last number times its square is the most by which
oscillations of up to 5 Hz (2.5 Hz at 30 Hz) miss that, as INFORMATION measures it.
"""
REACH: Final = 2 * LAGS * 16
"""Number of poses needed before a block."""
OUTLIER_SQ: Final = 36.0
"""Third differences longer than 6 times the median length are left out."""
ENOUGH: Final = 256
"""Least number of poses for the test."""
INFORMATION: Final = np.array([[59.9, 40.1, 9.3], [40.1, 40.6, 16.7], [9.3, 16.7, 13.1]])
"""Inverse covariance of the mean products of n poses of white noise, for n = 1: with it the squared departure
times n is chi-squared with three degrees of freedom. From 4000 simulated streams of 505 poses."""
TOWARDS_ONE: Final = 1.0 - SIGNS_OF_WHITE
FULLY: Final = float(TOWARDS_ONE @ INFORMATION @ TOWARDS_ONE)
CHI_SQ_THRESHOLD: Final = 30.0
"""Threshold of that chi-squared."""
SMALL: Final = 0.035
"""Squared departures below this are not reported: dropping every second frame gives up to 0.02."""
MOTION: Final = 1.3
"""Motion departs from white at a longer stride by more than this factor more; on recordings twice or more."""
NEAR_WHITE: Final = 0.6
"""Noise-free motion departs by more than this at any stride."""


class Whiteness(NamedTuple):
    """Running sums over pairs of third differences.

    ``products`` of their signs and ``pairs`` (3, 2, 3) are sums and the number of those that are not zero, by
    stride, position or orientation, and lag. ``blocks`` were compared; ``oscillation`` is the sum of the last
    column of STRIDES.
    """

    products: Array
    pairs: Array
    blocks: int
    oscillation: float


NOTHING_COMPARED: Final = Whiteness(np.zeros((3, 2, LAGS)), np.zeros((3, 2, LAGS)), 0, 0.0)


def compare(whiteness: Whiteness, smooth: Array, new: int, interval_s: float) -> Whiteness:
    """Add a block of poses, at stride 1 and, by turns, at one of the longer ones.

    Parameters
    ----------
    smooth : (REACH + new, 6), position (m) and rotation integrated in the body's axes (rad), one pose a row.
    new : so many rows at the end are new.
    interval_s : typical interval of the block.
    """
    fitting = (row for row in STRIDES if interval_s <= row[0])
    _, strides, oscillation = next(fitting, (0.0, None, 0.0))
    if strides is None:
        return whiteness
    products, pairs = whiteness.products.copy(), whiteness.pairs.copy()
    for row in (0, 1 + whiteness.blocks % 2):
        stride = strides[row]
        signs = _signs(smooth[-new - 2 * LAGS * stride :], stride)
        shifted = np.stack([signs[(LAGS - lag) * stride :][:new] for lag in range(1, LAGS + 1)])
        sums = (shifted * signs[LAGS * stride :]).sum(axis=1).reshape(LAGS, 4, 3).sum(axis=2).T
        products[row] += sums[:2]
        pairs[row] += sums[2:]
    return Whiteness(products, pairs, whiteness.blocks + 1, whiteness.oscillation + oscillation)


def is_filtered(whiteness: Whiteness) -> bool:
    """Whether the errors are correlated in a way that motion cannot explain."""
    products, pairs, blocks, oscillation = whiteness
    count = float(pairs[0].sum()) / (6.0 * LAGS)
    if count < ENOUGH:
        return False
    both = products[0].sum(axis=0) / np.maximum(pairs[0].sum(axis=0), 1.0) - SIGNS_OF_WHITE
    moving = max(float(TOWARDS_ONE @ INFORMATION @ both) / FULLY, 0.0)
    rest = both - moving * TOWARDS_ONE
    if rest @ INFORMATION @ rest <= SMALL + CHI_SQ_THRESHOLD / count + oscillation / blocks * moving**2:
        return False
    departure = np.linalg.norm(products / np.maximum(pairs, 1.0) - SIGNS_OF_WHITE, axis=2)
    nearer = departure[1:] < np.minimum(MOTION * departure[0], NEAR_WHITE)
    return bool((nearer & (pairs.min(axis=(0, 2)) > ENOUGH)).any())


def _signs(smooth: Array, stride: int) -> Array:
    """Signs of third differences and their squares (n, 12), 0 for those of outliers."""
    first = smooth[stride:] - smooth[:-stride]
    second = first[stride:] - first[:-stride]
    third = (second[stride:] - second[:-stride]).reshape(-1, 2, 3)
    length_sq = np.einsum("nsi,nsi->ns", third, third)
    middle = np.partition(length_sq, len(length_sq) // 2, axis=0)[len(length_sq) // 2]
    signs = np.sign(third) * (length_sq < OUTLIER_SQ * middle)[:, :, None]
    return np.concatenate([signs, np.abs(signs)], axis=1).reshape(-1, 12)
