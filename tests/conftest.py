"""Fixtures that several test files share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_recordings() -> Path:
    """Folder of recordings that are not part of the repository; a test that needs it is skipped without."""
    beside = Path(__file__).resolve().parent.parent.parent / "shared" / "recordings"
    folder = Path(os.environ.get("CONTACT_TRACKER_RECORDINGS", beside))
    if not folder.is_dir():
        pytest.skip("the shared recordings are not here; CONTACT_TRACKER_RECORDINGS may name their folder")
    return folder
