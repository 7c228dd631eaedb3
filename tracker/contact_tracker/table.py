"""How hypotheses lie in memory: a row each, in words of eight bytes. One copy moves all that is known of them
and kernels see them as numbers."""

from functools import cache
from typing import Any, Final

import numpy as np

from contact_tracker.contacts import ContactModel

WORD: Final = 8


@cache
def layout(model: ContactModel) -> np.dtype[Any]:
    """Type of a row of ``Bank``; flags are whole numbers."""
    family = model.family
    c, s, k, p = len(family.COLUMNS), family.SIZE, family.ROWS, family.PARAMETERS
    whole = ("onset", "onset_ns", "number", "source", "pair", "certain", "searched", "met")
    single = ("entry", "weight", "told", "lasted", "settled", "earned", "log_likelihood", "rms")
    more = {
        "x": (s,), "row_weight": (k,), "place_sum": (3,), "pivot": (6,), "first": (c,), "known_mean": (s,),
        "moments": (c, c), "hessian": (k, p, p), "known": (s, s),
    }  # fmt: skip
    numbers: list[Any] = [(name, np.int64) for name in whole]
    numbers += [(name, np.float64) for name in single]
    return np.dtype([*numbers, *((name, np.float64, shape) for name, shape in more.items())])
