"""The paper's objectives: direct against Kronecker, both against true incidence, and the errata."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_motions import touching
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import direct, form, matrix, minimise_slsqp, motion, value
from contact_tracker.paper.batched import minimise_batched, random_starts, rows
from contact_tracker.paper.window_curves import curves, minimise_windows
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.simulate import Phase, Scenario, simulate

seeds = st.integers(0, 2**32 - 1)
each_contact = pytest.mark.parametrize("contact", CONTACTS, ids=str)


def random_motion(rng, frames=7):
    return Rotation.random(frames, random_state=rng).as_matrix(), rng.normal(size=(frames, 3))


def skew(rotation):
    """Rows of (8) as printed: v x (R n) on v (x) n."""
    r1, r2, r3 = rotation
    o = np.zeros(3)
    return np.block([[o, r3, -r2], [-r3, o, r1], [r2, -r1, o]])


@each_contact
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_kronecker_form_is_the_direct_form(contact, seed):
    rng = np.random.default_rng(seed)
    rotation, p = random_motion(rng, 12)
    x, y = random_starts(contact, 1, rng, 1.0)
    elements = form(contact).factors(x[0], y[0])
    expected = direct(contact, rotation, p, *elements)
    assert value(contact, matrix(contact, rotation, p), *elements) == pytest.approx(expected, rel=1e-9)
    parts = matrix(contact, rotation.reshape(3, 4, 3, 3), p.reshape(3, 4, 3))  # sums of windows add
    np.testing.assert_allclose(parts.sum(axis=0), matrix(contact, rotation, p), atol=1e-9)


@each_contact
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_vanishes_where_the_elements_touch_and_only_there(contact, seed):
    rng = np.random.default_rng(seed)
    t = touching(contact, rng)
    assert direct(contact, *motion(t.rotation, t.position_m), t.object, t.environment) < 1e-20
    away = t.position_m + rng.normal(size=t.position_m.shape) * 0.01
    assert direct(contact, *motion(t.rotation, away), t.object, t.environment) > 1e-6


def test_free_motion_has_no_objective():
    with pytest.raises(ValueError, match="free"):
        direct(Contact.FREE, *random_motion(np.random.default_rng(0)), np.zeros(4), np.zeros(4))


def printed_7(rotation, p):
    """A_ff as printed: + p_sb = - R.T p."""
    plane = np.append(-rotation.T @ p, 1.0)
    a = np.zeros((3, 4, 4))
    for k in range(3):
        a[k, k] = plane
    a[:, 3, :3] = -rotation
    return a.reshape(3, 16)


def printed_13(rotation):
    """B_ef as printed, padded to m (x) Pi."""
    b = np.zeros((3, 3, 4))
    b[:, :, :3] = skew(rotation).reshape(3, 3, 3)
    return b.reshape(3, 12)


def printed_21(rotation, p):
    """a_ee as printed, of rows of R: the third block has no ``r3``."""
    r1, r2, r3 = rotation
    first = [np.cross(p, r1), r1, np.cross(p, r2), r2, np.cross(p, r3)]
    return np.concatenate([*first, *(part for r in rotation for part in (r, np.zeros(3)))])


def one_touching_pose(contact, seed=4):
    t = touching(contact, np.random.default_rng(seed))
    rotation, p = motion(t.rotation[:1], t.position_m[:1])
    return rotation[0], p[0], t.object, t.environment


def test_erratum_4_order_of_moment_and_direction():
    """Two planes meet in the line through their common points."""
    rng = np.random.default_rng(4)
    one, other = rng.normal(size=(2, 3))
    points = rng.normal(size=3) + np.array([[0.0], [1.0]]) * np.cross(one, other)
    h_one, h_other = points[0] @ one, points[0] @ other
    printed = np.concatenate([h_other * one - h_one * other, np.cross(one, other)])
    for q in points:
        np.testing.assert_allclose(np.cross(q, printed[3:]), printed[:3], atol=1e-12)
        assert np.abs(np.cross(q, printed[:3]) - printed[3:]).max() > 1e-2  # in the order of (2)


def test_erratum_7_sign_of_p_sb():
    rotation, p, o, e = one_touching_pose(Contact.FF)
    v = np.kron(o, e)
    assert np.abs(printed_7(rotation, p) @ v).max() > 1e-2
    assert np.abs(rows(Contact.FF, rotation[None], p[None])[0] @ v).max() < 1e-12


def test_8_holds_as_printed():
    rotation, p, _, _ = one_touching_pose(Contact.FF)
    corrected = rows(Contact.FF, rotation[None], p[None])[0, 3:].reshape(3, 4, 4)[:, :3, :3]
    np.testing.assert_array_equal(corrected.reshape(3, 9), skew(rotation))


def test_erratum_12_a_column_too_many():
    rotation, p, _, _ = one_touching_pose(Contact.EF)
    plane, zero, last = np.append(rotation.T @ p, 1.0), np.zeros(4), np.zeros((3, 1))
    offsets = [np.concatenate(row) for row in ((plane, zero, zero), (zero, plane, zero), (zero, zero, plane))]
    printed = np.hstack([offsets, printed_13(rotation), last])
    assert printed.shape == (3, 25)
    corrected = rows(Contact.EF, rotation[None], p[None])[0, :3]
    np.testing.assert_allclose(printed[:, :12], corrected[:, :12])
    np.testing.assert_allclose(printed[:, 12:24], -corrected[:, 12:])


def test_erratum_13_sign_of_b_ef():
    rotation, p, o, e = one_touching_pose(Contact.EF)
    corrected = rows(Contact.EF, rotation[None], p[None])[0]
    printed = corrected[:3].copy()
    printed[:, 12:] = printed_13(rotation)
    v = np.kron(o, e)
    assert np.abs(printed @ v).max() > 1e-2
    assert np.abs(corrected @ v).max() < 1e-12
    normal, moment = rotation @ e[:3], o[3:]
    m_part = np.kron(o[3:], e)
    np.testing.assert_allclose(printed_13(rotation) @ m_part, np.cross(moment, normal), atol=1e-12)
    np.testing.assert_allclose(corrected[:3, 12:] @ m_part, np.cross(normal, moment), atol=1e-12)


def test_erratum_15_sign_of_h():
    rotation, p, o, e = one_touching_pose(Contact.VF)
    normal = rotation @ e[:3]
    assert abs(o[:3] @ normal - (normal @ p - e[3])) > 1e-2
    assert abs(o[:3] @ normal - (normal @ p + e[3])) < 1e-12


def completed_21(rotation, p):
    """(21) with ``r3`` after ``p x r3``."""
    return np.insert(printed_21(rotation, p), 15, rotation[2])


def test_erratum_21_columns_for_rows():
    rotation, p, o, e = one_touching_pose(Contact.EE)
    v = np.kron(e, o)
    assert abs(completed_21(rotation, p) @ v) > 1e-2
    assert abs(completed_21(rotation.T, p) @ v) < 1e-12
    np.testing.assert_allclose(rows(Contact.EE, rotation[None], p[None])[0, 0], completed_21(rotation.T, p))


def test_erratum_21_the_third_block_is_incomplete():
    rotation, p, o, e = one_touching_pose(Contact.EE)
    assert len(printed_21(rotation, p)) == len(np.kron(e, o)) - 3


def noisy_window(contact, rng, sigma_m=3e-4, sigma_rad=2e-3, frames=200):
    t = touching(contact, rng, frames, swing=0.5)
    turn = Rotation.from_rotvec(rng.normal(size=(frames, 3)) * sigma_rad).as_matrix()
    position = t.position_m - t.position_m.mean(axis=0) + rng.normal(size=(frames, 3)) * sigma_m
    return motion(turn @ t.rotation, position)


@each_contact
def test_batched_minima_are_no_higher_than_slsqps(contact):
    """On the paper's objective, with and without contact, from the same number of starts."""
    rng = np.random.default_rng(5)
    x, y = random_starts(contact, 8, rng, 0.3)
    for kept in (contact, Contact.VF):
        k = matrix(contact, *noisy_window(kept, rng))
        slsqp = minimise_slsqp(contact, k, rng, starts=4)
        batch = minimise_batched(contact, np.broadcast_to(k, (8, *k.shape)), x, y)
        assert batch.value.min() <= slsqp.value * (1 + 1e-4) + 1e-12
        best = batch.value.argmin()
        elements = form(contact).factors(batch.x[best], batch.y[best])
        assert value(contact, k, *elements) == pytest.approx(batch.value[best], rel=1e-6)


