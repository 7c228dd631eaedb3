"""The viewer: beliefs and segments drawn with rerun, in a window or into a file.

Importing this package is cheap; ``views`` imports rerun.
"""

from typing import Final

SILENT: Final = "off,contact_tracker=off"
"""Value of ``RUST_LOG`` in this process that silences rerun's log; relevant failures are raised as errors."""
