"""Where in its parameter vector a family keeps what, and which of its free directions are alike."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Form(NamedTuple):
    """Where in x a family keeps what: the first entries of direction and point (or foot) of element 1, of
    direction and foot of element 2, and the offset of element 2. What it does not have is negative."""

    d1: int = -1
    q1: int = -1
    d2: int = -1
    q2: int = -1
    h: int = -1


@cache
def mean_of_alike(form: Form) -> Array:
    """(P, P): means over free directions that are alike, whatever basis they are written in: turns of an
    element, shifts of a line or a point, an offset."""
    sizes: list[int] = []
    for d, q in ((form.d1, form.q1), (form.d2, form.q2)):
        sizes += [2] * (d >= 0) + [2 if d >= 0 else 3] * (q >= 0)
    alike = np.repeat(np.arange(len(sizes) + 1), [*sizes, form.h >= 0])
    same = alike[:, None] == alike
    return np.asarray(same / same.sum(axis=1))
