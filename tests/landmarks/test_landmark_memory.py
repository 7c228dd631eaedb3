"""Landmark memory: stored elements, their fusion, and candidates for new contacts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import block_diag

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, by_foot, numbers
from contact_tracker.geometry.incidence import LENGTH_M
from contact_tracker.geometry.vectors import sphere_tangent
from contact_tracker.hypotheses.birth import BirthProposals
from contact_tracker.hypotheses.birth_proposals import Frame, propose_births
from contact_tracker.landmarks.association import fuse, is_same_element
from contact_tracker.landmarks.landmark_memory import KEPT, LAST, LOOSE_RAD, LandmarkMemory
from contact_tracker.landmarks.prior_map import EMPTY_MAP, Accuracy, NamedElement, PriorMap, known_to
from contact_tracker.states import Contact

ORIGIN = np.zeros(3)
ALONG = np.array([0.0, 0.6, 0.8])
EDGE = Line(ALONG, np.array([0.1, 0.0, 0.0]), 1e-8 * np.eye(6))
TABLE = Plane(np.array([0.0, 0.0, 1.0]), -0.1, 1e-8 * np.eye(4))
ON_THE_TABLE = ContactGeometry(EDGE, TABLE)


def offers(memory: LandmarkMemory, contact: Contact) -> BirthProposals:
    model = CONTACT_MODELS[contact.column]
    return propose_births(model, EMPTY_MAP, memory, 0.5, Frame.around(ORIGIN, ORIGIN))


def test_an_empty_memory_has_no_candidates():
    for model in CONTACT_MODELS:
        begins = offers(LandmarkMemory(), model.contact)
        assert begins.count == 1
        assert begins.rows.prior_index[0] == 0
        assert begins.rows.needs_search[0]


def test_the_same_elements_are_candidates_again_and_shares_add_up():
    memory = LandmarkMemory().insert(ON_THE_TABLE, 5, 100, ORIGIN)
    begins = offers(memory, Contact.EF)
    assert begins.count == 4  # nothing, the edge, the table, both
    assert np.exp(begins.log_share).sum() == pytest.approx(1.0)
    assert not begins.rows.elements_known.any()
    # the edge's direction or the table's normal may be open, and is searched for
    assert list(begins.rows.needs_search) == [True, True, True, False]


def test_a_longer_contact_replaces_its_landmarks_and_only_the_latest_are_kept():
    memory = LandmarkMemory().insert(ON_THE_TABLE, 5, 100, ORIGIN).insert(ON_THE_TABLE, 5, 100, ORIGIN)
    assert len(memory.object) == 1
    for onset_ns in range(10):
        memory = memory.insert(ON_THE_TABLE, onset_ns, 100, ORIGIN)
    assert [landmark.onset_ns for landmark in memory.object] == list(range(10 - KEPT, 10))


def test_duplicate_landmarks_are_one_candidate():
    memory = LandmarkMemory().insert(ON_THE_TABLE, 5, 100, ORIGIN)
    other_end = replace(EDGE, direction=-ALONG, point_m=EDGE.point_m + 0.3 * ALONG + [2e-4, 0.0, 0.0])
    for again in (ON_THE_TABLE, replace(ON_THE_TABLE, object=other_end)):
        begins = offers(memory.insert(again, 7, 100, ORIGIN), Contact.EF)
        assert begins.count == 4
        edges = begins.rows.prior_mean[begins.rows.prior_mean[:, :3].any(axis=1), :3]
        np.testing.assert_array_equal(edges[0], edges[1])
        np.testing.assert_allclose(edges[0], again.object.direction, atol=LOOSE_RAD)
    # beside those four the first edge and its table, each with the last elements
    assert offers(memory.insert(elsewhere(ON_THE_TABLE, 0.01), 7, 100, ORIGIN), Contact.EF).count == 6


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


def test_fusion_keeps_the_old_estimate_in_unobserved_directions():
    """Sliding faces do not determine their height: f-f has no information on that of the table."""
    vague = replace(TABLE, offset_m=-0.05, covariance=np.diag([1e-8, 1e-8, 1e-8, 0.3**2]))
    memory = LandmarkMemory().insert(ON_THE_TABLE, 5, 100, ORIGIN)
    again = memory.insert(replace(ON_THE_TABLE, environment=vague), 7, 100, ORIGIN)
    begins = offers(again, Contact.VF)
    heights = begins.rows.prior_information[:, -1, -1]
    assert set(np.rint(1e-6 * heights[heights > 0.0])) == {10.0}  # 0.3 mm and a little, as after the first
    np.testing.assert_allclose(begins.rows.prior_mean[heights > 0.0, -1], -0.1, atol=1e-6)


def with_uneven_uncertainty(element: Element, rng: np.random.Generator) -> Element:
    """The element with very different uncertainties in its free directions."""
    across = [sphere_tangent(numbers(element)[:3])] if not isinstance(element, Point) else []
    rest = {Point: [np.eye(3)], Plane: [np.eye(1)], Line: across}[type(element)]
    free = block_diag(*across, *rest)
    mixed = rng.normal(size=(free.shape[1],) * 2) * 10.0 ** rng.uniform(-1.5, 0.5, free.shape[1])
    return replace(element, covariance=1e-5 * free @ mixed @ mixed.T @ free.T)


def reparametrised(element: Element) -> Element:
    """The same line, given by another point and the opposite direction."""
    if not isinstance(element, Line):
        return element
    moved = by_foot(element, element.point_m + 0.7 * element.direction)
    flip = np.repeat([-1.0, 1.0], 3)
    return replace(moved, direction=-moved.direction, covariance=flip[:, None] * moved.covariance * flip)


@pytest.mark.parametrize("element", [Point(np.array([0.1, 0.2, 0.3])), TABLE, EDGE], ids=["v", "f", "e"])
def test_fusion_of_equal_estimates_changes_nothing(element):
    """The later estimate is not independent: the earlier one may have been its prior."""
    later = with_uneven_uncertainty(element, np.random.default_rng(2))
    for earlier in (later, reparametrised(later)):
        found = fuse(later, earlier)
        np.testing.assert_allclose(numbers(found), numbers(later), atol=1e-9)
        np.testing.assert_allclose(found.covariance, later.covariance, atol=1e-9 * later.covariance.max())


@pytest.mark.parametrize("seed", [0, 2, 3])  # each with ways of both
@pytest.mark.parametrize("element", [TABLE, EDGE], ids=["f", "e"])
def test_fusion_does_not_depend_on_the_representation_of_lines(element, seed):
    rng = np.random.default_rng(seed)
    later, values = (
        with_uneven_uncertainty(element, rng),
        numbers(element) + 1e-4 * rng.normal(size=6)[: len(numbers(element))],
    )
    values[:3] /= np.linalg.norm(values[:3])
    earlier = with_uneven_uncertainty(with_numbers(element, values), rng)
    expected, found = fuse(later, earlier), fuse(later, reparametrised(earlier))
    np.testing.assert_allclose(numbers(found), numbers(expected), atol=1e-5)
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-2 * expected.covariance.max())
    for one in (later, earlier):  # some of each
        assert np.abs(expected.covariance - one.covariance).max() > 0.05 * expected.covariance.max()


@pytest.mark.parametrize("turn_rad", [0.1, 0.3, 0.6, 1.0])
def test_a_precise_estimate_is_kept_against_an_imprecise_one(turn_rad):
    """A precisely known edge, and an imprecise one turned by as much as its uncertainty."""
    known = known_to(EDGE, Accuracy(position_m=3e-4, rotation_rad=2e-3))
    turned = np.array([np.sin(turn_rad), 0.6 * np.cos(turn_rad), 0.8 * np.cos(turn_rad)])
    vague = known_to(Line(turned, EDGE.point_m), Accuracy(position_m=3e-4, rotation_rad=turn_rad / 1.5))
    for found in (fuse(known, vague), fuse(vague, known)):
        assert np.linalg.norm(np.cross(found.direction, ALONG)) < 2e-4
        np.testing.assert_allclose(found.point_m, EDGE.point_m, atol=3e-4)
    assert is_same_element(known, vague) is is_same_element(vague, known) is True


def test_matching_of_lines_is_symmetric():
    """For a known line, and one that is turned and shifted by about as much as its uncertainty."""
    known = known_to(EDGE, Accuracy(position_m=3e-4, rotation_rad=2e-3))
    turned = np.array([np.sin(1.0), 0.6 * np.cos(1.0), 0.8 * np.cos(1.0)])
    places = EDGE.point_m + 8e-4 * np.random.default_rng(7).normal(size=(100, 3))
    vague = [known_to(Line(turned, place), Accuracy(position_m=3e-4, rotation_rad=0.4)) for place in places]
    same = [is_same_element(known, one) for one in vague]
    assert 5 < sum(same) < 95
    assert same == [is_same_element(one, known) for one in vague]


def test_a_fused_line_is_given_at_its_last_contact():
    """Its point is near the body at that time, where its ends are searched."""
    later = known_to(EDGE, Accuracy(1e-3, 2e-3))
    before = known_to(
        replace(EDGE, direction=-ALONG, point_m=EDGE.point_m + 1.0 * ALONG), Accuracy(1e-3, 1e-3)
    )
    found = fuse(later, before)
    np.testing.assert_allclose(numbers(found), numbers(later), atol=1e-12)


@pytest.mark.parametrize("turn_rad", [0.1, 0.3, 0.6])
def test_a_direction_observed_once_is_fused_after_any_rotation(turn_rad):
    """The two estimates of a normal are each exact about one axis."""
    first, second = (np.diag([(1e-3, 0.6)[i] ** 2, (0.6, 1e-3)[i] ** 2, 0.0, 1e-6]) for i in (0, 1))
    turned = np.array([0.0, np.sin(turn_rad), np.cos(turn_rad)])
    later, earlier = Plane(np.array([0.0, 0.0, 1.0]), 0.0, first), Plane(turned, 0.0, second)
    np.testing.assert_allclose(fuse(later, earlier).normal, turned, atol=2e-3)


@pytest.mark.parametrize("vague_m", [1.0, 30.0, 1000.0])
def test_fused_covariances_are_valid(vague_m):
    """If each estimate has a different unobserved direction, the fused element has none."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        ways = rng.normal(size=(2, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        points = [
            Point(p, 9e-8 * np.eye(3) + vague_m**2 * np.outer(w, w))
            for p, w in zip(np.zeros((2, 3)), ways, strict=True)
        ]
        found = np.linalg.eigvalsh(fuse(*points).covariance)
        assert found[0] > 4e-8
        if np.linalg.norm(np.cross(*ways)) > 0.2:
            assert found[-1] < 1e-5


