"""The six contacts on the lifted pose: the paper's objectives, true incidence, finite differences."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_motions import elements_of, touching, x_of
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.contacts import family as layout
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Line, Plane, Point
from contact_tracker.paper import direct, motion
from contact_tracker.states import CONTACTS, Contact

seeds = st.integers(0, 2**32 - 1)
each_model = pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
quick = settings(max_examples=20, deadline=None)


def each_case(test):
    """The test for each contact, with some seeds."""
    return each_model(quick(given(seed=seeds)(test)))


def random_poses(rng, frames=9):
    return Rotation.random(frames, random_state=rng).as_matrix(), rng.normal(size=(frames, 3))


def random_x(model, rng, anchors=None):
    anchors = np.zeros(6) if anchors is None else anchors
    return model.family.normalise(rng.normal(size=model.family.SIZE), anchors)


def residuals(model, x, rotation, t):
    """(N, K): the rows of x on the lifted poses."""
    return model.lifted(lifted_pose.lift(rotation, t)) @ model.family.rows(x).T


def scale_sq(model, x, rotation, t):
    """(N,) squared change of the last row per metre, for each pose."""
    zeta = model.lifted(lifted_pose.lift(rotation, t))
    return model.family.scale_sq(np.broadcast_to(x, (len(t), len(x))), zeta[:, :, None] * zeta[:, None, :])


@each_model
def test_the_parts_of_a_model_have_their_sizes_and_order(model):
    """Labels, rows and unknowns, indices of turns, elements and their covariances."""
    rng, family = np.random.default_rng(0), model.family
    x = random_x(model, rng)
    assert CONTACTS[CONTACT_MODELS.index(model)] is model.contact
    assert model.contact.codimension == family.ROWS == family.rows(x).shape[0]
    tangent = family.tangent(x, rng.normal(size=6))
    assert model.needed * family.ROWS == tangent.shape[-1]
    turned = np.abs(tangent[layout.directions(family.FORM)]).max(axis=0) > 0
    np.testing.assert_array_equal(np.flatnonzero(turned), layout.turns(family.FORM))
    np.testing.assert_array_equal(np.flatnonzero(~turned), layout.shifts(family.FORM))
    covariance = np.diag(np.arange(1.0, family.SIZE + 1.0))
    geometry = model.geometry(x, covariance, 0.5)
    kinds = {"f": Plane, "e": Line, "v": Point}
    sides = type(geometry.object), type(geometry.environment)
    assert tuple(kinds[kind] for kind in model.contact.value.split("-")) == sides
    if model.contact in (Contact.EE, Contact.VF):
        first = len(geometry.object.covariance)
        np.testing.assert_array_equal(geometry.object.covariance, covariance[:first, :first])
        np.testing.assert_array_equal(geometry.environment.covariance, covariance[first:, first:])


@each_case
def test_rows_give_the_papers_objective(model, seed):
    """f-f with h_o = 0, v-f, f-v and e-e: equal. e-f, f-e: the paper weights the angle by 1 + |q|^2."""
    rng = np.random.default_rng(seed)
    rotation, t = random_poses(rng)
    x = random_x(model, rng)
    squares = (residuals(model, x, rotation, t) ** 2).sum(axis=0)
    if model.contact in (Contact.EF, Contact.FE):
        squares[0] *= 1.0 + x[3:6] @ x[3:6]
    found = direct(model.contact, *motion(rotation, t), *elements_of(model.contact, x))
    assert found == pytest.approx(squares.sum(), rel=1e-9)


@quick
@given(seed=seeds, offset=st.floats(-1.0, 1.0))
def test_papers_f_f_with_any_offset(seed, offset):
    """(1 + h_o^2) times the angles and the distance of the object face's foot: h_o is a gauge at angle 0."""
    model = CONTACT_MODELS[Contact.FF.column]
    rng = np.random.default_rng(seed)
    rotation, t = random_poses(rng)
    x = random_x(model, rng)
    angles = residuals(model, x, rotation, t)[:, :2]
    distance = np.einsum("i,nij,j->n", x[3:6], rotation, x[:3] * offset) + t @ x[3:6] - x[6]
    expected = (1.0 + offset**2) * np.sum(angles**2) + np.sum(distance**2)
    found = direct(Contact.FF, *motion(rotation, t), np.append(x[:3], offset), x[3:7])
    assert found == pytest.approx(expected, rel=1e-9)


