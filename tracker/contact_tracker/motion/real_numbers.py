"""Conversion of users' numbers to floats, without what ``float`` and numpy take for numbers, too: text, truth
values and complex numbers."""

from math import nan
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_NO_NUMBERS: Final = (bool, np.bool_, complex, np.complexfloating, str, bytes)


def real_number(value: Any) -> float:
    """``value`` as a float; raises TypeError, ValueError or OverflowError if it is no real number."""
    if isinstance(value, _NO_NUMBERS):
        raise TypeError(f"{value!r} is no real number")
    return float(value)


def real_numbers(values: ArrayLike) -> NDArray[np.float64]:
    """Numbers as floats, masked and absent ones as NaN; raises as ``real_number``."""
    given: np.ma.MaskedArray[Any, Any] = np.ma.asanyarray(values)
    if given.dtype.kind == "O":
        hidden = np.ma.getmaskarray(given).flat
        pairs = zip(np.ma.getdata(given).flat, hidden, strict=True)
        floats = [nan if hides or one is None else real_number(one) for one, hides in pairs]
        return np.array(floats, float).reshape(given.shape)
    if given.dtype.kind not in "iuf":
        raise TypeError(f"{given.dtype} is no type of real numbers")
    return np.asarray(np.ma.filled(given.astype(float), nan))
