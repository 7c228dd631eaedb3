"""Tell from the motion of a rigid object how it touches its world.

Nothing is imported here, so that the command line starts quickly; see the README for the functions to use.
"""

__version__ = "0.1.0"
