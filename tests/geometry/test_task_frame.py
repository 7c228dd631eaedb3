"""Task frames: free motions keep a contact, constrained ones break it, and wrenches do no work."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point
from contact_tracker.geometry.task_frame import task_frame
from contact_tracker.states import CONTACTS, Contact

STEP = 1e-5
seeds = st.integers(0, 2**32 - 1)


def touching(contact, seed):
    """A pose and elements, each given in its own frame, that touch at a random place."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    place = rng.normal(size=3)
    axes = Rotation.random(random_state=rng).as_matrix()
    normal, along = axes[:, 2], axes[:, 0]
    across = Rotation.from_rotvec(rng.uniform(0.3, 1.5) * normal).apply(along)
    world = {"f": (normal, float(normal @ place)), "v": place}
    ours, theirs = contact.value[0], contact.value[2]

    def element(kind, direction, turn, shift):
        if kind == "f":
            n = turn.T @ normal
            return Plane(n, float(n @ (turn.T @ (place - shift))))
        if kind == "e":
            moved = place + rng.normal() * direction
            return Line(turn.T @ direction, turn.T @ (moved - shift))
        return Point(turn.T @ (world["v"] - shift))

    geometry = ContactGeometry(
        element(ours, along, T[:3, :3], T[:3, 3]), element(theirs, across, np.eye(3), np.zeros(3))
    )
    return geometry, T


def misfit(contact, geometry, T):
    """How far the elements are from touching at a pose: angles (sine) and a distance (m)."""
    turn, shift = T[:3, :3], T[:3, 3]
    ours, theirs = geometry.object, geometry.environment
    match ours, theirs:
        case Plane(), Plane():
            n = turn @ ours.normal
            point = shift + n * ours.offset_m
            return np.array([*np.cross(n, theirs.normal), theirs.normal @ point - theirs.offset_m])
        case Line(), Plane():
            point = turn @ ours.point_m + shift
            return np.array(
                [theirs.normal @ (turn @ ours.direction), theirs.normal @ point - theirs.offset_m]
            )
        case Point(), Plane():
            return np.array([theirs.normal @ (turn @ ours.point_m + shift) - theirs.offset_m])
        case Line(), Line():
            across = np.cross(turn @ ours.direction, theirs.direction)
            return np.array(
                [across @ (turn @ ours.point_m + shift - theirs.point_m) / np.linalg.norm(across)]
            )
        case _:  # the object's face: seen from the body
            back = np.linalg.inv(T)
            return misfit(contact, ContactGeometry(theirs, ours), back)


def moved(T, twist):
    """The pose after a small motion by a twist in the world frame, about the world's origin."""
    turn = Rotation.from_rotvec(STEP * twist[3:]).as_matrix()
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = turn, STEP * twist[:3]
    return step @ T


@pytest.mark.parametrize("contact", CONTACTS)
@given(seed=seeds)
def test_free_twists_keep_the_contact_and_constrained_ones_break_it(contact: Contact, seed: int) -> None:
    geometry, T = touching(contact, seed)
    frame = task_frame(contact, geometry, T)
    assert frame is not None
    np.testing.assert_allclose(misfit(contact, geometry, T), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        frame.T_world_task[:3, :3] @ frame.T_world_task[:3, :3].T, np.eye(3), atol=1e-9
    )
    for twist in frame.free_twists:
        np.testing.assert_allclose(misfit(contact, geometry, moved(T, twist)), 0.0, atol=1e3 * STEP**2)
    assert len(frame.wrenches) == contact.codimension == int(np.trace(frame.selection))
    constrained = np.linalg.svd(frame.free_twists)[2][6 - contact.codimension :]
    change = [misfit(contact, geometry, moved(T, twist)) / STEP for twist in constrained]
    assert np.linalg.matrix_rank(np.array(change), tol=1e-3) == contact.codimension


@pytest.mark.parametrize("contact", CONTACTS)
@given(seed=seeds)
def test_wrenches_do_no_work_on_free_twists(contact: Contact, seed: int) -> None:
    frame = task_frame(contact, *touching(contact, seed))
    assert frame is not None
    power = frame.wrenches @ frame.free_twists.T
    np.testing.assert_allclose(power, 0.0, atol=1e-9)


def test_parallel_edges_have_no_common_normal() -> None:
    line = Line(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert task_frame(Contact.EE, ContactGeometry(line, line), np.eye(4)) is None
