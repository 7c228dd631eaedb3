"""Kernels for what every tick does, averaging, ``sliding``, ``hypotheses``, ``hmm``, what is told of it;
``given`` and ``polish``; and ``paper.batched``.

They are C++ (``tracker/kernels``), which is built when the package is installed. The numpy code is the
reference, and what runs where there was no compiler. They are imported when a tracker starts.
"""

import os
import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from contact_tracker.compiled.sources import fingerprint

SWITCH: Final = "CONTACT_TRACKER_COMPILED"
"""Environment variable; 0 means numpy."""
NAME: Final = "contact_tracker.compiled.kernels"
SOURCES: Final = Path(__file__).parents[2] / "kernels"
"""In a work tree; an installed package has none, and may have another one's folder of that name beside it."""


@cache
def in_use() -> bool:
    """Whether kernels are used; what is so at first remains so."""
    if os.environ.get(SWITCH) == "0" or find_spec(NAME) is None:
        return False
    if fault():
        warnings.warn(f"numpy does the work of the kernels: {fault()}", stacklevel=2)
    return not fault()


@cache
def fault() -> str:
    """Why kernels that were built are of no use."""
    try:
        kernels = import_module(NAME)
    except ImportError as error:
        if (reason := error.__cause__) is not None and not isinstance(reason, Exception):
            raise reason from None  # an interrupt or a signal that came meanwhile
        return f"they cannot be loaded, {' '.join(str(error).split())}"
    if (SOURCES / "module.cpp").is_file() and fingerprint(SOURCES) != kernels.FINGERPRINT:
        return "their sources have changed since, install the package again"
    return ""


def described() -> str:
    """Which of both is in use, in words."""
    if os.environ.get(SWITCH) == "0":
        return f"numpy, {SWITCH}=0"
    if find_spec(NAME) is None:
        return "numpy; no kernels were built for this Python, pip install -v says why"
    return f"numpy instead of kernels: {fault()}" if fault() else "compiled kernels"
