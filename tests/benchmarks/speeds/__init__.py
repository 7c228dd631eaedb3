"""Measurements of speed.py, a file for each row of its table."""
