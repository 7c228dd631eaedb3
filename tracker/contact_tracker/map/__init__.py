"""The map: elements of the object and of its surroundings, listed by the user or touched before."""
