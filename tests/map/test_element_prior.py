"""Known elements as priors: the mean satisfies the contact, the information is that of their accuracy."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS, face_face
from contact_tracker.geometry.elements import (
    Element,
    Line,
    Origins,
    Plane,
    Point,
    by_foot,
    canonical,
    numbers,
    of_numbers,
)
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.births import Birth, add, propose_births
from contact_tracker.map.elements import is_same_element
from contact_tracker.map.map import EMPTY_MAP, Accuracy, Map, NamedElement, Up, known_to
from contact_tracker.map.pairs import UNLISTED, Frame, PairPrior, named_pairs, pair_priors
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import forward

ACCURACY = Accuracy(2e-3, 0.01)
FREEDOM = {"f": 3, "e": 4, "v": 3}
each_contact = pytest.mark.parametrize("model", CONTACT_MODELS, ids=list(CONTACTS))


@cache
def touching(contact):
    """Exact poses in a contact, and its true elements with an accuracy."""
    scenario = Scenario((Phase(contact, 1.0),), sigma_position_m=0.0, sigma_rotation_rad=0.0)
    simulated = simulate(scenario, 5)
    geometry, poses = simulated.truth.intervals[0].geometry, simulated.poses
    return poses, known_to(geometry.object, ACCURACY), known_to(geometry.environment, ACCURACY)


def prior(model, object=True, environment=True):
    poses, ours, theirs = touching(model.contact)
    pair = ours if object else None, theirs if environment else None
    mean, information, (pivot,) = pair_priors(model, [pair])[:3]
    anchors = np.where(np.isnan(pivot), model.anchors(poses.position_m.mean(axis=0)), pivot)
    return PairPrior(mean[0], information[0], pivot), anchors


@pytest.mark.parametrize("side", ["object", "environment"])
def test_a_known_face_determines_the_normal_of_the_other(side):
    """For either sign of the normals of the best hypothesis."""
    model, (poses, *elements) = CONTACT_MODELS[Contact.FF.column], touching(Contact.FF)
    both, _ = prior(model)
    reversed_ = both.mean.copy()
    reversed_[face_face.M if side == "environment" else face_face.N] *= -1.0
    known_map = Map(**{f"listed_{side}": (NamedElement("table", elements[side == "environment"]),)})
    world = GrowingMap(1.0).with_prior(known_map.prior)
    begins = propose_births(model, known_map, world.whole, 0.0, Frame.around(Origins.zero(), np.zeros(3)))
    turn = poses.rotation[0]
    bank = add(
        blank(model, 1).replace_columns(x=reversed_),
        model,
        Birth(begins, 7, 0, 1, 0.0, np.zeros((0, 7)), turn),
    )
    knows = bank.prior_index > 0
    assert knows.any()
    sense = np.sign(bank.x[knows, :1] * both.mean[0])  # both normals may be reversed
    np.testing.assert_allclose(sense * bank.x[knows, :6], [both.mean[:6]] * knows.sum(), atol=1e-9)
    np.testing.assert_array_equal(bank.x[~knows], [reversed_] * (~knows).sum())


def drawn(element, rng, count):
    """Parameters (count, n) of elements drawn with their covariance."""
    size = len(numbers(element))
    return rng.multivariate_normal(numbers(element), element.covariance, count, method="eigh").reshape(
        -1, size
    )


@each_contact
def test_information_is_that_of_the_covariance_of_the_elements(model):
    """Elements drawn from their covariances have chi-squared distances from the mean."""
    known, anchors = prior(model)
    rng, count = np.random.default_rng(3), 4000
    ours, theirs = (drawn(element, rng, count) for element in touching(model.contact)[1:])
    if model.contact.value == "f-f":
        x = np.concatenate([-ours[:, :3], theirs[:, :3], ours[:, 3:] + theirs[:, 3:]], axis=1)
    else:
        x = np.concatenate([ours, theirs] if model.body_in_1 else [theirs, ours], axis=1)
    tangent = model.family.tangent(known.mean, anchors)
    off = (model.family.normalise(x, anchors) - known.mean) @ np.linalg.pinv(tangent).T
    along = tangent.T @ known.information @ tangent
    squared = np.einsum("bp,pq,bq->b", off, along, off)
    assert squared.mean() == pytest.approx(model.family.PARAMETERS, rel=0.05)
    np.testing.assert_allclose(known.information, known.information.T, atol=1e-9 * np.abs(along).max())


@each_contact
def test_one_known_element_determines_its_part_of_x_only(model):
    both = prior(model)[0]
    one, other = prior(model, environment=False)[0], prior(model, object=False)[0]
    if model.contact.value == "f-f":  # the offset takes both
        assert np.linalg.matrix_rank(one.information) == np.linalg.matrix_rank(other.information) == 2
        np.testing.assert_allclose((one.mean + other.mean)[:6], both.mean[:6])
    else:
        object_kind, _, environment_kind = model.contact.value
        assert np.linalg.matrix_rank(one.information) == FREEDOM[object_kind]
        assert np.linalg.matrix_rank(other.information) == FREEDOM[environment_kind]
        np.testing.assert_allclose(one.mean + other.mean, both.mean)
        second = model.family.FORM.d2
        assert not both.information[:second, second:].any()  # kernels rely on that
        np.testing.assert_allclose(one.information + other.information, both.information, atol=1e-6)
    nothing = prior(model, object=False, environment=False)[0]
    assert not nothing.mean.any()
    assert not nothing.information.any()


def known_map(**changes):
    corners = [NamedElement(f"corner {i}", touching(CONTACTS[3])[1]) for i in range(4)]
    table = NamedElement("table", touching(CONTACTS[3])[2])
    return Map(**({"listed_object": tuple(corners), "listed_environment": (table,)} | changes))


def test_a_reversed_line_has_the_same_prior():
    """The covariance of direction and point changes its sign with the direction."""
    rng = np.random.default_rng(0)
    point_m = np.array([0.3, 0.0, -0.2])
    for direction in (np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.6, -0.8])):
        across = np.kron(np.eye(2), np.eye(3) - np.outer(direction, direction))
        root = across @ (1e-3 * rng.normal(size=(6, 6)))
        line = Line(direction, point_m, root @ root.T)
        reversed_ = canonical(line)
        np.testing.assert_array_equal(reversed_.direction, -direction)
        assert canonical(reversed_) is reversed_
        # points along it, s from the foot, are as uncertain as they were
        for s in (-1.0, 0.0, 2.0):
            at = [np.hstack([s * turned * np.eye(3), np.eye(3)]) for turned in (1.0, -1.0)]
            expected, found = at[0] @ line.covariance @ at[0].T, at[1] @ reversed_.covariance @ at[1].T
            np.testing.assert_allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize("complete", [(False, False), (True, False), (False, True), (True, True)])
def test_shares_of_all_pairs_add_up_to_one_or_none_is_possible(complete):
    known = known_map(object_complete=complete[0], environment_complete=complete[1])
    for model in CONTACT_MODELS:
        pairs = named_pairs(known, model)
        object_kind, _, environment_kind = model.contact.value
        impossible = (complete[0] and object_kind != "v") or (complete[1] and environment_kind != "f")
        assert sum(np.exp(pair.log_share) for pair in pairs) == pytest.approx(0.0 if impossible else 1.0)
        assert len({pair.touching for pair in pairs}) == len(pairs)


def test_known_and_unknown_elements_are_equally_likely_and_nothing_known_is_one_unknown_pair():
    (v_f,) = (model for model in CONTACT_MODELS if model.contact.value == "v-f")
    pairs = named_pairs(known_map(), v_f)
    unknown = [pair for pair in pairs if pair.environment is None]
    assert sum(np.exp(pair.log_share) for pair in unknown) == pytest.approx(UNLISTED)
    certain = [pair.touching for pair in pairs if pair.is_certain]
    assert certain == [(f"corner {i}", "table") for i in range(4)]
    for model in CONTACT_MODELS:
        (pair,) = named_pairs(EMPTY_MAP, model)
        assert (pair.touching, pair.log_share, pair.is_certain) == ((None, None), 0.0, False)


def test_up_is_a_prior_on_the_normal_of_unknown_faces_only():
    up = Up(np.array([0.0, 0.6, 0.8]), 0.02)
    for model in CONTACT_MODELS:
        pairs = named_pairs(known_map(up=up), model)
        for pair in pairs:
            assert (pair.up is up) == (pair.environment is None and model.contact.value.endswith("f"))
    (v_f,) = (model for model in CONTACT_MODELS if model.contact.value == "v-f")
    (pair,) = named_pairs(Map(up=up), v_f)
    known = pair_priors(v_f, [pair.pair(Frame((5.0, 6.0, 7.0), (0.0,) * 3, (0.0,) * 3))])
    mean, information = known.mean[0], known.information[0]
    np.testing.assert_allclose(mean[3:6], up.direction)
    tilt = np.array([0, 0, 0, 0.0, 0.8, -0.6, 0])
    assert tilt @ information @ tilt == pytest.approx(0.02**-2, rel=1e-3)
    assert np.abs(information[[0, 1, 2, 6]][:, [0, 1, 2, 6]]).max() < 1e-5


def test_a_line_is_recognised_wherever_along_it_its_point_is():
    simulated = simulate(Scenario((Phase(Contact.FE, 3.0),)), 2)
    edge = simulated.truth.intervals[0].geometry.environment
    moved = known_to(replace(edge, point_m=edge.point_m + 3.0 * edge.direction), Accuracy())
    *_, last = forward(
        simulated.poses, load_model(), known_map=Map(listed_environment=(NamedElement("rail", moved),))
    )
    assert last.belief.geometry.environment.name == "rail"


# --- whether two estimated elements may be the same ---
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
    return of_numbers(type(element), values, element.covariance)


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


@pytest.mark.parametrize(
    ("apart_rad", "is_same"), [(0.0, True), (1e-4, True), (0.3, False), (np.pi / 2.0, False)]
)
def test_lines_through_a_known_point_differ_by_their_directions(apart_rad, is_same):
    """As the axes of sliders, which go through the body's origin."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 1e-8 * np.eye(3)
    turned = Rotation.from_rotvec([0.3 * apart_rad, 0.0, apart_rad]).apply([0.6, 0.8, 0.0])
    lines = [Line(direction, np.zeros(3), covariance) for direction in (np.array([0.6, 0.8, 0.0]), turned)]
    assert is_same_element(*lines) is is_same
    moved = replace(lines[1], point_m=np.array([0.0, 0.0, 1e-3]))
    assert not is_same_element(lines[0], moved)


@pytest.mark.parametrize("offset_m", [-0.1, 0.0])
def test_faces_with_opposite_normals_do_not_match(offset_m):
    table = replace(TABLE, offset_m=offset_m)
    assert not is_same_element(table, replace(table, normal=-table.normal, offset_m=-offset_m))


@pytest.mark.parametrize("far_m", [1.0, 1e6])
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
