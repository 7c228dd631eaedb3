"""Kernels for ``hypotheses`` and all below, ``bank.prune`` and ``paper.batched``, where numba is installed.

The numpy code there is the reference, and what runs without numba. What imports numba is imported only when
the first fit needs it.
"""

import os
import warnings
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Final

SWITCH: Final = "CONTACT_TRACKER_COMPILED"
"""Environment variable; 0 means numpy."""


@cache
def in_use() -> bool:
    """Whether kernels are compiled; what is so at first remains so."""
    return os.environ.get(SWITCH) != "0" and find_spec("numba") is not None and not _fault()


@cache
def _fault() -> str:
    """Why numba, which is installed, cannot be used: it follows numpy with some delay."""
    try:
        import_module("contact_tracker.compiled.jit")
    except (ImportError, AttributeError, SystemError, OSError) as error:
        reason = " ".join(str(error).split())
        warnings.warn(f"nothing is compiled, numba cannot be imported: {reason}", stacklevel=2)
        return reason
    return ""


def is_ready() -> bool:
    """Whether the largest kernel has been compiled, which takes about a minute; in numpy all is ready."""
    if not in_use():
        return True
    jit, advancing = (import_module(f"contact_tracker.compiled.{name}") for name in ("jit", "advancing"))
    ready: bool = jit.is_kept(advancing.advance)
    return ready


def described() -> str:
    """Which of both is in use, in words."""
    if os.environ.get(SWITCH) == "0":
        return f"numpy, {SWITCH}=0"
    if in_use():
        return f"compiled kernels, numba {version('numba')}"
    return "numpy; numba cannot be imported" if find_spec("numba") else "numpy; numba is not installed"
