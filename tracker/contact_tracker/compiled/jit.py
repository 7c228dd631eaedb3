"""The one place that knows numba: what is compiled, and what is kept on disk."""

import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import numba
from numba.core.options import DefaultOptions

from contact_tracker import fit, pace
from contact_tracker.contacts import edge_edge, form, vertex_face
from contact_tracker.paper import batched

P = ParamSpec("P")
R = TypeVar("R")
_njit: Any = numba.njit
if not hasattr(DefaultOptions, "_nrt"):
    raise ImportError("this version does not compile without reference counts")
_OTHERS: Final = (
    batched.__file__,
    fit.__file__,
    pace.__file__,
    edge_edge.__file__,
    form.__file__,
    vertex_face.__file__,
)
_READ: Final = (*sorted(Path(__file__).parent.glob("*.py")), *map(Path, _OTHERS))
_SOURCES: Final = sha256(b"".join(path.read_bytes() for path in _READ)).hexdigest()
"""Of the code here and of what it takes constants from."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """A part of kernels, compiled into each: calls would hand over hundreds of words of arrays.

    It works in the memory that it is handed, and hands no array back to a ``kernel``: to count who holds
    which array, at every look at a row, takes numba longer than all the arithmetic.
    """
    compiled: Callable[P, R] = _njit(function, error_model="numpy", forceinline=True, _nrt=False)
    return compiled


def part(function: Callable[P, R]) -> Callable[P, R]:
    """As ``jit``, of what is large and called seldom: it is compiled once."""
    compiled: Callable[P, R] = _njit(function, error_model="numpy", _nrt=False)
    return compiled


def memory(function: Callable[P, R]) -> Callable[P, R]:
    """A part of kernels that makes arrays."""
    compiled: Callable[P, R] = _njit(function, error_model="numpy", forceinline=True)
    return compiled


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compiled when it is first called, which takes seconds, and kept where there is a folder to write to.

    It is kept by a name that tells of all its parts: numba itself looks only at the kernel's own file to see
    whether what it has kept is still true, and fails at what an older version has left. That is never read
    again, and remains.
    """
    function.__qualname__ = f"{function.__name__}_{_SOURCES[:16]}"
    try:
        compiled: Callable[P, R] = _njit(function, error_model="numpy", cache=True)
    except RuntimeError:  # numba finds no folder
        return memory(function)
    return compiled


def is_kept(kernel: Any) -> bool:
    """Whether it has been compiled, now or by an earlier run of this Python; if numba compiles at all."""
    if not hasattr(kernel, "signatures") or kernel.signatures:
        return True
    folder, name = kernel.stats.cache_path, kernel.py_func.__qualname__
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    return folder is not None and any(Path(folder).glob(f"*.{name}-*.{python}*.nbi"))
