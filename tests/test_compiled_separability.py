"""What the motion tells apart is the same compiled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker import separability
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.labels import STATES, Contact
from contact_tracker.lift import lift
from contact_tracker.pace import FAR_NATS
from contact_tracker.separability import STRIDE_TICKS, rivals_since, used_directions
from contact_tracker.table import blank
from contact_tracker.window import Window

both = pytest.importorskip("kernels").both
seeds = st.integers(0, 2**32 - 1)


def moving(rng, count, axes):
    """Ticks of an object that shifts and turns in so many directions, with noise; some are at rest."""
    shift, turn = (np.cumsum(rng.normal(size=(count, n)), axis=0) for n in axes)
    position_m = 0.02 * shift @ rng.normal(size=(axes[0], 3)) + 1e-4 * rng.normal(size=(count, 3))
    about = 0.05 * turn @ rng.normal(size=(axes[1], 3)) + 1e-3 * rng.normal(size=(count, 3))
    zeta = lift(Rotation.from_rotvec(about).as_matrix(), position_m + rng.normal(size=3))
    variance = np.exp(rng.normal(size=(count, 2))) * [1e-8, 1e-6]
    excess = variance * np.exp(3.0 * rng.normal(size=(count, 2))) * (rng.random((count, 1)) > 0.2)
    return Window(np.arange(count), zeta, variance, excess)


@pytest.mark.parametrize("axes", [(0, 0), (1, 0), (0, 1), (2, 1), (3, 3)])
@settings(max_examples=20, deadline=None)
@given(seed=seeds, count=st.integers(1, 60))
def test_as_many_directions_are_used(axes, seed, count):
    window = moving(np.random.default_rng(seed), count, axes)
    numpy, kernel = both(used_directions, window)
    assert kernel == numpy
    assert (numpy == 0) if count <= STRIDE_TICKS else numpy <= 6


def test_all_numbers_of_directions_come_up():
    rng = np.random.default_rng(1)
    axes = [(n, m) for n in range(4) for m in range(4) for _ in range(3)]
    assert {both(used_directions, moving(rng, 50, some))[1] for some in axes} == {0, 1, 2, 3, 4, 5, 6}


@pytest.mark.parametrize("used", [0.0, 1.0, 1e3])
def test_directions_are_counted_beyond_the_same_bound(used, monkeypatch):
    monkeypatch.setattr(separability, "USED", used)
    for seed in range(20):
        numpy, kernel = both(used_directions, moving(np.random.default_rng(seed), 30, (1, 1)))
        assert kernel == numpy


def a_bank(model, rng, count):
    """Hypotheses in order of onset, several of some; some are far behind, some as good as others."""
    bank = blank(model, count)
    return bank.having(
        onset=np.sort(rng.integers(0, 60, count)),
        entry=-30.0 * rng.random(count),
        log_likelihood=np.round(60.0 * rng.random(count)) * (rng.random(count) > 0.1),
        rms=rng.uniform(0.5, 3.0, count),
    )


@pytest.mark.parametrize("label", STATES)
@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_rivals_are_alike(label, seed):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 30, len(CONTACT_MODELS)) * (rng.random(len(CONTACT_MODELS)) > 0.2)
    counts[label.column % len(counts)] += 1  # what is believed has a hypothesis
    banks = [a_bank(model, rng, count) for model, count in zip(CONTACT_MODELS, counts, strict=True)]
    now = int(rng.integers(60, 200))
    onset = int(rng.integers(0, 60))
    numpy, kernel = both(rivals_since, banks, label, onset, now)
    for name in ("evidence", "rms"):
        np.testing.assert_allclose(getattr(kernel, name), getattr(numpy, name), rtol=1e-12, atol=1e-12)


def test_a_rival_counts_up_to_the_end_of_the_span_and_evidence_down_to_what_is_far():
    """At their bounds; of what has begun together the best counts."""
    slack, label = 3, Contact.EF
    ours = blank(CONTACT_MODELS[label.column], 4).having(
        onset=[10, 20, 20, 40],
        log_likelihood=[50.0, 30.0, 20.0, 50.0 - FAR_NATS],
        entry=[0.0, 20.0, 29.9, 0.0],
    )
    for at, counts in (
        (20 - slack - 1, False),
        (20 - slack, True),
        (20 + slack, True),
        (20 + slack + 1, False),
    ):
        theirs = blank(CONTACT_MODELS[0], 1).having(onset=[at], log_likelihood=[7.0])
        others = [blank(model, 0) for model in CONTACT_MODELS[2:]]
        for rivals in both(rivals_since, [theirs, ours, *others], label, 20, 21):
            expected = 7.0 - np.interp(at, [10, 20, 40], [50.0, 30.0, 50.0 - FAR_NATS])
            assert rivals.evidence[0] == pytest.approx(expected if counts else -np.inf)
            assert rivals.evidence[-1] == pytest.approx(-30.0)
            assert rivals.evidence[label.column] == 0.0
