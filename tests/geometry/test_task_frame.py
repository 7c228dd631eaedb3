"""Task frames: free motions keep a contact, constrained ones break it, and wrenches do no work."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_motions import touching, x_of
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.contacts.task_frame import TaskFrame, contact_frame, task_frame
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import (
    ContactGeometry,
    Element,
    Line,
    Plane,
    Point,
    numbers,
    of_numbers,
)
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.states import CONTACTS, Contact

STEP = 1e-5
LINE = Line(np.array([0.0, 0.0, 1.0]), np.array([0.3, -0.2, 0.5]))
seeds = st.integers(0, 2**32 - 1)


def at_a_pose(contact, seed):
    """A pose, and elements that touch at it, each given in its own frame."""
    t = touching(contact, np.random.default_rng(seed), frames=1)
    x = x_of(contact, t.object, t.environment)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = t.rotation[0], t.position_m[0]
    return x, CONTACT_MODELS[contact.column].geometry(x, np.zeros((len(x), len(x))), 0.0), T


def misfit(contact, x, T):
    """How far the elements are from touching at a pose: angles (sine) and a distance (m)."""
    zeta = lift(T[None, :3, :3], T[None, :3, 3])
    return CONTACT_MODELS[contact.column].measure(x[None], zeta).residual[0, :, 0]


def moved(T, twist):
    """The pose after a small motion by a twist in the world frame, about the world's origin."""
    turn = Rotation.from_rotvec(STEP * twist[3:]).as_matrix()
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = turn, STEP * twist[:3]
    return step @ T


@pytest.mark.parametrize("contact", CONTACTS)
@settings(max_examples=15)
@given(seed=seeds)
def test_free_twists_keep_the_contact_and_constrained_ones_break_it(contact: Contact, seed: int) -> None:
    x, geometry, T = at_a_pose(contact, seed)
    if contact is Contact.EE:
        assume(np.linalg.norm(np.cross(T[:3, :3] @ x[:3], x[6:9])) > 0.3)
    frame = task_frame(contact, geometry, T)
    np.testing.assert_allclose(misfit(contact, x, T), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        frame.T_world_task[:3, :3] @ frame.T_world_task[:3, :3].T, np.eye(3), atol=1e-9
    )
    for twist in frame.free_twists:
        np.testing.assert_allclose(misfit(contact, x, moved(T, twist)), 0.0, atol=1e3 * STEP**2)
    assert len(frame.wrenches) == contact.codimension == int(np.trace(frame.selection))
    constrained = np.linalg.svd(frame.free_twists)[2][6 - contact.codimension :]
    change = [misfit(contact, x, moved(T, twist)) / STEP for twist in constrained]
    assert np.linalg.matrix_rank(np.array(change), tol=1e-3) == contact.codimension
    assert_reciprocal(frame)


def assert_reciprocal(frame: TaskFrame) -> None:
    """Wrenches do no work in free twists, which the projectors keep, and constrained ones they take away."""
    np.testing.assert_allclose(frame.wrenches @ frame.free_twists.T, 0.0, atol=1e-9)
    constrained, free = frame.world_projectors
    np.testing.assert_allclose(constrained + free, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(free @ free, free, atol=1e-9)
    np.testing.assert_allclose(free @ frame.free_twists.T, frame.free_twists.T, atol=1e-9)
    np.testing.assert_allclose(frame.wrenches @ free, 0.0, atol=1e-9)
    assert np.linalg.matrix_rank(free) == len(frame.free_twists) == 6 - len(frame.wrenches)


@pytest.mark.parametrize(
    ("kind", "axis", "free"),
    [
        (JointKind.HINGE, LINE, [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]),
        (JointKind.SLIDER, LINE, [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]),
        (JointKind.SCREW, LINE, [[0.0, 0.0, 0.02, 0.0, 0.0, 1.0]]),
        (JointKind.BALL, Point(np.array([0.2, 0.1, 0.0])), np.eye(6)[3:].tolist()),
    ],
)
def test_joints_leave_motion_along_and_about_their_axis(kind, axis, free) -> None:
    """As twists of the body's point on the axis: a line is moved to where the frame is."""
    pitch = 0.02 if kind is JointKind.SCREW else None
    frame = Joint(kind, 1.0, axis, axis, pitch, None).task_frame
    assert_reciprocal(frame)
    assert len(frame.free_twists) == 6 - kind.constraints
    R, o = frame.T_world_task[:3, :3], frame.T_world_task[:3, 3]
    moved = frame.free_twists.copy()
    moved[:, :3] += np.cross(moved[:, 3:], o)
    np.testing.assert_allclose(moved @ np.kron(np.eye(2), R), free, atol=1e-12)
    np.testing.assert_allclose(frame.free_selection @ np.array(free).T, np.array(free).T, atol=1e-12)
    if kind is not JointKind.BALL:
        np.testing.assert_allclose(R[:, 2], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("contact", CONTACTS)
def test_the_covariance_is_that_of_frames_of_drawn_elements(contact: Contact) -> None:
    """Of elements with small errors; each is drawn with its covariance, tangent to its unit vector."""
    rng = np.random.default_rng(7)
    _, exact, T = at_a_pose(contact, 11)
    scale = 1e-4 * rng.normal(size=(2, 6, 6))

    def spread(element: Element, root: np.ndarray) -> Element:
        size = len(numbers(element))
        tangent = np.eye(size)
        if size > 3:
            unit = numbers(element)[:3]
            tangent[:3, :3] -= np.outer(unit, unit)
        root = tangent @ root[:size, :size]
        return replace(element, covariance=root @ root.T)

    sides = [spread(one, root) for one, root in zip((exact.object, exact.environment), scale, strict=True)]
    frame = task_frame(contact, ContactGeometry(*sides), T)
    assert frame.covariance is not None
    draws = []
    for _ in range(250):
        drawn = [
            of_numbers(
                type(one),
                rng.multivariate_normal(numbers(one), one.covariance, method="eigh", check_valid="ignore"),
            )
            for one in sides
        ]
        other = contact_frame(contact, ContactGeometry(*drawn), T)
        change = np.linalg.inv(frame.T_world_task) @ other
        draws.append([*change[:3, 3], *Rotation.from_matrix(change[:3, :3]).as_rotvec()])
    sample = np.cov(np.array(draws).T)
    sd = np.array(frame.sd) + 1e-7  # of what is of second order
    assert (np.abs(sample - frame.covariance) <= 0.4 * np.outer(sd, sd)).all()
    assert sd[frame.is_constrained].min() > 1e-6


def test_a_frame_of_unknown_deviations_has_none() -> None:
    geometry = ContactGeometry(Point(np.zeros(3)), Plane(np.array([0.0, 0.0, 1.0]), 0.0))
    frame = task_frame(Contact.VF, geometry, np.eye(4))
    assert frame.sd is None
    assert frame.to_json()["covariance"] is None
    assert frame.name == "point on plane"


def test_parallel_edges_have_no_common_normal() -> None:
    line = Line(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert task_frame(Contact.EE, ContactGeometry(line, line), np.eye(4)) is None


@pytest.mark.parametrize("sine", [1.2e-6, 1.5e-6])
def test_a_frame_of_nearly_parallel_edges_has_no_deviations(sine: float) -> None:
    """A step of the differences makes them parallel."""
    lines = [
        Line(np.array([slope, 0.0, 1.0]), np.array([0.0, y, 0.0]), 1e-6 * np.eye(6))
        for slope, y in ((0.0, 0.0), (sine, 0.1))
    ]
    frame = task_frame(Contact.EE, ContactGeometry(*lines), np.eye(4))
    assert frame.covariance is None
