"""Where in its parameter vector a family keeps what, and which of its free directions turn or shift."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


class Form(NamedTuple):
    """Where in x a family keeps what: the first entries of direction and point (or foot) of element 1, of
    direction and foot of element 2, and the offset of element 2. What it does not have is negative."""

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
    """Free directions (columns of ``Family.tangent``) that turn an element."""
    return np.flatnonzero(_turns(form))


@cache
def shifts(form: Form) -> Index:
    """The other ones, that shift a point, a line across itself, or a face: in them rows are affine."""
    return np.flatnonzero(~_turns(form))


def _turns(form: Form) -> NDArray[np.bool_]:
    free: list[bool] = []
    for d, q in ((form.d1, form.q1), (form.d2, form.q2)):
        free += [True] * 2 * (d >= 0) + [False] * (2 if d >= 0 else 3) * (q >= 0)
    return np.array(free + [False] * (form.h >= 0))
