"""Lines of action distinguish contacts that motion does not, in any frame, with noise and bias."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.pressed_objects import Pressed, pressed

from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.wrenches.contact_evidence import WindowEvidence, WrenchEvidence
from contact_tracker.wrenches.load import estimate_load
from contact_tracker.wrenches.wrenches import Wrenches, average

DECISIVE = np.log(20.0)
MOST_RAD = np.radians(15.0)
MOST_M = 0.03


def evidence_of(made: Pressed) -> WrenchEvidence:
    ticks = average(made.poses, made.wrenches.valid, made.tick_ns)
    load = estimate_load(ticks, made.is_free, made.is_free.astype(float))
    return WrenchEvidence(ticks, load)


def log_evidence_of(made: Pressed) -> np.ndarray:
    evidence = evidence_of(made).of_window(made.touch_ns, made.end_ns)
    return evidence.log_evidence


@cache
def seen(contact: Contact, seed: int, disturbed: bool = False) -> tuple[Pressed, WindowEvidence]:
    """An object that is pressed, and the evidence while it is."""
    made = pressed(contact, seed, noise=disturbed, bias=disturbed)
    evidence = evidence_of(made).of_window(made.touch_ns, made.end_ns)
    assert evidence is not None
    return made, evidence


def deviation(found: Element, true: np.ndarray) -> tuple[float, float]:
    """Angle (rad) or distance (m) of an element from the true normal, direction or point, and its sd."""
    match found:
        case Point(point_m, covariance):
            return float(np.linalg.norm(point_m - true)), float(np.sqrt(np.trace(covariance)))
        case Line(direction, _, covariance):
            off = true * np.sign(true @ direction) - direction
            return float(np.linalg.norm(off)), float(np.sqrt(np.trace(covariance[:3, :3])))
        case Plane(normal, _, covariance):
            return float(np.linalg.norm(true - normal)), float(np.sqrt(np.trace(covariance[:3, :3])))
    raise AssertionError(found)


@pytest.mark.parametrize("disturbed", [False, True], ids=["clean", "noise and bias"])
@pytest.mark.parametrize("contact", CONTACTS)
def test_the_contact_is_identified(contact: Contact, disturbed: bool) -> None:
    right = []
    for seed in range(5):
        found = seen(contact, seed, disturbed)[1].log_evidence
        right.append(STATES[int(found.argmax())] is contact)
        assert found[contact.column] > found[Contact.FREE.column] + DECISIVE
        assert found[contact.column] > found.max() - DECISIVE, f"seed {seed}: sure and wrong"
    assert sum(right) >= 4


@pytest.mark.parametrize("disturbed", [False, True], ids=["clean", "noise and bias"])
@pytest.mark.parametrize("contact", CONTACTS)
def test_forces_act_through_the_elements_that_touch(contact: Contact, disturbed: bool) -> None:
    for seed in range(5):
        made, found = seen(contact, seed, disturbed)
        for element, true in zip(found.elements[contact], (made.object, made.surroundings), strict=True):
            off, sd = deviation(element, true)
            assert off < 3.0 * sd
            assert sd < (MOST_M if isinstance(element, Point) else MOST_RAD)


def test_lines_in_all_directions_are_unknown() -> None:
    """Forces through one point do not tell the direction of an edge through it."""
    assert seen(Contact.FV, 1)[1].elements[Contact.FE][1] is None


def test_a_free_object_is_identified() -> None:
    made = pressed(Contact.FV)
    evidence = evidence_of(made).of_window(int(made.poses.stamp_ns[0]), made.touch_ns - 1)
    assert evidence.log_evidence.argmax() == Contact.FREE.column
    assert not evidence.elements


@pytest.mark.parametrize(("offset_m", "most"), [((0.0, 0.0, 0.0), 0.2), ((0.05, -0.03, 0.04), 4.0)])
@pytest.mark.parametrize("contact", CONTACTS)
def test_evidence_hardly_depends_on_frames(
    contact: Contact, offset_m: tuple[float, float, float], most: float
) -> None:
    """Neither on the axes of world and body nor on the world's origin; on the body's only by the priors of
    centre of mass and inertia, which are about it."""
    made, evidence = seen(contact, 3)
    before, found = evidence.log_evidence, log_evidence_of(_moved(made, np.array(offset_m)))
    likely = before > before.max() - 10.0
    np.testing.assert_allclose(found[likely], before[likely], atol=most)
    assert found.argmax() == before.argmax()


def _moved(made: Pressed, offset_m: np.ndarray) -> Pressed:
    """The same motion in a turned and shifted world frame and a turned body frame at ``offset_m``."""
    world, body = Rotation.random(random_state=1), Rotation.random(random_state=2)
    turn = Rotation.from_quat(made.poses.quat_xyzw)
    place = np.add(world.apply(made.poses.position_m + turn.apply(offset_m)), (0.7, -1.1, 0.4))
    poses = Poses(made.poses.stamp_ns, place, (world * turn * body).as_quat())
    force = body.inv().apply(made.wrenches.force_n)
    moment = body.inv().apply(made.wrenches.moment_nm - np.cross(offset_m, made.wrenches.force_n))
    return replace(made, poses=poses, wrenches=Wrenches(made.wrenches.stamp_ns, force, moment))


def test_missing_measurements_have_no_evidence() -> None:
    made = pressed(Contact.VF)
    early = made.wrenches.stamp_ns < made.touch_ns
    before_touch = Wrenches(*(column[early] for column in vars(made.wrenches).values()))
    assert evidence_of(replace(made, wrenches=before_touch)).of_window(made.touch_ns, made.end_ns) is None
    assert evidence_of(made).of_window(made.touch_ns, made.touch_ns + 10) is None


def test_a_gap_does_not_change_the_result() -> None:
    made = pressed(Contact.VF)
    middle = made.touch_ns + 2_000_000_000
    kept = np.abs(made.wrenches.stamp_ns - middle) > 500_000_000
    with_gap = Wrenches(*(column[kept] for column in vars(made.wrenches).values()))
    assert log_evidence_of(replace(made, wrenches=with_gap)).argmax() == Contact.VF.column


def test_two_contacts_in_one_window_have_no_evidence() -> None:
    one, other = pressed(Contact.FV, 0), pressed(Contact.VF, 0)
    late = other.poses.stamp_ns >= other.touch_ns
    after = other.poses.stamp_ns[late] + one.end_ns - other.touch_ns + 5_000_000
    poses = Poses.join([one.poses, Poses(after, *(c[late] for c in other.poses.columns[1:]))])
    wrenches = Wrenches(
        poses.stamp_ns,
        np.concatenate([one.wrenches.force_n, other.wrenches.force_n[late]]),
        np.concatenate([one.wrenches.moment_nm, other.wrenches.moment_nm[late]]),
    )
    both = Pressed(poses, wrenches, one.touch_ns)
    assert evidence_of(both).of_window(both.touch_ns, both.end_ns) is None
