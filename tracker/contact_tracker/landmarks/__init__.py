"""The prior map, and the association of elements."""
