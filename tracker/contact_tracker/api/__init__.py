"""The public functions and classes of ``contact_tracker``: offline, online, and the map of a recording."""