@pytest.mark.parametrize(
    ("later", "earlier"), [([1.0, 3.9, 4.1], [2.0, 1.0, 1.0]), ([1.0, 1.0, 1.0], [9.0, 0.26, 0.24])]
)
def test_fusion_keeps_the_latest_estimate_unless_the_older_is_far_better(later, earlier):
    """For points, by axis: the later one, unless the earlier one is more than twice as precise."""
    rng = np.random.default_rng(1)
    axes, places = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=(2, 3))
    found = fuse(
        *(Point(p, axes @ np.diag(v) @ axes.T) for p, v in zip(places, (later, earlier), strict=True))
    )
    expected = axes @ np.diag([*later[:2], earlier[2]]) @ axes.T
    np.testing.assert_allclose(found.covariance, expected, atol=1e-9)
    np.testing.assert_allclose(axes.T @ found.point_m, [*(axes.T @ places[0])[:2], (axes.T @ places[1])[2]])


def test_fusion_is_invariant_to_rotation_and_scale():
    """The result does not depend on the axes of points and covariances."""
    rng = np.random.default_rng(5)
    points = [with_uneven_uncertainty(Point(place), rng) for place in rng.normal(size=(2, 3))]
    stretch = rng.normal(size=(3, 3))
    stretched = [Point(stretch @ p.point_m, stretch @ p.covariance @ stretch.T) for p in points]
    found, expected = fuse(*stretched), fuse(*points)
    np.testing.assert_allclose(found.point_m, stretch @ expected.point_m, atol=1e-6)
    np.testing.assert_allclose(found.covariance, stretch @ expected.covariance @ stretch.T, atol=1e-9)
    assert (
        np.abs(expected.point_m - points[0].point_m).max() > 1e-3
    )  # the earlier one is better in some direction


