"""Beliefs in columns equal single beliefs."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.exports.formats import json_line
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point, Unobserved
from contact_tracker.states import CONTACTS, STATES
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.offline_smoother import Columns
from contact_tracker.tracking.segmentation import Beliefs

seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=30, deadline=None)
NAMES = (None, "", "table", "bench top é 中")


def element(rng):
    covariance = None if rng.random() < 0.2 else rng.normal(size=(6, 6))
    how = ("turns_about", "shifts_along")
    ways = tuple(Unobserved(how[rng.integers(2)], rng.normal(size=3)) for _ in range(rng.integers(3)))
    name, kind = NAMES[rng.integers(len(NAMES))], rng.integers(3)
    cut = None if covariance is None else covariance[: (4, 6, 3)[kind], : (4, 6, 3)[kind]] ** 2
    if kind == 0:
        return Plane(rng.normal(size=3), float(rng.normal()), cut, ways, name)
    if kind == 1:
        return Line(rng.normal(size=3), rng.normal(size=3), cut, ways, name)
    return Point(rng.normal(size=3), cut, ways, name)


def some_beliefs(rng, count):
    shared = ContactGeometry(element(rng), element(rng))
    for stamp in np.sort(rng.integers(2**60, 2**62, count)):
        geometry = (None, shared, ContactGeometry(element(rng), element(rng)))[rng.integers(3)]
        residual = np.where(rng.random(len(CONTACTS)) < 0.3, np.nan, rng.normal(size=len(CONTACTS)))
        others = tuple(state for state in STATES if rng.random() < 0.3)
        contact = STATES[rng.integers(len(STATES))]
        yield Belief(
            int(stamp), contact, rng.dirichlet(np.ones(7)), int(stamp) - 7, geometry, residual, others, 0.25
        )


def same(a, b):
    elements = []
    for belief in (a, b):
        pair = (belief.geometry.object, belief.geometry.environment) if belief.geometry else ()
        elements.append(
            [(type(e), e.name, None if e.covariance is None else e.covariance.tolist()) for e in pair]
        )
    return (
        json_line(a) == json_line(b)
        and np.array_equal(a.residual, b.residual, equal_nan=True)
        and (a.p_restricted, a.touching) == (b.p_restricted, b.touching)
        and elements[0] == elements[1]
    )


@many
@given(seed=seeds, count=st.integers(0, 12), parts=st.integers(1, 4))
def test_beliefs_in_columns_are_bit_identical(seed, count, parts):
    expected = list(some_beliefs(np.random.default_rng(seed), count))
    cuts = np.linspace(0, count, parts + 1).astype(int)
    pieces = [Beliefs.of(expected[a:b]) for a, b in pairwise(cuts)]
    before = [piece.rows.copy() for piece in pieces]
    found = Beliefs.join([pieces[0][:0], *pieces])
    assert len(found) == count
    assert all(same(a, b) for a, b in zip(found, expected, strict=True))
    assert all(same(a, b) for a, b in zip(found[1:][::2], expected[1:][::2], strict=True))
    assert found.contacts == [b.contact for b in expected]
    np.testing.assert_array_equal(found.stamp_ns, [b.stamp_ns for b in expected])
    for piece, rows in zip(pieces, before, strict=True):  # joining does not change the parts
        assert piece.rows.tobytes() == rows.tobytes()
    if count:
        assert same(found[-1], expected[-1])


@many
@given(seed=seeds)
def test_columns_behave_like_a_list(seed):
    rng, columns, expected = np.random.default_rng(seed), Columns(np.dtype([("number", int)])), []
    for _ in range(8):
        more = rng.integers(0, 3000)
        for number in range(more):
            columns.append((number,))
        expected += range(more)
        first, end = np.sort(rng.integers(0, len(expected) + 1, 2))
        assert columns.rows(first, end)["number"].tolist() == expected[first:end]
        count = int(rng.integers(0, len(expected) + 1))
        assert columns.take(count)["number"].tolist() == expected[:count]
        expected = expected[count:]
        assert len(columns) == len(expected)