@each_contact
def test_batched_minima_keep_the_constraints_and_tell_whether_they_converged(contact):
    rng = np.random.default_rng(7)
    k = matrix(contact, *noisy_window(Contact.VF, rng))
    x, y = random_starts(contact, 5, rng, 0.3)
    hurried, batch = (
        minimise_batched(contact, np.broadcast_to(k, (5, *k.shape)), x, y, iterations=number)
        for number in (1, 300)
    )
    assert not hurried.converged.any()
    assert batch.converged.all()
    assert (batch.value < hurried.value).all()
    f = form(contact)
    for kind, e in ((f.x, batch.x), (f.y, batch.y)):
        if kind == "point":
            np.testing.assert_array_equal(e[:, 3], 1.0)
        else:
            np.testing.assert_allclose(np.linalg.norm(e[:, :3], axis=1), 1.0, atol=1e-12)
        if kind == "line":
            np.testing.assert_allclose(np.einsum("bi,bi->b", e[:, :3], e[:, 3:]), 0.0, atol=1e-12)


@each_contact
def test_only_some_minima_depend_on_the_origins(contact):
    """Moving the world's origin matters to f-e only, the body's to e-f and, through its offset, to f-f."""
    rng = np.random.default_rng(8)
    paper_rotation, p = noisy_window(Contact.VF, rng)
    rotation, t = motion(paper_rotation, p)
    x, y = random_starts(contact, 24, rng, 0.3)

    def lowest(position):
        k = matrix(contact, *motion(rotation, position))
        return minimise_batched(contact, np.broadcast_to(k, (24, *k.shape)), x, y, 1e-9, 300).value.min()

    here = lowest(t)
    world, body = lowest(t + np.array([0.4, -0.3, 0.5])), lowest(t + rotation @ np.array([0.4, -0.3, 0.5]))
    assert (world == pytest.approx(here, rel=1e-3)) == (contact is not Contact.FE)
    assert (body == pytest.approx(here, rel=1e-3)) == (contact not in (Contact.EF, Contact.FF))


