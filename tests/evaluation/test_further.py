"""Contacts beside the first against their truth."""

import numpy as np
import pytest

from contact_tracker.geometry.elements import ContactGeometry, Plane, Point
from contact_tracker.ground_truth import FurtherTruth, Truth, TruthInterval
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief, FurtherContact
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.evaluate import FurtherScore, evaluate
from smooth_motion import unturned

STEP_NS = 10_000_000
FRAMES = 100
GEOMETRY = ContactGeometry(Point(np.zeros(3)), Plane(np.array([0.0, 0.0, 1.0]), 0.0))
POSES = unturned(np.zeros((FRAMES, 3)), STEP_NS)
EF, VF, FF = Contact.EF, Contact.VF, Contact.FF


def further(*kinds: Contact) -> FurtherContact:
    """Of the first kind, inseparable from the others."""
    return FurtherContact(kinds[0], 0.9, 0, None, GEOMETRY, kinds[1:], 2)


def belief(frame: int, label: Contact, *others: FurtherContact) -> Belief:
    probability = np.full(len(STATES), 1 / len(STATES))
    return Belief(frame * STEP_NS, label, probability, 0, None, np.zeros(6), (), others)


def score(truth: Truth, beliefs: list[Belief]) -> FurtherScore:
    return evaluate(POSES, truth, Segmentation(beliefs=Beliefs.of(beliefs))).further_offline


def true(first: Contact, *others: tuple[Contact, int, int]) -> Truth:
    rows = tuple(FurtherTruth(a * STEP_NS, b * STEP_NS, contact) for contact, a, b in others)
    return Truth((TruthInterval(0, FRAMES * STEP_NS, first, further=rows),))


def test_shares_of_time_are_those_of_the_frames() -> None:
    """True from 40 to 59; found from 45 to 64."""
    beliefs = [belief(i, EF, *([further(VF)] if 45 <= i < 65 else [])) for i in range(FRAMES)]
    scores = score(true(EF, (VF, 40, 59)), beliefs)
    assert scores.several_s == pytest.approx(0.20)
    assert (scores.right, scores.open) == pytest.approx((0.75, 0.0))
    assert scores.alone_s == pytest.approx(0.80)
    assert scores.false == pytest.approx(5 / 80)


@pytest.mark.parametrize(
    ("truth", "label", "others", "right", "is_open"),
    [
        ((VF,), EF, [(VF,)], 1.0, 0.0),
        ((VF,), VF, [(EF,)], 1.0, 0.0),  # either of them may be the label
        ((VF,), EF, [(FF, VF)], 0.0, 1.0),
        ((VF,), EF, [(FF,)], 0.0, 0.0),
        ((VF,), EF, [], 0.0, 0.0),
        ((VF,), FF, [(VF,)], 0.0, 0.0),
        ((VF,), EF, [(VF,), (VF,)], 0.0, 0.0),
        *(((VF, FF), *found, 1.0, 0.0) for found in ((EF, [(VF,), (FF,)]), (FF, [(EF,), (VF,)]))),
    ],
)
def test_the_reported_set_matches(truth, label, others, right, is_open) -> None:
    """In any order."""
    beliefs = [belief(i, label, *(further(*kinds) for kinds in others)) for i in range(FRAMES)]
    scores = score(true(EF, *((contact, 0, FRAMES) for contact in truth)), beliefs)
    assert (scores.right, scores.open) == pytest.approx((right, is_open))


def test_frames_without_truth_are_not_scored() -> None:
    beliefs = [belief(i, EF, further(VF)) for i in range(FRAMES)]
    scores = score(Truth((TruthInterval(0, FRAMES * STEP_NS, None),)), beliefs)
    assert (scores.several_s, scores.alone_s) == (0.0, 0.0)
    assert np.isnan([scores.right, scores.open, scores.false]).all()


def test_without_beliefs_nothing_is_found() -> None:
    scores = score(true(EF, (VF, 0, FRAMES)), [])
    assert (scores.right, scores.false_s) == (0.0, 0.0)
    assert scores.several_s > 0.9
