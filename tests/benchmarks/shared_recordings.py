"""The recordings that are not part of the repository."""

import os
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_BESIDE: Final = ROOT.parent / "shared" / "recordings"
SHARED_RECORDINGS: Final = Path(os.environ.get("CONTACT_TRACKER_RECORDINGS") or _BESIDE)
"""The folder that ``CONTACT_TRACKER_RECORDINGS`` names, which may be missing; set to nothing is not set."""