# --- the paper's fixed-window curves ---
RATE_NS = 5_000_000


def recording(*contacts, frames=150, seed=0, sigma_m=3e-4):
    """Phases of random poses in contact, one after the other."""
    rng = np.random.default_rng(seed)
    parts = [touching(contact, rng, frames, swing=0.5) for contact in contacts]
    rotation = np.concatenate([t.rotation for t in parts])
    position = np.concatenate([t.position_m - t.position_m.mean(axis=0) for t in parts])
    position += rng.normal(size=position.shape) * sigma_m
    stamps = 1_000 + RATE_NS * np.arange(len(position), dtype=np.int64)
    return Poses(stamps, position, Rotation.from_matrix(rotation).as_quat())


def test_windows_have_the_stamps_of_their_ends_and_minima_without_regard_to_origins_and_step():
    poses = recording(Contact.EF, frames=90)
    found = curves(poses, frames=50, step=20)
    np.testing.assert_array_equal(found.stamp_ns, poses.stamp_ns[49::20])
    assert found.stamp_ns.dtype == np.int64
    assert found.minimum.shape == found.normalised.shape == found.converged.shape == (3, 6)
    np.testing.assert_allclose(found.normalised.max(axis=0), 1.0)
    np.testing.assert_allclose(found.normalised * found.minimum.max(axis=0), found.minimum)
    moved = Poses(poses.stamp_ns, poses.position_m + np.array([100.0, -50.0, 7.0]), poses.quat_xyzw)
    np.testing.assert_allclose(curves(moved, 50, 20).minimum, found.minimum, rtol=1e-3)
    np.testing.assert_allclose(curves(poses[:69], 50, 7).minimum[0], found.minimum[0], rtol=0.02)
    for length, windows in ((0, 0), (49, 0), (69, 1)):
        few = curves(poses[:length], 50, 20)
        assert few.minimum.shape == few.normalised.shape == (windows, 6)
        assert few.stamp_ns.shape == (windows,)
    still = poses[np.zeros(60, int)]  # without motion and noise minima are finite and zero up to rounding
    rest = curves(Poses(poses.stamp_ns[:60], still.position_m, still.quat_xyzw), 50, 10)
    assert (np.abs(rest.minimum) < 1e-9).all()
    assert np.isfinite(rest.normalised).all()


@pytest.mark.parametrize(("frames", "step"), [(0, 1), (1, 0), (-5, 10)])
def test_impossible_windows_are_refused(frames, step):
    with pytest.raises(ValueError, match="at least one"):
        curves(recording(Contact.VF), frames, step)


@pytest.mark.parametrize("contact", CONTACTS, ids=str)
def test_minima_are_low_for_the_true_contact_and_contained_ones(contact):
    """Low is at the noise; contacts with as many or more constraints are far above it."""
    found = curves(recording(contact), frames=150, step=150)
    noise = 150 * 3e-4**2
    for column, other in enumerate(CONTACTS):
        if contact.contains(other):
            assert (found.minimum[:, column] < 2.0 * noise).all(), other
        elif other.codimension >= contact.codimension:
            assert (found.minimum[:, column] > 10.0 * noise).all(), other


def test_a_window_without_neighbours_is_no_higher_than_slsqp():
    rng, model = np.random.default_rng(1), CONTACT_MODELS[Contact.EE.column]
    poses = simulate(Scenario((Phase(Contact.EE, 2.5),)), 3).poses
    position_m = poses.position_m - poses.position_m.mean(axis=0)
    minimum = minimise_windows(model, poses.rotation, position_m, len(poses), 1)
    slsqp = minimise_slsqp(Contact.EE, matrix(Contact.EE, *motion(poses.rotation, position_m)), rng, 6)
    assert minimum.value[0] <= 1.02 * slsqp.value


def test_long_recordings_in_pieces_give_the_same(monkeypatch):
    poses = recording(Contact.EF, Contact.VF, frames=50)
    whole = curves(poses, 50, 25)
    monkeypatch.setattr("contact_tracker.paper.window_curves.CHUNK_FRAMES", 50)
    pieces = curves(poses, 50, 25)
    np.testing.assert_array_equal(pieces.stamp_ns, whole.stamp_ns)
    np.testing.assert_allclose(pieces.minimum, whole.minimum, rtol=0.05)