def test_prior_information_is_not_counted_twice():
    """An update of the earlier by a measurement is at least as precise in all directions."""
    rng = np.random.default_rng(4)
    a, row = rng.normal(size=(3, 3)), rng.normal(size=(1, 3))
    before = Point(rng.normal(size=3), a @ a.T + 0.1 * np.eye(3))
    gain = before.covariance @ row.T / (row @ before.covariance @ row.T + 0.01)
    after = Point(before.point_m + 0.1 * gain[:, 0], before.covariance - gain @ row @ before.covariance)
    found = fuse(after, before)
    np.testing.assert_allclose(found.point_m, after.point_m, atol=1e-9)
    np.testing.assert_allclose(found.covariance, after.covariance, atol=1e-9)


def test_landmarks_are_updated_after_half_the_duration_again():
    memory = LandmarkMemory()
    assert memory.is_due(10, 20)
    memory = memory.insert(ON_THE_TABLE, 10, 20, ORIGIN)
    assert [memory.is_due(10, stamp_ns) for stamp_ns in (21, 24, 25, 40)] == [False, False, True, True]
    assert memory.is_due(11, 21)  # another contact
    memory = memory.insert(CORNER, 30, 40, ORIGIN).insert(ON_THE_TABLE, 10, 50, ORIGIN)
    assert [memory.is_due(10, stamp_ns) for stamp_ns in (65, 70)] == [False, True]


