"""Tell from the motion of a rigid object how it touches its world.

Nothing is imported here, so that the command line starts quickly; see the README for the functions to use.
"""

from typing import Final

__version__: Final = "0.1.0"
