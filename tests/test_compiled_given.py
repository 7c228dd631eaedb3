"""Known elements become the same priors compiled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.begins import begun
from contact_tracker.compiled import calls
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry import Line, Plane, Point
from contact_tracker.given import _face, _part, rows_of
from contact_tracker.labels import Contact

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


@pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
@settings(max_examples=30, deadline=None)
@given(seed=seeds, many=st.integers(1, 6))
def test_what_begins_is_alike(model, seed, many):
    """Of each element something is known, or nothing; lines are told by their points near to the body."""
    rng = np.random.default_rng(seed)

    def side(kind):
        return (
            an_element(rng, kind, int(rng.integers(1, 7)), rng.random() < 0.7) if rng.random() < 0.7 else None
        )

    ours, theirs = model.contact.value[0], model.contact.value[2]
    pairs = [(side(ours), side(theirs)) for _ in range(many)]
    near_m = rng.normal(size=3) if theirs == "e" and rng.random() < 0.7 else None
    log_share, pair = -rng.random(many), rng.integers(3, size=many)
    certain, met = rng.random((2, many)) < 0.5
    told = [column.tolist() for column in (log_share, pair, certain, met)]
    known = [element is not None for both_ in pairs for element in both_]
    _part.cache_clear(), _face.cache_clear()
    numpy, kernel = both(begun, model, pairs, near_m, *told)
    np.testing.assert_array_equal(kernel.told, numpy.told)
    for name in ("onset", "source", "pair", "certain", "searched", "met", "grace", "lasted"):
        np.testing.assert_array_equal(getattr(kernel.rows, name), getattr(numpy.rows, name), err_msg=name)
    for name in (
        "known_mean",
        "known",
        "pivot",
        "x",
        "row_weight",
        "log_likelihood",
        "rms",
        "entry",
        "settled",
    ):
        one, other = getattr(kernel.rows, name), getattr(numpy.rows, name)
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.nanmax(np.abs(other), initial=0.0))
    assert any(known) or not kernel.rows.known.any()


def test_what_does_not_fit_a_contact_is_refused():
    model, other = CONTACT_MODELS[Contact.EE.column], CONTACT_MODELS[Contact.VF.column]
    rows, told = rows_of(model, [(None, None)]), ([0.0], [0], [False], [False])
    calls.begun(model, *rows, np.zeros(3), *told)
    for refused in (
        (other, *rows, None, *told),
        (model, *rows_of(other, [(None, None)]), None, *told),
        (other, *rows_of(other, [(None, None)]), np.zeros(3), *told),
        (model, *rows, np.zeros(2), *told),
        (model, *rows, None, [0.0, 0.0], *told[1:]),
        (model, [np.zeros(44)], rows[1], None, *told),
    ):
        with pytest.raises(ValueError, match=r"number|line|told of each|place"):
            calls.begun(*refused)
