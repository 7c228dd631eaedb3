"""Measured wrenches: what acts between object and surroundings, and what its line of action says of the
contact."""
