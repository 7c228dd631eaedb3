"""The map of elements: what sightings say about pairs, associations, and what other contacts may use."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.map.association import (
    CONCENTRATION,
    ElementEstimate,
    MapView,
    Sighting,
    log_prior_of_new,
    log_probabilities_of_new,
)
from contact_tracker.map.elements import WIDTHS, MapElement, kinds_of, stacked
from contact_tracker.map.pairs import known_entries, learned_pairs, pair_priors
from contact_tracker.map.world_map import MARGIN_S, GrowingMap
from contact_tracker.states import Contact

REACH_M = 0.3
BY_CONTACT = {model.contact: model for model in CONTACT_MODELS}
TABLE = MapElement("f", np.array([0.0, 0.0, 1.0]), np.array([0.2]))
BOTTOM = MapElement("f", np.array([0.0, 0.0, 1.0]), np.array([-0.05]))
TOP = MapElement("f", np.array([0.0, 0.0, 1.0]), np.array([0.05]))
CORNER = MapElement("v", np.zeros(3), np.array([0.04, 0.03, -0.05]))
OTHER_CORNER = MapElement("v", np.zeros(3), np.array([-0.04, 0.03, -0.05]))
EDGE = MapElement("e", np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.03, -0.05]))
SHELF = MapElement("f", np.array([0.0, 0.0, 1.0]), np.array([0.5]))


def seen(
    contact: Contact, pair, first: int, sd: float = 1e-3, turned: float = 1.0, rng=None, unknown=()
) -> Sighting:
    """A sighting of a pair with errors of ``sd``, except along ``unknown`` free directions of x."""
    model = BY_CONTACT[contact]
    anchors = np.array([0.0, 0.0, 0.0, 0.1, -0.1, 0.2])
    x, _ = stacked(model, pair, anchors, np.ones(2), turned)
    tangent = model.family.tangent(x[None], anchors[None])[0]
    information = np.eye(tangent.shape[1]) / sd**2
    information[list(unknown)] = 0.0
    if rng is not None:
        x = x + tangent @ rng.normal(0.0, sd, tangent.shape[1])
    rotation = np.eye(3) if turned > 0 else Rotation.from_rotvec([np.pi, 0, 0]).as_matrix()
    return Sighting(first, first + 20, ElementEstimate(contact, x, tangent, information, anchors, rotation))


@pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_derivative_of_a_pair(model: ContactModel, seed: int) -> None:
    """The derivative of x by the free coordinates of both elements is that of finite differences."""
    rng = np.random.default_rng(seed)

    def element(kind: str) -> MapElement:
        direction = rng.normal(size=3)
        size = {"f": 1, "e": 3, "v": 3}[kind]
        return MapElement(kind, direction / np.linalg.norm(direction), rng.normal(size=size))

    ours, theirs = map(element, kinds_of(model))
    anchors, senses, turned = rng.normal(size=6), rng.choice([-1.0, 1.0], 2), rng.choice([-1.0, 1.0])
    _, derivative = stacked(model, (ours, theirs), anchors, senses, turned)
    for column in range(derivative.shape[1]):
        step = np.zeros(derivative.shape[1])
        step[column] = 1e-6
        moved = []
        for change in (step, -step):
            pair = ours.moved(change[: ours.size]), theirs.moved(change[ours.size :])
            moved.append(stacked(model, pair, anchors, senses, turned)[0])
        np.testing.assert_allclose(derivative[:, column], (moved[0] - moved[1]) / 2e-6, atol=1e-8)


def learned(*pairs, turned=()) -> GrowingMap:
    """The map of contacts with these pairs, one every 100 ticks, of which those ``turned`` are upside
    down."""
    rng, sightings = np.random.default_rng(3), list[Sighting]()
    for i, pair in enumerate(pairs):
        contact = Contact(f"{pair[0].kind}-{pair[1].kind}")
        sightings.append(seen(contact, pair, 100 * i, turned=-1.0 if i in turned else 1.0, rng=rng))
    return GrowingMap.learn(sightings, REACH_M)


def test_contacts_of_one_face_share_it() -> None:
    """f-f knows the difference of two offsets only; a vertex on the same table gives both."""
    world = learned((BOTTOM, TABLE), (CORNER, TABLE), (EDGE, TABLE))
    assert len({theirs for _, theirs in world.pairs.values()}) == 1
    view = world.whole
    ours, theirs = world.pairs[0]
    assert view.elements[theirs].place_m[0] == pytest.approx(0.2, abs=5e-3)
    assert view.elements[ours].place_m[0] == pytest.approx(-0.05, abs=5e-3)
    sd_m = np.sqrt([view.covariance[view.slots[key]][:, view.slots[key]][2, 2] for key in (ours, theirs)])
    assert (sd_m < 3e-3).all()


def test_faces_at_another_height_are_another_pair() -> None:
    """Both sides of a box rest on one table, or one side on two: that is not the same pair."""
    world = learned((CORNER, TABLE), (BOTTOM, TABLE), (TOP, TABLE), (BOTTOM, TABLE), turned=[2])
    assert world.pairs[100] == world.pairs[300]
    assert world.pairs[200] != world.pairs[100]


def test_one_face_of_a_body_at_two_heights_touches_two_faces() -> None:
    """Another face of the body in the same direction would be behind the one that touches the table."""
    pairs = [*learned(*((BOTTOM, face) for face in (TABLE, SHELF, TABLE, SHELF))).pairs.values()]
    assert len({body for body, _ in pairs}) == 1
    assert len({environment for _, environment in pairs}) == 2
    assert pairs[0] == pairs[2] != pairs[1] == pairs[3]


def test_unseen_directions_do_not_separate() -> None:
    """Where a sighting shows nothing, its estimate may be anything."""
    rng = np.random.default_rng(5)
    far = MapElement("v", np.zeros(3), CORNER.place_m + 0.3 * np.eye(3)[0])
    world = GrowingMap.learn(
        [seen(Contact.VF, (CORNER, TABLE), 0, rng=rng), seen(Contact.VF, (far, TABLE), 100, unknown=[0])],
        REACH_M,
    )
    assert world.pairs[0] == world.pairs[100]


def test_a_contact_does_not_use_what_it_has_shown_itself() -> None:
    world = learned((CORNER, TABLE), (OTHER_CORNER, TABLE))

    def at(tick: int) -> MapView:
        return world.without(world.shown_after(tick, 0.1))

    corners = {
        tick: [key for key, one in at(tick).elements.items() if one.kind == "v"] for tick in (10, 60, 110)
    }
    assert corners[10] == [world.pairs[100][0]]
    assert corners[110] == [world.pairs[0][0]]
    assert len(corners[60]) == 2
    first = world.sightings[0]
    assert len(at(first.end - 1).counts) == len(at(100 - round(MARGIN_S / 0.1) + 1).counts) == 2
    assert world.latest_before(first.end) == world.pairs[0]  # and what it has shown is of earlier data
    assert world.latest_before(first.end - 1) is None
    table = world.pairs[0][1]
    assert at(10).counts[table] == 1
    assert at(60).counts[table] == 2


@pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
def test_priors_of_pairs(model: ContactModel) -> None:
    """Shares add up to one; a prior on both elements is centred on them, and one on neither is empty."""
    every = {"f": (BOTTOM, TABLE), "e": (EDGE, EDGE), "v": (CORNER, CORNER)}
    ours, theirs = kinds_of(model)
    pair = every[ours][0], every[theirs][1]
    world = GrowingMap.learn([seen(model.contact, pair, 0), seen(model.contact, pair, 100)], REACH_M)
    log_p_new, found = learned_pairs(world.whole, model, np.zeros(3))
    assert np.exp(log_p_new) + np.exp(found.log_share).sum() == pytest.approx(1.0)
    assert log_p_new == pytest.approx(sum(np.log(a / (2.0 + a)) for a in CONCENTRATION))
    row = int(found.are_both_known.argmax())
    prior = pair_priors(model, found.pairs, found.cross)
    mean, information = prior.mean[row], prior.information[row]
    tangent = model.family.tangent(mean[None], model.anchors(np.zeros(3))[None])[0]
    values = np.linalg.eigvalsh(tangent.T @ information @ tangent)
    assert (values > 1.0).all()
    x, _ = stacked(model, pair, model.anchors(np.zeros(3)), np.ones(2), 1.0)
    np.testing.assert_allclose(np.abs(mean), np.abs(x), atol=2e-3)
    given, cut = (
        known_entries(model, prior.mean, prior.information),
        WIDTHS[ours if model.body_in_1 else theirs],
    )
    cuts = (0, 3, 6) if model.contact is Contact.FF else (0, cut, None)
    for own, entries in zip(found.pairs, given, strict=True):
        for one, first, end in zip(own if model.body_in_1 else own[::-1], cuts[:2], cuts[1:], strict=True):
            assert entries[first:end].any() == (one is not None)  # of a new element nothing is given


def test_new_elements_get_cheap_where_all_are_new_and_dear_where_they_return() -> None:
    assert log_prior_of_new(1) == 0.0  # the first contact is free
    assert log_prior_of_new(2) == pytest.approx(sum(np.log(a / (1.0 + a)) for a in CONCENTRATION))

    def p_new(objects: list[int], environments: list[int]) -> tuple[float, ...]:
        counts = {(side, i): n for side, ns in enumerate((objects, environments)) for i, n in enumerate(ns)}
        return tuple(np.exp(log_probabilities_of_new(counts, None)))

    assert p_new([], []) == pytest.approx((1.0, 1.0))
    single, returning = p_new([1] * 5, [1] * 5), p_new([3, 2], [5])
    assert min(single) > 0.4
    assert max(returning) < 0.1
    expected = [np.log(a / (10.0 + a)) for a in CONCENTRATION]
    assert log_probabilities_of_new({}, 10) == pytest.approx(expected)


def unshared(count: int, unknown: tuple[int, ...] = ()) -> list[Sighting]:
    """Sightings of vertices on faces, each of elements of its own."""
    rng = np.random.default_rng(6)
    pairs = [
        (
            MapElement("v", np.zeros(3), rng.uniform(-0.2, 0.2, 3)),
            MapElement(
                "f", Rotation.random(random_state=i).apply([0.0, 0.0, 1.0]), rng.uniform(-1.0, 1.0, 1)
            ),
        )
        for i in range(count)
    ]
    return [seen(Contact.VF, pair, 100 * i, unknown=unknown) for i, pair in enumerate(pairs)]


def test_many_contacts_that_share_nothing_take_seconds_not_minutes() -> None:
    """Their pairs are computed again whenever the label changes: 0.06 s of CPU, and 1.6 s one by one."""
    sightings = unshared(40)
    begin_s = time.process_time()
    world = GrowingMap.learn(sightings, REACH_M)
    assert time.process_time() - begin_s < 30.0  # of all threads of numpy
    assert world.complexity == 0.0
    view = world.whole
    begin_s = time.process_time()
    _, pairs = learned_pairs(view, BY_CONTACT[Contact.VF], np.zeros(3))
    pair_priors(BY_CONTACT[Contact.VF], pairs.pairs, pairs.cross)
    assert time.process_time() - begin_s < 0.7  # of all threads of numpy
    assert len(pairs.log_share) == 41**2 - 1


def test_a_growing_map_replaces_a_contact_that_lasts() -> None:
    rng = np.random.default_rng(7)
    first = seen(Contact.VF, (CORNER, TABLE), 0, rng=rng)
    short = replace(first, onset_ns=100, stamp_ns=200)
    world = GrowingMap(REACH_M).insert(short)
    assert world.due_ns == {100: 250}
    world = world.insert(replace(short, stamp_ns=300)).insert(seen(Contact.EF, (EDGE, TABLE), 50, rng=rng))
    assert len(world.sightings) == 2
    assert world.due_ns[100] == 400
    assert len({theirs for _, theirs in world.pairs.values()}) == 1
    again = world.before_onsets()
    assert [one.first for one in again.sightings] == [-2, -1]
    np.testing.assert_array_equal(again.whole.covariance, world.whole.covariance)


def test_a_contact_may_be_with_an_element_incident_with_the_last_one() -> None:
    """After a corner on the table, an edge through that corner on the same table."""
    world = GrowingMap(REACH_M).insert(seen(Contact.VF, (CORNER, TABLE), 0))
    edge, table = world.whole.incident_pair(BY_CONTACT[Contact.EF], np.zeros(3))
    np.testing.assert_allclose(edge.point_m, CORNER.place_m, atol=1e-6)
    assert not edge.direction.any()
    np.testing.assert_allclose(table.normal, TABLE.direction, atol=1e-6)
    assert world.whole.incident_pair(BY_CONTACT[Contact.VF], np.zeros(3)) is None


def test_a_new_vertex_may_be_on_an_edge_or_in_a_face_of_the_map() -> None:
    """Its covariances are those of points on samples of the edge and the face, also with their partners."""
    world = GrowingMap(REACH_M).insert(seen(Contact.EF, (EDGE, TABLE), 0))
    known, share = world.whole, 0.25
    view = known.with_incident_vertices(share, REACH_M)
    rng = np.random.default_rng(3)
    change = rng.multivariate_normal(np.zeros(len(known.covariance)), known.covariance, 20000)
    change *= 0.01  # small ones, for which both are linear
    for side, kind in ((0, "e"), (1, "f")):
        (key,) = (one for one in known.elements if one[0] == side)
        (vertex,) = (one for one in view.elements if one[0] == side and one not in known.elements)
        moved = [known.elements[key].moved(row[known.slots[key]]) for row in change]
        direction = np.array([one.direction for one in moved])
        beside = REACH_M * rng.standard_normal(direction.shape)
        along = direction * (beside * direction).sum(axis=1, keepdims=True)
        point = np.array([one.foot[0] for one in moved]) + (along if kind == "e" else beside - along)
        held = np.outer(known.elements[key].direction, known.elements[key].direction)
        held = np.eye(3) - held if kind == "e" else held
        from_foot = (point - view.elements[vertex].place_m) @ held
        free = view.covariance[view.slots[vertex], view.slots[vertex]]
        whole = 1e4 * np.cov(from_foot.T)
        np.testing.assert_allclose(held @ free @ held, whole, atol=0.05 * np.abs(whole).max())
        open_m2 = (np.eye(3) - held) @ (free - REACH_M**2 * np.eye(3)) @ (np.eye(3) - held)
        np.testing.assert_allclose(open_m2, 0.0, atol=0.05 * REACH_M**2)
        cross = 1e4 * from_foot.T @ change / len(change)
        found = held @ view.covariance[view.slots[vertex], : len(known.covariance)]
        np.testing.assert_allclose(cross, found, atol=0.05 * np.abs(found).max())
        p_new, p_there = (dict(view.choices(side, "v"))[one] for one in (None, vertex))
        ((_, p_before),) = known.choices(side, "v")
        np.testing.assert_allclose([p_new, p_there], p_before + np.log([1.0 - share, share]))
