"""Saving the state of a stream to a file, to resume it after a restart."""

from contact_tracker.saved_state.encoding import is_same
from contact_tracker.saved_state.state_file import continued, load, save

__all__ = ["continued", "is_same", "load", "save"]
