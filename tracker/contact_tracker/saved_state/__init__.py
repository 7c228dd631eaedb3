"""The state of a stream in a file: what was known of it carries on after a restart."""

from contact_tracker.saved_state.encoding import is_same
from contact_tracker.saved_state.progress import Progress
from contact_tracker.saved_state.state_file import load, save

__all__ = ["Progress", "is_same", "load", "save"]
