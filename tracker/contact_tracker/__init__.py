"""Identify the contacts of a rigid object with its surroundings from its motion.

Names are imported on first use, so that the command line starts quickly; ``typing`` is not imported, so that
an interrupt finds its handler (``__main__``) as early as possible.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from contact_tracker.api import Result, Tracker, Trajectory, evaluate, read, segment
    from contact_tracker.errors import ContactTrackerError, ContactTrackerWarning
    from contact_tracker.states import Contact
    from contact_tracker.tracking.belief import Belief, Segment
    from contact_tracker.wrenches.wrenches import Wrenches

__version__ = "0.1.0"

__all__ = [
    "Belief",
    "Contact",
    "ContactTrackerError",
    "ContactTrackerWarning",
    "Result",
    "Segment",
    "Tracker",
    "Trajectory",
    "Wrenches",
    "__version__",
    "evaluate",
    "read",
    "segment",
]

_HOMES = {
    "Belief": "tracking.belief",
    "Contact": "states",
    "ContactTrackerError": "errors",
    "ContactTrackerWarning": "errors",
    "Result": "api",
    "Segment": "tracking.belief",
    "Tracker": "api",
    "Trajectory": "api",
    "Wrenches": "wrenches.wrenches",
    "evaluate": "api",
    "read": "api",
    "segment": "api",
}


def __getattr__(name: str) -> "Any":
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
