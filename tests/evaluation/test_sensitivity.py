"""Sensitivity to tuned constants: found in the source, multiplied before import, compared in a table."""

from pathlib import Path

import pytest

import contact_tracker
from sensitivity import Constant, basis_of, run_apart, tuned_constants

LOG = Path(__file__).parents[2] / "recordings" / "robot_1khz.mcap"
CONSTANTS = {one.name: one for one in tuned_constants(Path(contact_tracker.__file__).parent)}


def test_constants_are_numbers_with_their_modules() -> None:
    found = CONSTANTS["OPEN_AT_MOST"]
    assert found == Constant("contact_tracker.tracking.ambiguity", "OPEN_AT_MOST", "0.9", 0.9)
    assert found.label == "tracking/ambiguity.py: OPEN_AT_MOST"
    assert len(CONSTANTS) > 100
    assert "SHORT_OF_TIE" in CONSTANTS  # an expression of numbers
    assert "NOT_EXCLUDED" not in CONSTANTS  # derived from another one
    assert "LEAST_SHARE" not in CONSTANTS  # a guard against rounding


@pytest.mark.long
def test_a_constant_is_multiplied_in_a_process_of_its_own() -> None:
    """Half the bound of open labels changes probabilities; the tracker of this process stays as it is."""
    base = run_apart(None, 1.0, [LOG], 3.0)
    other = run_apart(CONSTANTS["OPEN_AT_MOST"], 0.5, [LOG], 3.0)
    assert not base.error + other.error
    assert other.digest != base.digest
    assert list(base.accuracy) == ["recordings"]
    assert "no such file" in run_apart(None, 1.0, [Path("gone.mcap")], 3.0).error


def test_outcomes_are_of_recordings_and_their_length() -> None:
    assert basis_of([LOG], 3.0) == basis_of([LOG], 3.0)
    assert len({basis_of([LOG], 3.0), basis_of([LOG], 4.0), basis_of([LOG.parent], 3.0)}) == 3
