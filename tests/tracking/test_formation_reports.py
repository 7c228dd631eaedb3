"""Reports of simultaneous contacts: constraints, lags, and segments that wrenches merge."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.explanations.conditional_contact import Run
from contact_tracker.explanations.further_contacts import Formation, Further, KnownContact
from contact_tracker.geometry.elements import ContactGeometry, Origins, Plane, Point
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.motion.window import Window
from contact_tracker.outputs.text import SAME_NS, Changes
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment
from contact_tracker.tracking.posterior import lagged_belief
from contact_tracker.tracking.segment_fit import (
    FinishedSegment,
    SegmentFit,
    SegmentTicks,
    joined_by_wrenches,
)
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
    """The first to be found begins last: constraints are those of simultaneous contacts."""
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