def test_a_vertex_may_be_anywhere_on_the_edge_that_turned():
    """From e-f to v-f the plane stays, and the vertex lies on the edge."""
    memory = LandmarkMemory().insert(ON_THE_TABLE, 5, 100, ORIGIN)
    begins, size = offers(memory, Contact.VF), 7
    assert begins.count == 4  # nothing, an end of the edge, the table, both
    (both,) = [
        i for i in range(4) if begins.rows.prior_mean[i, :3].any() and begins.rows.prior_mean[i, 3:].any()
    ]
    information = begins.rows.prior_information[both]
    assert information.shape == (size, size)
    on_point = np.linalg.inv(information[:3, :3])
    assert np.sqrt(ALONG @ on_point @ ALONG) == pytest.approx(LENGTH_M, rel=0.01)
    assert np.sqrt(on_point[0, 0]) < 2e-3  # across


CORNER = ContactGeometry(Point(np.array([0.1, 0.2, 0.3]), 1e-8 * np.eye(3)), TABLE)


def elsewhere(geometry: ContactGeometry, off_m: float) -> ContactGeometry:
    """The geometry, all of it shifted by ``off_m``."""
    ours, table, off = geometry.object, replace(TABLE, offset_m=TABLE.offset_m + off_m), [off_m, 0.0, 0.0]
    assert isinstance(ours, Line | Point)
    return ContactGeometry(replace(ours, point_m=ours.point_m + off), table)


def test_candidates_pair_with_elements_that_may_touch_them():
    memory = LandmarkMemory()
    for onset_ns in range(0, 6, 2):  # edges at 2 and 4, corners at 3 and 5, the table at 4 and 5 are kept
        memory = memory.insert(elsewhere(ON_THE_TABLE, 0.01 * onset_ns), onset_ns, 100, ORIGIN)
        memory = memory.insert(elsewhere(CORNER, 0.01 * onset_ns + 0.01), onset_ns + 1, 100, ORIGIN)
    # nothing; 5 and its table with an unknown one; 3-5, 5-4, 5-5; an end of the edge with the table of 5
    assert offers(memory, Contact.VF).count == 1 + 2 + 3 + 1
    # nothing; 4 and the table of 5 with an unknown one; 2-5, 4-5; an edge through the corner on its table
    assert offers(memory, Contact.EF).count == 1 + 2 + 2 + 1
    # nothing; 4 with an unknown one; an edge through the corner of 5 and one in its table
    edges = offers(memory, Contact.EE)
    assert edges.count == 3
    directions = edges.rows.prior_mean[:, [0, 1, 2, 6, 7, 8]]
    through = ~np.isnan(edges.rows.line_anchor).all(axis=1) & ~directions.any(axis=1)
    (pivot,) = edges.rows.line_anchor[through]
    np.testing.assert_allclose(pivot[~np.isnan(pivot)], [0.15, 0.2, 0.3])


