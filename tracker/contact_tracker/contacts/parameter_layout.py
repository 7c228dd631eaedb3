"""Layout of a family's parameter vector, and which of its free directions are turns and shifts."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


class Form(NamedTuple):
    """Index of the first entry in x of: direction and point (or foot) of element 1, direction and foot of
    element 2, and offset of element 2. Negative where a family has none."""

    d1: int = -1
    q1: int = -1
    d2: int = -1
    q2: int = -1
    h: int = -1


@cache
def directions(form: Form) -> Index:
    """Entries of x that are unit vectors; the others are coordinates."""
    return np.array([d + i for d in (form.d1, form.d2) if d >= 0 for i in range(3)])


@cache
def turns(form: Form) -> Index:
    """Free directions (columns of ``Family.tangent``) that rotate an element."""
    return np.flatnonzero(_turns(form))


@cache
def shifts(form: Form) -> Index:
    """Free directions that translate a point, a line across itself, or a face; rows are affine in them."""
    return np.flatnonzero(~_turns(form))


def _turns(form: Form) -> NDArray[np.bool_]:
    free: list[bool] = []
    for d, q in ((form.d1, form.q1), (form.d2, form.q2)):
        free += [True] * 2 * (d >= 0) + [False] * (2 if d >= 0 else 3) * (q >= 0)
    return np.array(free + [False] * (form.h >= 0))
