"""Task frames: free motions keep a contact, constrained ones break it, and wrenches do no work."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_motions import touching, x_of
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import ContactGeometry, Line
from contact_tracker.geometry.task_frame import task_frame
from contact_tracker.motion.lifted_pose import lift
from contact_tracker.states import CONTACTS, Contact

STEP = 1e-5
seeds = st.integers(0, 2**32 - 1)


def at_a_pose(contact, seed):
    """A pose, and elements that touch at it, each given in its own frame."""
    t = touching(contact, np.random.default_rng(seed), frames=1)
    x = x_of(contact, t.object, t.environment)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = t.rotation[0], t.position_m[0]
    if contact is Contact.EE:
        assume(np.linalg.norm(np.cross(T[:3, :3] @ x[:3], x[6:9])) > 0.3)
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
    frame = task_frame(contact, geometry, T)
    assert frame is not None
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
    np.testing.assert_allclose(frame.wrenches @ frame.free_twists.T, 0.0, atol=1e-9)  # they do no work


def test_parallel_edges_have_no_common_normal() -> None:
    line = Line(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert task_frame(Contact.EE, ContactGeometry(line, line), np.eye(4)) is None
