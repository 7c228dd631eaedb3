"""Poses from Python: a trajectory from arrays, tables and recordings, and checks of arguments."""

from contact_tracker.trajectory.trajectory import Trajectory, read, vertices_from_metadata

__all__ = ["Trajectory", "read", "vertices_from_metadata"]
