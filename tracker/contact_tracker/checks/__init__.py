"""Checks of a stream and of its map, whose findings warn the user of wrong labels."""
