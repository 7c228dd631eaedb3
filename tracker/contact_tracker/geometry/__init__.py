"""Rotations, and the planes, lines and points that touch."""
