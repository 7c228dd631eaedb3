"""The viewer: what is believed, drawn with rerun into its window or into a file.

Importing this package costs nothing; ``offline`` and ``live`` import rerun. Whoever shows a live view only
when asked takes ``absent`` otherwise.
"""

from typing import Final

SILENT: Final = "off,contact_tracker=off"
"""As ``RUST_LOG`` of this process: rerun keeps its log to itself; what matters of it is an error of ours."""