@each_case
def test_vanishes_where_the_elements_touch(model, seed):
    rng = np.random.default_rng(seed)
    t = touching(model.contact, rng)
    x = x_of(model.contact, t.object, t.environment)
    assert np.abs(residuals(model, x, t.rotation, t.position_m)).max() < 1e-12
    measured = model.measure(x[None], lifted_pose.lift(t.rotation, t.position_m))
    assert np.abs(measured.residual).max() < 1e-10
    assert (measured.lever_sq <= measured.reach_sq + 1e-9).all()


@each_case
def test_measure_agrees_with_rows(model, seed):
    """Equal angles; equal distances, except e-f (at the point nearest to the body) and e-e (per metre)."""
    rng = np.random.default_rng(seed)
    rotation, t = random_poses(rng)
    x = random_x(model, rng)
    by_rows = residuals(model, x, rotation, t).T
    measured = model.measure(x[None], lifted_pose.lift(rotation, t))
    exact = measured.residual[0]
    np.testing.assert_allclose(exact[:-1], by_rows[:-1], atol=1e-12)
    if model.contact is Contact.FE:
        rotation_ew = np.swapaxes(rotation, 1, 2)  # frame 1 is the world: its pose in the body
        s = (t - x[3:6]) @ x[:3]
        by_rows[1] += s * np.einsum("i,nij,j->n", x[6:9], rotation_ew, x[:3])
    np.testing.assert_allclose(exact[-1] * np.sqrt(scale_sq(model, x, rotation, t)), by_rows[-1], atol=1e-9)


@each_case
def test_the_lever_is_the_change_of_the_distance_per_turn_of_the_body(model, seed):
    rng = np.random.default_rng(seed)
    t = touching(model.contact, rng, frames=1)
    x = x_of(model.contact, t.object, t.environment)
    step = 1e-6
    turned = Rotation.from_rotvec(step * np.eye(3)).as_matrix() @ t.rotation
    slopes = (
        model.measure(x[None], lifted_pose.lift(turned, t.position_m.repeat(3, axis=0))).residual[0, -1]
        / step
    )
    measured = model.measure(x[None], lifted_pose.lift(t.rotation, t.position_m))
    assume(scale_sq(model, x, t.rotation, t.position_m)[0] > 0.01)
    assert np.sum(np.square(slopes)) == pytest.approx(measured.lever_sq[0, 0], rel=1e-3, abs=1e-6)


@each_case
def test_the_distance_is_measured_along_its_direction_in_the_world(model, seed):
    rng = np.random.default_rng(seed)
    t = touching(model.contact, rng, frames=2)
    x = x_of(model.contact, t.object, t.environment)
    assume((scale_sq(model, x, t.rotation, t.position_m) > 0.01).all())

    def distance(position_m):
        return model.measure(x[None], lifted_pose.lift(t.rotation, position_m)).residual[0, -1]

    here, step = distance(t.position_m), 1e-6
    slopes = [(distance(t.position_m + step * axis) - here) / step for axis in np.eye(3)]
    along = model.measure(x[None], lifted_pose.lift(t.rotation, t.position_m)).along[0]
    side = np.sign(np.sum(np.transpose(slopes) * along, axis=1))[:, None]
    np.testing.assert_allclose(np.transpose(slopes), side * along, atol=1e-5)


@each_case
def test_gradient_agrees_with_finite_differences(model, seed):
    """For the sum of squares along the retraction, which unlike the rows of f-f does not depend on axes."""
    rng = np.random.default_rng(seed)
    family, anchors = model.family, rng.normal(size=6) * 0.3
    zeta = model.lifted(lifted_pose.lift(*random_poses(rng)))
    x = random_x(model, rng, anchors)
    weight = np.full(family.ROWS, 3.0)
    weight[-1] = 0.7

    def cost(y):
        return 0.5 * np.sum(weight * (zeta @ family.rows(y).T) ** 2)

    tangent = family.tangent(x, anchors)
    r = zeta @ family.rows(x).T
    by_x = np.einsum("nk,k,ksc,nc->s", r, weight, family.rows_derivative(x), zeta)
    gradient = tangent.T @ by_x
    assert tangent.shape == (family.SIZE, family.PARAMETERS)
    assert np.linalg.matrix_rank(tangent) == family.PARAMETERS
    step = 1e-6
    numeric = [
        (cost(family.normalise(x + step * v, anchors)) - cost(family.normalise(x - step * v, anchors)))
        / (2 * step)
        for v in tangent.T
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5 * max(np.abs(gradient).max(), 1.0))


