"""Saving the state of a stream to a file, to resume it after a restart."""

from contact_tracker.saved_state.encoding import fingerprint, is_same
from contact_tracker.saved_state.state_file import continued, load, save

__all__ = ["continued", "fingerprint", "is_same", "load", "save"]
