"""The public functions and classes of ``contact_tracker``."""

from contact_tracker.api.learned_map import Map
from contact_tracker.api.offline import Comparison, Result, compare, segment
from contact_tracker.api.online import Tracker
from contact_tracker.sequences.plan import Plan, PlanFollower
from contact_tracker.trajectory import Trajectory, read

__all__ = [
    "Comparison",
    "Map",
    "Plan",
    "PlanFollower",
    "Result",
    "Tracker",
    "Trajectory",
    "compare",
    "read",
    "segment",
]
