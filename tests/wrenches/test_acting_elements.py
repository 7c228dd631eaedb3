"""The elements through which measured forces act are those that touch."""

import numpy as np
import pytest
from support.pressed_objects import pressed
from test_contact_evidence import evidence_of

from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.states import CONTACTS, Contact

SEEDS = range(5)
MOST_RAD = np.radians(15.0)
MOST_M = 0.03


def deviation(found: Element, true: np.ndarray) -> tuple[float, float]:
    """Angle (rad) or distance (m) of an element from the true normal, direction or point, and its sd."""
    match found:
        case Point(point_m, covariance):
            return float(np.linalg.norm(point_m - true)), float(np.sqrt(np.trace(covariance)))
        case Line(direction, _, covariance):
            off = true * np.sign(true @ direction) - direction
            return float(np.linalg.norm(off)), float(np.sqrt(np.trace(covariance[:3, :3])))
        case Plane(normal, _, covariance):
            return float(np.linalg.norm(true - normal)), float(np.sqrt(np.trace(covariance[:3, :3])))
    raise AssertionError(found)


@pytest.mark.parametrize("disturbed", [False, True], ids=["clean", "noise and bias"])
@pytest.mark.parametrize("contact", CONTACTS)
def test_forces_act_through_the_elements_that_touch(contact: Contact, disturbed: bool) -> None:
    for seed in SEEDS:
        made = pressed(contact, seed, noise=disturbed, bias=disturbed)
        found = evidence_of(made).of_window(made.touch_ns, made.end_ns)
        assert found is not None
        for element, true in zip(found.elements[contact], (made.object, made.surroundings), strict=True):
            assert element is not None
            off, sd = deviation(element, true)
            assert off < 3.0 * sd
            assert sd < (MOST_M if isinstance(element, Point) else MOST_RAD)


def test_lines_in_all_directions_are_unknown() -> None:
    """Forces through one point do not tell the direction of an edge through it."""
    made = pressed(Contact.FV, 1)
    found = evidence_of(made).of_window(made.touch_ns, made.end_ns)
    assert found is not None
    assert found.elements[Contact.FE][1] is None
