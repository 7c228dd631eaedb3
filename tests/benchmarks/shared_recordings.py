"""The recordings that are not part of the repository."""

import os
from pathlib import Path
from typing import Final

_BESIDE: Final = Path(__file__).resolve().parents[3] / "shared" / "recordings"
SHARED_RECORDINGS: Final = Path(os.environ.get("CONTACT_TRACKER_RECORDINGS") or _BESIDE)
"""The folder that ``CONTACT_TRACKER_RECORDINGS`` names, which may be missing; set to nothing is not set."""
