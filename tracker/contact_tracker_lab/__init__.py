"""The lab of ``contact_tracker``: simulation, calibration and evaluation.

The lab imports the tracker, never the other way round; the command line finds the lab's commands by name.
"""
