"""The one place that knows numba: what is compiled, and what is kept on disk."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import numba

from contact_tracker.contacts.edge_edge import SINE_SQ_FLOOR, TINY
from contact_tracker.fit import LEAST_CURVATURE, LEAST_SHARE

P = ParamSpec("P")
R = TypeVar("R")
_njit: Any = numba.njit
SOURCES: Final = sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    + repr((SINE_SQ_FLOOR, TINY, LEAST_CURVATURE, LEAST_SHARE)).encode()
).hexdigest()
"""Of the code here and the constants in it. To see whether what it kept is still true, numba looks only at
the file of a kernel and at what the kernel closes over: those that close over this are compiled anew when any
file changes."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """A part of kernels, compiled into each: calls would hand over hundreds of words of arrays."""
    compiled: Callable[P, R] = _njit(function, error_model="numpy", forceinline=True)
    return compiled


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compiled when it is first called, which takes seconds, and kept where there is a folder to write to."""
    try:
        compiled: Callable[P, R] = _njit(function, error_model="numpy", cache=True)
    except RuntimeError:  # numba finds no folder
        return jit(function)
    return compiled
