"""The prior map, the memory of landmarks, and the association of elements."""
