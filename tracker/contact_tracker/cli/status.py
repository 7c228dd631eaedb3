"""Exit codes, as the README promises them."""

from typing import Final

DONE: Final = 0
INPUT: Final = 1
USAGE: Final = 2
DAMAGED: Final = 3
INTERRUPTED: Final = 130
