"""The kernels of inference against the numpy code that they stand for, and what they refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker import hmm
from contact_tracker.hmm import running
from test_hmm import Case

kernels = pytest.importorskip("contact_tracker.compiled.kernels")
both = pytest.importorskip("kernels").both


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_step_and_what_is_past_agree(seed):
    case = Case(seed)
    trellis, (initial, change) = case.trellis, case.model
    numpy, kernel, past = running._Forward(initial), running._Compiled(initial), hmm.Past()
    for b, (alive, likelihood) in enumerate(zip(trellis.alive, trellis.log_likelihood, strict=True)):
        tick = trellis.state[alive], trellis.onset[alive], likelihood, change[b]
        try:
            reference = numpy.advance(*tick)
        except ValueError:
            with pytest.raises(ValueError, match="no path"):
                kernel.advance(*tick)
            return
        past.append(reference)
        for pair in ((kernel.advance(*tick), reference), (kernel.living, numpy.living)):
            for ours, theirs in zip(*pair, strict=True):
                assert ours.dtype == theirs.dtype
                np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)
        for tolerance in (1e-6, 0.01, 0.1, 0.3):
            (posterior, certain), (ours, as_many) = both(past.look_back, numpy.living, tolerance)
            np.testing.assert_allclose(ours, posterior, atol=1e-12)
            assert as_many == certain
        if b % 3 == 2:
            past.drop(1)


ONE, NONE, CHANGE = np.zeros(1, np.int64), np.zeros(1), np.zeros((2, 2))


@pytest.mark.parametrize(
    ("tick", "why"),
    [
        ((ONE + 2, ONE, NONE, CHANGE), "nothing has begun"),
        ((ONE - 1, ONE, NONE, CHANGE), "nothing has begun"),
        ((ONE, ONE, np.zeros(2), CHANGE), "one log-likelihood each"),
        ((ONE, ONE, NONE, np.zeros((3, 3))), "from state to state"),
    ],
)
def test_a_tick_that_cannot_be_is_refused(tick, why):
    with pytest.raises(ValueError, match=why):
        kernels.Forward([0.0, 0.0], 1e-14).advance(*tick)


STEP = CHANGE, ONE, ONE, NONE + 1.0
SURE = np.ones((1, 1))


@pytest.mark.parametrize(
    ("steps", "onset", "state", "futures", "why"),
    [
        ([], ONE, ONE, SURE, "no steps"),
        ([STEP], ONE + 1, ONE, SURE, "to come"),
        ([STEP], ONE, ONE + 2, SURE, "no such state"),
        ([STEP], ONE, ONE - 1, SURE, "no such state"),
        ([STEP], ONE, np.zeros(2, np.int64), SURE, "one state for each onset"),
        ([STEP], ONE, ONE, np.ones((2, 1)), "for each onset"),
        ([STEP], ONE, ONE, np.ones((1, 0)), "no futures|for each onset"),
        ([STEP, (np.zeros((1, 1)), *STEP[1:])], ONE, ONE, SURE, "from state to state"),
        ([(CHANGE, ONE + 1, *STEP[2:])], ONE, ONE, SURE, "to come"),
        ([(CHANGE, ONE, ONE + 2, STEP[3])], ONE, ONE, SURE, "no such state"),
        ([(*STEP[:3], np.zeros(2))], ONE, ONE, SURE, "one probability for each onset"),
    ],
)
def test_a_past_that_cannot_be_is_refused(steps, onset, state, futures, why):
    with pytest.raises(ValueError, match=why):
        kernels.covered(steps, 0, onset, state, futures)
    with pytest.raises(ValueError, match=why):
        kernels.in_common(steps, 0, onset, state, futures, 1e-6, 16)


def test_looking_now_and_then_is_more_often_than_never():
    assert kernels.in_common([STEP], 0, ONE, ONE, SURE, 1e-6, 1) == 1
    with pytest.raises(ValueError, match="at least one"):
        kernels.in_common([STEP], 0, ONE, ONE, SURE, 1e-6, 0)
