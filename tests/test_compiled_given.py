"""Known elements become the same priors compiled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.geometry import Line, Plane, Point
from contact_tracker.given import _face, _part

both = pytest.importorskip("kernels").both
seeds = st.integers(0, 2**32 - 1)
ranks = st.integers(0, 6)


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def covariance(rng, size, turns, rank):
    """Of directions and of places: wide apart in size, and in some directions zero."""
    root = (
        rng.normal(size=(size, min(rank, size))) * np.array([1e-3] * turns + [1e-2] * (size - turns))[:, None]
    )
    return root @ root.T


def an_element(rng, kind, rank, told):
    """Of which the direction is ``told``, or else only that it lies somewhere."""
    direction = unit(rng) if told else np.zeros(3)
    if kind == "v":
        return Point(rng.normal(size=3), covariance(rng, 3, 0, rank))
    if kind == "e":
        return Line(direction, rng.normal(size=3), covariance(rng, 6, 3, rank))
    return Plane(direction, float(rng.normal()), covariance(rng, 4, 3, rank))


def assert_alike(function, *args):
    numpy, kernel = both(function.__wrapped__, *args)
    np.testing.assert_array_equal(np.isfinite(kernel), np.isfinite(numpy))
    known = np.isfinite(numpy)
    np.testing.assert_allclose(kernel[known], numpy[known], rtol=1e-5, atol=1e-6 * np.abs(numpy[known]).max())


@pytest.mark.parametrize("kind", ["f", "e", "v"])
@settings(max_examples=60, deadline=None)
@given(seed=seeds, rank=ranks, told=st.booleans())
def test_parts_are_alike(kind, seed, rank, told):
    assert_alike(_part, kind, an_element(np.random.default_rng(seed), kind, rank, told))


@settings(max_examples=60, deadline=None)
@given(seed=seeds, rank=ranks, told=st.booleans())
def test_faces_are_alike(seed, rank, told):
    assert_alike(_face, an_element(np.random.default_rng(seed), "f", rank, told))
