"""The functions and classes that programs use; ``contact_tracker`` itself hands them out."""

from contact_tracker.api.offline import Result, segment
from contact_tracker.api.online import Tracker
from contact_tracker.api.trajectory import Trajectory, read

__all__ = ["Result", "Tracker", "Trajectory", "read", "segment"]
