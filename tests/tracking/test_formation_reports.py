"""Reports of simultaneous contacts: constraints, lags, segments that wrenches merge, and parts of a segment
in which its face does not turn, whose contact may be that of two faces."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.explanations.conditional_contact import KnownContact, Run
from contact_tracker.explanations.further_contacts import Formation, Further
from contact_tracker.geometry.elements import ContactGeometry, Line, Origins, Plane, Point
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.window import Window
from contact_tracker.outputs.text import SAME_NS, Changes
from contact_tracker.states import Contact
from contact_tracker.tracking.ambiguity import FLUSH_RAD
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment
from contact_tracker.tracking.posterior import lagged_belief
from contact_tracker.tracking.segment_fit import FinishedSegment, SegmentFit, SegmentTicks, joined_by_wrenches
from contact_tracker.tracking.state import start

MODEL = load_model()
COVARIANCE = 1e-6 * np.eye(4)
GEOMETRY = ContactGeometry(
    Point(np.zeros(3), COVARIANCE[:3, :3]), Plane(np.array([0.0, 0.0, 1.0]), 0.0, COVARIANCE)
)
ROW = np.dtype(
    [("start_ns", np.int64), ("stamp_ns", np.int64), ("count", float), ("residual", np.float64, 6)]
)


def window(first: int, count: int) -> Window:
    zeta = lift(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    ones = np.ones((count, 2))
    return Window(first + np.arange(count), zeta, 1e-8 * ones, 1e-6 * ones, frames=np.zeros(count))


def finished_with(ticks: SegmentTicks, sure: float, tick_ns: int = 100) -> FinishedSegment:
    """A segment of these ticks, each of which is as sure of its contact."""
    index, column = ticks.window.index, ticks.contact.column
    rows = np.zeros(len(index), ROW)
    rows["start_ns"] = tick_ns * index
    rows["stamp_ns"], rows["count"] = rows["start_ns"] + tick_ns - 1, 1.0
    posterior = np.full((len(index), 7), (1.0 - sure) / 6)
    posterior[:, column] = sure
    resting = np.zeros(len(index), bool)
    return FinishedSegment(column, rows, int(rows["stamp_ns"][-1]), posterior, ticks, resting)


def finished(contact: Contact, first: int, count: int) -> FinishedSegment:
    return finished_with(SegmentTicks(window(first, count), contact, MODEL, EMPTY_MAP, Origins.zero()), 0.94)


def fitted(contact: Contact, **more: object) -> SegmentFit:
    return replace(SegmentFit(contact, GEOMETRY, (), np.zeros(1)), **more)


def test_constraints_are_those_of_all_contacts_of_the_time() -> None:
    later = Further(KnownContact(Contact.EF, np.zeros(0)), GEOMETRY, (Run(6, 10),), 9.0, ())
    earlier = Further(KnownContact(Contact.VF, np.zeros(0)), GEOMETRY, (Run(2, 8),), 9.0, ())
    ranks = ((frozenset([0]), 4), (frozenset([1]), 3), (frozenset([0, 1]), 5))
    fit = fitted(Contact.EF, formation=Formation((later, earlier), False, ranks))
    (segment,), beliefs = finished(Contact.EF, 0, 10).with_fit(fit)
    assert [one.contact for one in segment.further] == [Contact.VF, Contact.EF]
    assert [one.constraints for one in segment.further] == [5, 5]
    assert [belief.constraints for belief in beliefs] == [2, 2, 3, 3, 3, 3, 5, 5, 4, 4]
    assert fit.constraints == 5
    assert pickle.loads(pickle.dumps(fit)).formation.ranks == ranks  # as between processes


def test_a_segment_is_open_to_states_that_are_more_probable_than_its_label() -> None:
    """The most probable sequence may have a label that is improbable in each tick."""
    segment = finished(Contact.EF, 0, 10)
    for column, expected in ((Contact.FF.column, (Contact.FF,)), (Contact.EF.column, ())):
        posterior = np.full((10, 7), 0.02)
        posterior[:, column] = 0.88
        (found,), _ = segment._replace(posterior=posterior).with_fit(fitted(Contact.EF))
        assert found.inseparable == expected


def further(start_ns: int) -> FurtherContact:
    return FurtherContact(Contact.VF, 0.9, start_ns, None, GEOMETRY, (), 2)


def lagging(*recent: Belief) -> Belief:
    state = start(MODEL, len(recent) * MODEL.tick_s)
    history = np.zeros_like(state.lag_history)
    history[..., Contact.VF.column] = 1.0
    weight = np.zeros(len(history))
    return lagged_belief(state._replace(recent=recent, lag_history=history, log_state_weight=weight), 0)


def belief_at(stamp_ns: int, contact: Contact = Contact.VF, **more: object) -> Belief:
    return replace(Belief(stamp_ns, contact, np.full(7, 1 / 7), stamp_ns, None, np.zeros(6)), **more)


def test_with_a_lag_an_open_formation_limits_the_probability() -> None:
    assert lagging(belief_at(5), belief_at(9)).probability.max() > 0.95
    belief = lagging(belief_at(5, is_open=True), belief_at(9))
    assert belief.probability[Contact.VF.column] == pytest.approx(0.9)
    assert belief.probability.sum() == pytest.approx(1.0)


def test_with_a_lag_contacts_begin_at_their_time() -> None:
    one, two = (further(4),), (replace(further(4), constraints=4), replace(further(8), constraints=4))
    belief = lagging(belief_at(5, Contact.FREE), belief_at(9, further=one))
    assert [(f.start_ns, f.constraints) for f in belief.further] == [(4, 2)]
    belief = lagging(belief_at(5, Contact.FREE), belief_at(6, further=one), belief_at(9, further=two))
    assert ([f.start_ns for f in belief.further], belief.constraints) == ([4], one[0].constraints)
    assert lagging(belief_at(5, Contact.FREE), belief_at(9, further=two)).further == ()


def test_a_further_contact_is_never_more_probable_than_the_label_beside_it() -> None:
    """In ticks, whatever changes them later, and in segments."""
    belief = belief_at(5, further=(further(4),))
    assert belief.further[0].probability == pytest.approx(0.9 / 7)
    doubted = replace(belief, probability=np.eye(7)[3])
    assert doubted.contacts_json[1]["probability"] == pytest.approx(0.9)
    row = Segment(0, 9, Contact.VF, 0.28, GEOMETRY, further=belief.further)
    assert row.contacts_json[1]["probability"] == pytest.approx(0.9 * 0.28)


def test_further_contacts_that_begin_at_about_the_same_time_are_reported_as_often_as_they_end() -> None:
    """And not again if they are missing for less than a second, under any label but free motion."""
    changes, both = Changes(), (further(4), further(5))
    late = replace(both[0], start_ns=3 * SAME_NS)
    given = [both[:1], both, both, both[1:], (late, both[1]), both[1:], both[1:], (), ()]
    given = [
        *((Contact.VF, one) for one in given),
        (Contact.VF, both[:1]),
        (Contact.EF, ()),
        (Contact.FREE, ()),
    ]
    reported = [
        changes.update(belief_at(6 + i * SAME_NS // 2, label, further=those))
        for i, (label, those) in enumerate(given)
    ]
    events = [(i, len(begin), len(end)) for i, (_, begin, end) in enumerate(reported) if begin or end]
    assert events == [(0, 1, 0), (1, 1, 0), (7, 0, 1), (11, 0, 1)]


def probabilities(found: list[tuple[FinishedSegment, SegmentFit]]) -> NDArray[np.float64]:
    return np.concatenate([segment.with_fit(fit)[1].probability for segment, fit in found])


def test_neighbours_that_wrenches_make_equal_are_one_segment() -> None:
    first, second = finished(Contact.VF, 0, 6), finished(Contact.EF, 6, 4)
    chosen = [(first, fitted(Contact.VF)), (second, fitted(Contact.VF))]
    ((segment, fit),) = joined_by_wrenches(chosen)
    (joined,), beliefs = segment.with_fit(fit)
    assert (joined.start_ns, joined.end_ns, joined.contact) == (0, 999, Contact.VF)
    assert {belief.onset_ns for belief in beliefs} == {0}
    np.testing.assert_array_equal(probabilities(chosen), beliefs.probability)


def test_neighbours_with_other_elements_or_by_motion_alone_stay() -> None:
    first, second = finished(Contact.VF, 0, 6), finished(Contact.EF, 6, 4)
    elsewhere = replace(GEOMETRY, object=Point(np.array([0.1, 0.0, 0.0]), COVARIANCE[:3, :3]))
    other = fitted(Contact.VF, geometry=elsewhere)
    assert len(joined_by_wrenches([(first, fitted(Contact.VF)), (second, other)])) == 2
    by_motion = finished(Contact.VF, 6, 4)
    assert len(joined_by_wrenches([(first, fitted(Contact.VF)), (by_motion, fitted(Contact.VF))])) == 2


# --- parts of a segment whose face does not turn ---
NOISE_RAD = 5e-4
FLAT, COUNT = 40, 80
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1e-8 * np.eye(4))
EDGE = Line(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.05, -0.04]), 1e-8 * np.eye(6))


def slid_then_tilted(tilt_rad: float, rng: np.random.Generator) -> Window:
    """A box that slides and yaws on the table, for ``FLAT`` ticks on a face and then on an edge that is
    tilted to and fro."""
    tick = np.arange(COUNT)
    yaw, tilt = 0.3 * np.sin(0.1 * tick), tilt_rad * np.sin(0.4 * np.clip(tick - FLAT, 0, None))
    turn = Rotation.from_euler("ZX", np.column_stack([yaw, tilt]))
    place_m = np.column_stack([0.1 * np.sin(0.07 * tick), 0.1 * np.cos(0.09 * tick), 0.0 * tick])
    error = Rotation.from_rotvec(NOISE_RAD * rng.normal(size=(COUNT, 3)))
    zeta = lift((turn * error).as_matrix(), place_m - turn.apply(EDGE.point_m))
    variance = np.tile([1e-8, NOISE_RAD**2], (COUNT, 1))
    return Window(tick, zeta, variance, 1e-6 * np.ones((COUNT, 2)), frames=np.full(COUNT, 20.0))


def reported(tilt_rad: float, fit: SegmentFit, known_map: Map = EMPTY_MAP) -> tuple[Segment, ...]:
    """The parts of one segment of the motion above, which is sure of its contact."""
    window = slid_then_tilted(tilt_rad, np.random.default_rng(0))
    ticks = SegmentTicks(window, fit.contact, MODEL, known_map, Origins.zero())
    segments, beliefs = finished_with(ticks, 0.994, 100_000_000).with_fit(fit)
    for belief in beliefs:
        (part,) = (segment for segment in segments if segment.start_ns <= belief.stamp_ns <= segment.end_ns)
        assert belief.inseparable == part.inseparable
    return segments


def fit_of(contact: Contact, geometry: ContactGeometry) -> SegmentFit:
    return SegmentFit(contact, geometry, (), np.zeros(1))


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_part_on_the_face_may_be_flush_in_a_segment_on_an_edge(is_mirrored: bool) -> None:
    if is_mirrored:  # the body's face on an edge of the world: here the world's axes are the body's
        window_normal = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1e-8 * np.eye(4))
        fit = fit_of(Contact.FE, ContactGeometry(window_normal, EDGE))
    else:
        fit = fit_of(Contact.EF, ContactGeometry(EDGE, TABLE))
    flat, tilted = reported(0.2, fit)
    assert flat.inseparable == (Contact.FF,)
    assert flat.probability < 0.9 + 1e-9
    assert tilted.inseparable == ()
    assert tilted.probability > 0.99
    assert abs(tilted.start_ns - FLAT * 1e8) <= 5e8


def test_all_of_a_segment_that_rocks_less_than_faces_do_may_be_flush() -> None:
    (whole,) = reported(FLUSH_RAD, fit_of(Contact.EF, ContactGeometry(EDGE, TABLE)))
    assert whole.inseparable == (Contact.FF,)


def test_where_f_f_cannot_occur_the_edge_stays_sure() -> None:
    possible = Map(states=(Contact.EF, Contact.VF, Contact.FREE))
    (whole,) = reported(0.2, fit_of(Contact.EF, ContactGeometry(EDGE, TABLE)), possible)
    assert whole.inseparable == ()
