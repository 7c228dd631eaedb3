"""The lab's commands of ``contact-tracker``: a file each, as in ``contact_tracker.cli``."""
