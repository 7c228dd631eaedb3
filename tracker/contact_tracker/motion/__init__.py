"""Poses, how they become ticks, and what is learned of their noise and of free motion."""
