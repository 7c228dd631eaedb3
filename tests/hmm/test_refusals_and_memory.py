"""Invalid input of the forward filter, and the memory of open ticks."""

from itertools import pairwise

import numpy as np
import pytest

from contact_tracker.hmm.forward_filter import ForwardFilter, ForwardMessage
from contact_tracker.hmm.smoother import OpenTicks

CHANGE = np.log(np.full((2, 2), 0.5))


def begun() -> ForwardFilter:
    running = ForwardFilter(np.log([0.5, 0.5]))
    running.advance(np.array([0, 1]), np.array([0, 0]), np.zeros(2), CHANGE)
    return running


def test_a_hypothesis_with_an_unknown_onset_is_refused_among_valid_ones() -> None:
    with pytest.raises(ValueError, match="nothing has begun"):
        begun().advance(np.array([0, 1, 1]), np.array([0, 0, 7]), np.zeros(3), CHANGE)


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf])
def test_a_likelihood_that_is_not_finite_is_refused_among_finite_ones(odd: float) -> None:
    with pytest.raises(ValueError, match="no path"):
        begun().advance(np.array([0, 1]), np.array([0, 0]), np.array([0.0, odd]), CHANGE)


def message(ways: int, tick: int = 0) -> ForwardMessage:
    onset = np.zeros(ways, np.int32)
    return ForwardMessage(
        tick, np.zeros((2, 2)), onset, np.zeros(ways, np.int8), np.zeros(ways), np.zeros((2, 2), np.int32)
    )


def test_open_ticks_count_kept_and_released_rows() -> None:
    """The smoother uses it to release ticks early, so that memory stays bounded."""
    ticks = OpenTicks()
    assert ticks.size == 0
    sizes = []
    for tick, ways in enumerate((1, 1000, 1)):
        ticks.append(message(ways, tick))
        sizes.append(ticks.size)
    few, many = sizes[0], sizes[1] - sizes[0]
    assert few > 0
    arrays = sum(part.nbytes for part in message(1000)[2:5])
    assert arrays == pytest.approx(many, rel=0.2)
    assert sizes[2] == many + 2 * few
    ticks.drop(2)
    assert (ticks.size, len(ticks), ticks.first) == (few, 1, 2)
    ticks.drop(1)
    assert (ticks.size, len(ticks), ticks.first) == (few, 0, 3)  # ticks may be skipped after the last step


def test_skipped_ticks_count_for_the_memory_and_can_be_released() -> None:
    ticks = OpenTicks()
    for tick in (0, 4, 5, 9):
        ticks.append(message(1, tick))
        for _ in range(3 if tick in (0, 5) else 0):
            ticks.skip()
    assert len(ticks) == 10
    step, skipped = OpenTicks(), ticks.size
    step.append(message(1))
    skipped -= 4 * step.size
    assert skipped > 0
    sizes = []
    for _ in range(10):
        ticks.drop(1)
        sizes.append(ticks.size)
    assert len(ticks) == 0
    assert sizes[-1] <= step.size  # the last step is kept: ticks may be skipped after it
    assert all(after <= before for before, after in pairwise(sizes))
    assert sizes[2] - sizes[1] == pytest.approx(-skipped / 6)
