"""Checks of a stream of poses for mistakes in recording it: units, two bodies, filters, conventions."""
