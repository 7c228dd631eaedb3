"""Elements of a stretch are the same compiled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker import hypotheses, polish
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.lift import lift
from contact_tracker.presets import load_model
from contact_tracker.state import scales_of
from contact_tracker.window import Window
from touching import touching

both = pytest.importorskip("kernels").both
SCALES = scales_of(load_model("default"))
SIGMA_M, SIGMA_RAD = 1e-4, 1e-3
models = pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: str(model.contact))


def lasting(rng, count, echo):
    """Errors (count, 3) of variance one, of which so much is left in the next tick."""
    errors = rng.normal(size=(count, 3))
    for tick in range(1, count):
        errors[tick] = echo * errors[tick - 1] + np.sqrt(1.0 - echo**2) * errors[tick]
    return errors


def stretch(model, rng, count, echo=0.5, gaps=False, uneven=False):
    """Ticks of a contact whose noise is as it is believed to be, or up to twice as large."""
    made, size = touching(model.contact, rng, count), rng.uniform(1.0, 2.0)
    turn = Rotation.from_rotvec(size * SIGMA_RAD * lasting(rng, count, echo)).as_matrix()
    place_m = made.position_m - made.position_m[0] + size * SIGMA_M * lasting(rng, count, echo)
    variance = np.exp(rng.normal(0.0, 0.3, (count, 2))) * [SIGMA_M**2, SIGMA_RAD**2]
    axes = rng.normal(size=(count, 3, 3)) * SIGMA_M
    return Window(
        np.cumsum(rng.integers(1, 4, count)) if gaps else np.arange(count),
        lift(made.rotation @ turn, place_m),
        variance,
        1e4 * variance,
        0.2 * axes @ axes.swapaxes(1, 2) if uneven else None,
    )


def assert_alike(model, window):
    """Returns whether the first and the last tick belong."""
    bank = hypotheses.fit_stretch(model, window, SCALES)
    numpy, kernel = both(polish._settle, bank, model, window, SCALES)
    assert (kernel.begins, kernel.ends) == (numpy.begins, numpy.ends)
    ours, theirs = kernel.polished, numpy.polished
    sd = 1.0 / np.sqrt(np.maximum(theirs.information.diagonal(), 1.0))
    assert np.abs(ours.bank.x - theirs.bank.x).max() < 1e-4 * sd.max()
    np.testing.assert_allclose(ours.bank.moments, theirs.bank.moments, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(ours.bank.row_weight, theirs.bank.row_weight, rtol=1e-5)
    scale = np.sqrt(theirs.information.diagonal()) + 1e-6
    close = (ours.information - theirs.information) / (scale[:, None] * scale)
    assert np.abs(close).max() < 1e-4
    return numpy.begins, numpy.ends


@models
@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(25, 80),
    echo=st.floats(0.0, 0.9),
    gaps=st.booleans(),
    uneven=st.booleans(),
)
def test_a_stretch_is_polished_alike(model, seed, count, echo, gaps, uneven):
    assert_alike(model, stretch(model, np.random.default_rng(seed), count, echo, gaps, uneven))


@models
@pytest.mark.parametrize("tick", [0, -1])
def test_what_does_not_belong_is_the_same(model, tick):
    window = stretch(model, np.random.default_rng(4), 40)
    zeta = window.zeta.copy()
    away = Rotation.from_rotvec([0.02, -0.02, 0.02]).as_matrix()
    zeta[tick] = lift(away @ zeta[tick, :9].reshape(3, 3), zeta[tick, 9:12] + [0.02, -0.01, 0.03])
    begins, ends = assert_alike(model, Window(window.index, zeta, window.variance, window.excess))
    assert (begins if tick == 0 else ends) is False


@models
@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_moment_is_polished_to_finite_numbers(model, count):
    window = stretch(model, np.random.default_rng(1), count)
    bank = hypotheses.fit_stretch(model, window, SCALES)
    for settled in both(polish._settle, bank, model, window, SCALES):
        assert np.isfinite(settled.polished.bank.x).all()
        assert np.isfinite(settled.polished.information).all()
