"""Measured wrenches: the contact wrench between object and surroundings, and the evidence of its line of
action for contacts."""
