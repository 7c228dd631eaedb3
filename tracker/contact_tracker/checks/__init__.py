"""Checks of a stream and of its map: what the user has to know, because labels may be wrong otherwise."""
