"""The compiled work of a tick on the hypotheses: C++ (``tracker/core``), built as the package is installed.

Without a compiler its numpy references, such as ``bank_update.update_reference``, do the work: some 20 times
slower, with a warning. The kernels are imported when a tracker starts.
"""

import os
import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from contact_tracker.errors import SlowUpdate
from contact_tracker.hypotheses.compiled.sources import fingerprint

SWITCH: Final = "CONTACT_TRACKER_COMPILED"
"""Environment variable; 0 means numpy."""
NAME: Final = "contact_tracker.hypotheses.compiled.kernels"
SOURCES: Final = Path(__file__).parents[3] / "core"
"""Sources in a work tree. An installed package has none; a folder of that name beside it may be another's."""


@cache
def in_use() -> bool:
    """Whether the kernels are used; decided once."""
    if os.environ.get(SWITCH) == "0":
        return False
    if not (why := fault()):
        return True
    warnings.warn(SlowUpdate(f"runs in numpy, some 20 times slower: {why}"), stacklevel=2)
    return False


@cache
def fault() -> str:
    """Why kernels are missing or unusable, and what to do."""
    if find_spec(NAME) is None:
        return "no kernels were built; install a C++ compiler (g++, clang or MSVC), then the package again"
    try:
        kernels = import_module(NAME)
    except ImportError as error:
        if (reason := error.__cause__) is not None and not isinstance(reason, Exception):
            raise reason from None  # an interrupt or a signal that came meanwhile
        return f"they cannot be loaded, {' '.join(str(error).split())}"
    if (SOURCES / "python" / "module.cpp").is_file() and fingerprint(SOURCES) != kernels.FINGERPRINT:
        return "their sources have changed since, install the package again"
    return ""


def described() -> str:
    """Which of the two is in use, as text."""
    if os.environ.get(SWITCH) == "0":
        return f"numpy, {SWITCH}=0"
    return f"numpy: {fault()}" if fault() else "compiled kernels"
