"""Shared fixtures, and settings of all property tests."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from shared_recordings import SHARED_RECORDINGS

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # each process that tests start would compile all modules

settings.register_profile(
    "busy", deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("busy")  # other load on the machine must not fail property tests


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each process consecutive tests, since those of a file share recordings and segmentations; one that
    has no more takes half of what another still has, so that none waits for the longest file."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


@pytest.fixture(scope="session")
def shared_recordings() -> Path:
    """Folder of recordings that are not part of the repository; a test that needs it is skipped without."""
    if not SHARED_RECORDINGS.is_dir():
        pytest.skip("the shared recordings are not here; CONTACT_TRACKER_RECORDINGS may name their folder")
    return SHARED_RECORDINGS
