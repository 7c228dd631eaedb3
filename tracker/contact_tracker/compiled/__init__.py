"""Kernels that do what ``fit`` and ``evidence`` do, compiled with numba, where that is installed.

The numpy code there is the reference, and what runs without numba. What imports numba is imported only when
the first fit needs it.
"""

import os
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from typing import Final

SWITCH: Final = "CONTACT_TRACKER_COMPILED"
"""Environment variable; 0 means numpy."""


@cache
def in_use() -> bool:
    """Whether kernels are compiled; what is so at first remains so."""
    return os.environ.get(SWITCH) != "0" and find_spec("numba") is not None


def described() -> str:
    """Which of both is in use, in words."""
    if in_use():
        return f"compiled kernels, numba {version('numba')}"
    return f"numpy, {SWITCH}=0" if os.environ.get(SWITCH) == "0" else "numpy; numba is not installed"
