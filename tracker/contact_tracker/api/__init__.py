"""The public functions and classes, which ``contact_tracker`` exports."""

from contact_tracker.api.learned_map import Map
from contact_tracker.api.offline import Result, segment
from contact_tracker.api.online import Tracker
from contact_tracker.trajectory import Trajectory, read

__all__ = ["Map", "Result", "Tracker", "Trajectory", "read", "segment"]
