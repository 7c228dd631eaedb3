"""What is doubtful, as Python's own warnings, and counts, as messages of the logger ``contact_tracker``."""

import logging
import sys
import warnings
from collections.abc import Iterable, Mapping
from types import FrameType
from typing import Final

from contact_tracker.errors import ContactTrackerWarning, printable

_PACKAGE: Final = __name__.partition(".")[0]
_LOGGER: Final = logging.getLogger(_PACKAGE)


def warn_of(texts: Iterable[str]) -> None:
    """Raise a warning for each text, at the user's line.

    It has no registry, in which Python would note that this line has warned of the same before: that was of
    another recording.
    """
    for text in texts:
        caller = _caller()
        module = str(caller.f_globals.get("__name__", "<unknown>"))
        place = caller.f_code.co_filename, caller.f_lineno
        warnings.warn_explicit(printable(text), ContactTrackerWarning, *place, module)


def log_counts(name: str, counts: Mapping[str, int]) -> None:
    """Log the numbers of dropped and repaired poses at the level INFO."""
    if counts and _LOGGER.isEnabledFor(logging.INFO):
        noted = ", ".join(f"{kind} {count}" for kind, count in counts.items())
        _LOGGER.info("%s: noted: %s", printable(name), noted)


def log_text(text: str) -> None:
    """Log a message at the level INFO."""
    _LOGGER.info("%s", printable(text))


def _caller() -> FrameType:
    """The innermost frame outside of the package; the outermost of all if there is none."""
    frame = sys._getframe()
    while frame.f_back is not None and _is_ours(frame):
        frame = frame.f_back
    return frame


def _is_ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] == _PACKAGE
