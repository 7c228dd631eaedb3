"""Identify the contacts of a rigid object with its surroundings from its motion.

Names are imported on first use, so that the command line starts quickly; ``typing`` is not imported, so that
an interrupt finds its handler (``__main__``) as early as possible.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from contact_tracker.api.learned_map import Map
    from contact_tracker.api.offline import Comparison, Result, compare, segment
    from contact_tracker.api.online import Tracker
    from contact_tracker.batch.lerobot import LeRobot
    from contact_tracker.errors import ContactTrackerError, ContactTrackerWarning
    from contact_tracker.sequences.plan import Plan, PlanFollower
    from contact_tracker.states import Contact
    from contact_tracker.tracking.belief import Belief, Segment
    from contact_tracker.trajectory import Trajectory, read
    from contact_tracker.version import __version__
    from contact_tracker.wrenches.wrenches import Wrenches

__all__ = [
    "Belief",
    "Comparison",
    "Contact",
    "ContactTrackerError",
    "ContactTrackerWarning",
    "LeRobot",
    "Map",
    "Plan",
    "PlanFollower",
    "Result",
    "Segment",
    "Tracker",
    "Trajectory",
    "Wrenches",
    "__version__",
    "compare",
    "evaluate",
    "read",
    "segment",
]

_NAMES = {
    "contact_tracker.api.learned_map": ("Map",),
    "contact_tracker.api.offline": ("Comparison", "Result", "compare", "segment"),
    "contact_tracker.api.online": ("Tracker",),
    "contact_tracker.batch.lerobot": ("LeRobot",),
    "contact_tracker.errors": ("ContactTrackerError", "ContactTrackerWarning"),
    "contact_tracker.sequences.plan": ("Plan", "PlanFollower"),
    "contact_tracker.states": ("Contact",),
    "contact_tracker.tracking.belief": ("Belief", "Segment"),
    "contact_tracker.trajectory": ("Trajectory", "read"),
    "contact_tracker.version": ("__version__",),
    "contact_tracker.wrenches.wrenches": ("Wrenches",),
    "contact_tracker_lab.evaluation.report": ("evaluate",),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> "Any":
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
