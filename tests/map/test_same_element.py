"""Whether two estimated elements may be the same."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from contact_tracker.geometry.elements import Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.map.map import Accuracy, known_to
from contact_tracker.map.same_element import is_same_element

ORIGIN = np.zeros(3)
ALONG = np.array([0.0, 0.6, 0.8])
EDGE = Line(ALONG, np.array([0.1, 0.0, 0.0]), 1e-8 * np.eye(6))
TABLE = Plane(np.array([0.0, 0.0, 1.0]), -0.1, 1e-8 * np.eye(4))


@pytest.mark.parametrize(
    ("first", "off"),
    [
        (Point(np.array([0.1, 0.2, 0.3]), np.diag([1.0, 4.0, 9.0]) * 1e-6), [0.0, 0.002, 0.0]),
        (TABLE, [0.0, 0.0, 0.0, 1e-4]),
        (TABLE, [0.0, 1e-4, 0.0, 0.0]),
        (EDGE, [1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (EDGE, [0.0, 0.0, 0.0, 1e-4, 0.0, 0.0]),
    ],
)
def test_elements_are_the_same_within_four_standard_deviations_of_both(first, off):
    """Along one direction, in which ``off`` is one standard deviation."""
    for many, same in ((5.6, True), (5.7, False)):  # each is uncertain: their difference is by sqrt 2
        assert is_same_element(first, with_numbers(first, numbers(first) + many * np.array(off))) is same


def with_numbers(element: Element, values: np.ndarray) -> Element:
    match element:
        case Plane():
            return replace(element, normal=values[:3], offset_m=values[3])
        case Line():
            return replace(element, direction=values[:3], point_m=values[3:])
        case Point():
            return replace(element, point_m=values)


@given(arrays(float, 12, elements=st.floats(-1.0, 1.0)), st.floats(-3.0, 3.0), st.booleans())
def test_lines_match_at_any_point_and_in_either_direction(values, along_m, flips):
    upward = values[:3] + np.array([0.0, 0.0, 2.0])
    direction = upward / np.linalg.norm(upward)
    line = known_to(Line(direction, values[3:6]), Accuracy())
    again = by_foot(line, line.point_m + along_m * direction)
    if flips:
        flip = np.repeat([-1.0, 1.0], 3)
        again = replace(again, direction=-direction, covariance=flip[:, None] * again.covariance * flip)
    assert is_same_element(line, again)
    across = np.cross(direction, values[6:9] + np.array([3.0, 0.0, 0.0]))
    beside = replace(again, point_m=again.point_m + 0.05 * across / np.linalg.norm(across))
    assert not is_same_element(line, beside)


@pytest.mark.parametrize("offset_m", [-0.1, 0.0])
def test_faces_with_opposite_normals_do_not_match(offset_m):
    table = replace(TABLE, offset_m=offset_m)
    assert not is_same_element(table, replace(table, normal=-table.normal, offset_m=-offset_m))


@pytest.mark.parametrize("far_m", [1.0, 30.0, 1e6])
def test_unobserved_directions_are_not_compared(far_m):
    point = Point(ORIGIN, np.diag([far_m**2, 9e-8, 9e-8]))
    line = Line(np.array([0.0, 0.0, 1.0]), ORIGIN, np.diag([4e-6, 4e-6, 0.0, far_m**2, 9e-8, 0.0]))
    for element in (point, line):
        assert is_same_element(element, replace(element, point_m=np.array([0.3 * far_m, 1e-3, 0.0])))
        assert not is_same_element(element, replace(element, point_m=np.array([0.0, 0.05, 0.0])))


def test_matching_of_lines_is_symmetric():
    """For a known line, and one that is turned and shifted by about as much as its uncertainty."""
    known = known_to(EDGE, Accuracy(position_m=3e-4, rotation_rad=2e-3))
    turned = np.array([np.sin(1.0), 0.6 * np.cos(1.0), 0.8 * np.cos(1.0)])
    places = EDGE.point_m + 8e-4 * np.random.default_rng(7).normal(size=(100, 3))
    vague = [known_to(Line(turned, place), Accuracy(position_m=3e-4, rotation_rad=0.4)) for place in places]
    same = [is_same_element(known, one) for one in vague]
    assert 5 < sum(same) < 95
    assert same == [is_same_element(one, known) for one in vague]
