"""Joints as models of motion with few degrees of freedom: hinge, slider, screw, ball (docs/theory.md, section
20)."""