def test_elements_of_the_last_contact_are_likelier_than_others():
    memory = LandmarkMemory()
    for onset_ns in range(2):
        memory = memory.insert(elsewhere(CORNER, 0.01 * onset_ns), onset_ns, 100, ORIGIN)
    begins = offers(memory, Contact.VF)
    share = np.exp(begins.log_share[begins.rows.prior_index > 0])
    assert share.sum() == pytest.approx(0.5)
    assert share.max() / share.min() == pytest.approx(LAST)  # of all pairs one at least is of the last


SECOND = ContactGeometry(Point(np.array([-0.1, 0.2, 0.3]), 1e-8 * np.eye(3)), TABLE)


@pytest.mark.parametrize(
    ("before", "contact", "many"),
    [
        ((CORNER, SECOND), Contact.VF, 2),  # both corners
        ((ON_THE_TABLE, CORNER), Contact.EF, 2),  # the edge, and one through the corner
        ((CORNER, ON_THE_TABLE), Contact.VF, 2),  # the corner, and an end of the edge
    ],
)
def test_landmarks_are_candidates_beside_a_known_table(before, contact, many):
    knowledge, memory = PriorMap(environment=(NamedElement("table", TABLE),)), LandmarkMemory()
    for onset_ns, geometry in enumerate(before):
        known = replace(geometry, environment=replace(TABLE, name="table"))
        memory = memory.insert(known, onset_ns, 100, ORIGIN)
    model = CONTACT_MODELS[contact.column]
    begins = propose_births(model, knowledge, memory, 0.5, Frame.around(ORIGIN, ORIGIN))
    on_table = begins.rows.prior_information[:, model.family.FORM.d2 :, model.family.FORM.d2 :].any(
        axis=(1, 2)
    )
    assert (begins.rows.from_landmark & on_table).sum() == many


def test_the_last_landmark_pairs_with_all_and_new_elements_with_the_latest():
    wall = Plane(np.array([1.0, 0.0, 0.0]), -0.3, 1e-8 * np.eye(4))
    memory = (
        LandmarkMemory()
        .insert(CORNER, 1, 100, ORIGIN)
        .insert(replace(SECOND, environment=wall), 2, 100, ORIGIN)
    )
    begins = offers(memory, Contact.VF)
    new = ~begins.rows.prior_information[:, :3].any(axis=(1, 2))
    np.testing.assert_allclose(begins.rows.prior_mean[new & begins.rows.from_landmark][:, 3:6], [wall.normal])
    last = (begins.rows.prior_mean[:, :3] == SECOND.object.point_m).all(axis=1)
    beside = {tuple(normal) for normal in begins.rows.prior_mean[last, 3:6]}
    assert beside == {(0.0, 0.0, 0.0), tuple(TABLE.normal), tuple(wall.normal)}


def test_known_elements_pair_with_an_edge_through_a_vertex_landmark():
    """The known element is not stored, but was part of the last contact."""
    table = replace(TABLE, name="table")
    knowledge = PriorMap(environment=(NamedElement("table", TABLE),))
    memory = LandmarkMemory().insert(ContactGeometry(CORNER.object, table), 5, 100, ORIGIN)
    model = CONTACT_MODELS[Contact.EF.column]
    begins = propose_births(model, knowledge, memory, 0.5, Frame.around(ORIGIN, ORIGIN))
    on_table = ~np.isnan(begins.rows.line_anchor[:, 0]) & begins.rows.prior_mean[:, 6:9].any(axis=1)
    assert on_table.any()
