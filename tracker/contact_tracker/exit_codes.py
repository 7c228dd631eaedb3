"""Exit codes of the commands (see docs/conventions.md), and of single recordings in a batch."""

from typing import Final

DONE: Final = 0
INPUT: Final = 1
USAGE: Final = 2
DAMAGED: Final = 3
UNEXPECTED: Final = 70
"""Of a recording in a batch: a fault of this package."""
INTERRUPTED: Final = 130
KILLED: Final = 137
"""Of a recording in a batch: the processes that segmented it were killed."""