@each_case
def test_the_scale_is_the_sine_of_crossing_edges_and_otherwise_one(model, seed):
    """At its mean over poses, and the derivative of its logarithm against finite differences."""
    rng = np.random.default_rng(seed)
    rotation, t = random_poses(rng)
    x = random_x(model, rng)
    zeta = model.lifted(lifted_pose.lift(rotation, t))
    moments = zeta.T @ zeta
    expected = 1.0
    if model.contact is Contact.EE:
        expected = 1.0 - np.mean(np.einsum("i,nij,j->n", x[6:9], rotation, x[:3])) ** 2
    assert model.family.scale_sq(x, moments) == pytest.approx(expected, rel=1e-9)
    step = 1e-6
    numeric = [
        np.log(model.family.scale_sq(x + step * e, moments) / model.family.scale_sq(x - step * e, moments))
        / (2 * step)
        for e in np.eye(len(x))
    ]
    np.testing.assert_allclose(model.family.log_scale_sq_derivative(x, moments), numeric, atol=1e-6)


@pytest.mark.parametrize("angle_deg", [0.0, 0.01, 0.3, 45.0])
def test_only_edges_that_are_parallel_have_no_distance(angle_deg):
    """Two along a straight slide are a centimetre apart, not in contact."""
    angle, model = np.radians(angle_deg), CONTACT_MODELS[Contact.EE.column]
    x = np.concatenate([[1.0, 0.0, 0.0], np.zeros(3), [np.cos(angle), np.sin(angle), 0.0], [0.0, 0.0, 0.01]])
    measured = model.measure(x[None], lifted_pose.lift(np.eye(3)[None], np.zeros((1, 3))))
    assert abs(measured.residual[0, 0, 0]) == pytest.approx(0.01 if angle else 0.0, rel=1e-6, abs=1e-15)
    assert np.isfinite(measured.lever_sq).all()


@pytest.mark.parametrize("contact", [Contact.EE, Contact.VF])
def test_starts_do_not_change_with_the_number_of_poses(contact):
    """Moments of a million times as many poses have the same directions, also those set by the ridge."""
    model = CONTACT_MODELS[contact.column]
    t = touching(contact, np.random.default_rng(3), swing=1e-3)
    zeta = model.lifted(lifted_pose.lift(t.rotation, t.position_m))
    moments = (zeta.T @ zeta)[None]
    few, many = model.family.starts(moments)[0], model.family.starts(1e6 * moments)[0]
    directions = layout.directions(model.family.FORM)
    np.testing.assert_allclose(np.abs(few[:, directions]), np.abs(many[:, directions]), atol=1e-6)


def test_an_edge_is_the_same_wherever_on_it_its_point_is():
    model, rng = CONTACT_MODELS[Contact.EE.column], np.random.default_rng(2)
    zeta, x = lifted_pose.lift(*random_poses(rng)), random_x(model, rng)
    shifted = x.copy()
    shifted[3:6] += 0.2 * x[:3]
    shifted[9:12] -= 0.7 * x[6:9]
    same, found = model.measure(x[None], zeta), model.measure(shifted[None], zeta)
    for name in ("residual", "lever_sq", "reach_sq", "along"):
        np.testing.assert_allclose(getattr(found, name), getattr(same, name), atol=1e-9, err_msg=name)


@pytest.mark.parametrize("angle_deg", [0.0, 3e-5])
def test_below_its_floor_the_sine_has_no_derivative(angle_deg):
    family, x, moments = CONTACT_MODELS[Contact.EE.column].family, np.zeros((1, 12)), np.zeros((1, 19, 19))
    x[0, :3], x[0, 6:9] = [1.0, 0.0, 0.0], [np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg)), 0.0]
    moments[0, 18, :9], moments[0, 18, 18] = np.eye(3).ravel(), 1.0
    assert (family.log_scale_sq_derivative(x, moments) == 0.0).all()
    x[0, 6:9] = [0.8, 0.6, 0.0]
    assert (family.log_scale_sq_derivative(x, moments) != 0.0).any()


def test_the_offset_of_touching_faces_is_unobservable():
    """Only their distance is known, with an uncertainty of the offsets of the reach of the body."""
    rng, model = np.random.default_rng(1), CONTACT_MODELS[Contact.FF.column]
    root = rng.normal(size=(7, 7))
    covariance, reach_sq = root @ root.T, np.diag([0.0, 0.0, 0.0, 0.5**2])
    x = random_x(model, rng)
    geometry = model.geometry(x, covariance, 0.5)
    assert (geometry.object.offset_m, geometry.environment.offset_m) == (0.0, x[6])
    expected = reach_sq.copy()
    expected[:3, :3] = covariance[:3, :3]
    np.testing.assert_allclose(geometry.object.covariance, expected)
    np.testing.assert_allclose(geometry.environment.covariance, covariance[3:, 3:] + reach_sq)
