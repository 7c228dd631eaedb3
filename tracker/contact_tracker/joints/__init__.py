"""Joints: motion of few degrees of freedom, whatever keeps it so (docs/theory.md, section 20)."""
